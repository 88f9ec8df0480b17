"""Measured trainings in memory: no files, no events, evaluation outside the clock."""

import time
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace

import numpy as np

from ..config import DataConfig, TrainConfig
from ..datasets import Dataset, load_dataset
from ..errors import DatasetError
from ..metrics.evaluate import masked_pair, target_picture
from ..metrics.image import psnr, ssim
from ..photo_exposure import PhotoExposure
from ..raster.api import render_camera
from ..splats import Splats
from ..trainer.analysis.analysis import Analysis
from ..trainer.analysis.exposure import decide_exposure
from ..trainer.analysis.photo_visit import visit_photos
from ..trainer.analysis.pose_check import check_poses
from ..trainer.depth.stereo import stereo_start
from ..trainer.host.isolated_state import isolated_torch_state
from ..trainer.photos.view_sampler import Photos
from ..trainer.schedule.caps import cap_by_photos
from ..trainer.trainer import Trainer

Color = tuple[float, float, float]
"""RGB in [0, 1]."""
PictureOf = Callable[[int], np.ndarray]
"""Renders a view by index, [H, W, 3] float."""


@dataclass(frozen=True, kw_only=True)
class Point:
    """State of a training at one step."""

    step: int
    seconds: float
    """Time spent in steps so far, without evaluation, s."""
    splats: int
    """Number of splats; 0: unknown, for another program."""
    psnr: float
    """Mean over the held-out views, dB."""
    ssim: float
    """Mean over the held-out views, zero padded; NaN: unknown, for another program."""


@dataclass(frozen=True, kw_only=True)
class Trained:
    """A training from its first to its last step."""

    seconds: float
    """Time spent in steps, and before them on the initial points, s."""
    points: list[Point]
    """Measurements, the last one after the last step."""
    forward_pairs: float
    """Pairs of splat and pixel evaluated in all forward passes."""
    backward_pairs: float
    """The same in all backward passes."""
    splats: Splats = field(repr=False)
    """The result, in COLMAP world."""
    near: float
    """Its near plane, world units."""


def open_for_bench(data: DataConfig) -> Dataset:
    """Open a capture without decoding photos.

    Raises:
        DatasetError: no views are held out.
    """
    photos = load_dataset(data)
    if not photos.test:
        raise DatasetError(
            f"{data.source}: no views are held out to measure on; hold some out with `--eval` or "
            "`--hold-out`."
        )
    return photos


def load_for_bench(data: DataConfig) -> Dataset:
    """Open a capture and decode all photos; errors as in `open_for_bench`."""
    photos = open_for_bench(data)
    photos.preload()
    return photos


@dataclass(frozen=True, kw_only=True)
class Variant:
    """One way to train."""

    label: str
    data: DataConfig
    config: TrainConfig
    photos: Dataset
    eval_views: Dataset
    """The views at the size for measurements; may be `photos`."""


def open_variants(options: Sequence[tuple[str, DataConfig, TrainConfig]]) -> list[Variant]:
    """Variants of one capture, perhaps with photos of several sizes, not decoded yet.

    Args:
        options: Label and options of each.

    Returns:
        The variants. Those with photos of one size share them; all are measured on the largest.

    Raises:
        DatasetError: no views are held out.
    """
    opened: dict[DataConfig, Dataset] = {}
    sizes: dict[bytes, Dataset] = {}
    for _, data, _ in options:
        if data not in opened:
            photos = open_for_bench(data)
            cameras = photos.scene.cameras
            opened[data] = sizes.setdefault(
                np.stack([cameras.widths, cameras.heights]).tobytes(), photos
            )
    eval_views = max(opened.values(), key=_pixels)
    return [
        Variant(label=label, data=data, config=config, photos=opened[data], eval_views=eval_views)
        for label, data, config in options
    ]


def first_size(photos: Dataset) -> tuple[int, int]:
    """Width and height of the first photo, px."""
    cameras = photos.scene.cameras
    return int(cameras.widths[0]), int(cameras.heights[0])


def _pixels(photos: Dataset) -> int:
    cameras = photos.scene.cameras
    return int((cameras.widths * cameras.heights).sum())


def quality(photos: Photos, picture_of: PictureOf, background: Color) -> tuple[float, float]:
    """Mean PSNR of the counted pixels, dB, and mean SSIM of the held-out views.

    Args:
        photos: Reference photos.
        picture_of: Renders a view of `photos` over `background`, [H, W, 3] float.
        background: RGB in [0, 1].
    """
    values = []
    for index in photos.test:
        target, weights = target_picture(
            photos.image(index), photos.mask(index), photos.mask_mode, background
        )
        picture = picture_of(index)
        worth = psnr(picture, target, mask=weights)
        if weights is not None:
            picture, target = masked_pair(picture, target, weights)
        values.append((worth, ssim(picture, target)))
    means = np.mean(values, axis=0)
    return float(means[0]), float(means[1])


def train_measured(
    config: TrainConfig,
    photos: Dataset,
    *,
    at: Collection[int] = (),
    limited: bool = False,
    eval_views: Dataset | None = None,
    on_step: Callable[[int], None] | None = None,
    at_end: Callable[[PictureOf, Color], None] | None = None,
) -> Trained:
    """Train and measure after the steps `at` and after the last one.

    Args:
        config: Training options.
        photos: Photos with held-out views; decoded before the clock starts.
        at: Steps after which quality is measured.
        limited: Apply the limits of steps and splats by the photos, as in `gscore train`.
        eval_views: The same views, perhaps at another size, for measurements; None: `photos`.
        on_step: Called after each step, outside the clock.
        at_end: Called after the last step, outside the clock, with the renderer of the views of
            `eval_views` and its background.
    """
    points: list[Point] = []
    if eval_views is photos:
        eval_views = None
    photos.preload()
    if eval_views is not None:
        eval_views.preload(eval_views.test)
    seconds = forward = backward = 0.0
    with isolated_torch_state(), ExitStack() as stack:
        began = time.perf_counter()
        start = stereo_start(config, photos, photos.scene.points)
        if limited:
            config, _ = cap_by_photos(
                config,
                photos=len(photos.train),
                points=photos.scene.points.given,
                mask_mode=photos.mask_mode,
                known=start.known,
                compared=True,
            )
        seconds += time.perf_counter() - began
        facts = visit_photos(config, photos)
        analysis = Analysis(photos=photos, facts=facts, points=start.points, known=start.known)
        gains, pose_check = decide_exposure(config, analysis).gains, check_poses(config, analysis)
        trainer = Trainer(config, replace(analysis, gains=gains, pose_check=pose_check))
        stack.enter_context(closing(trainer.engine))
        for step in range(1, config.iterations + 1):
            measured = step in at or step == config.iterations
            began = time.perf_counter()
            trainer.advance()
            if measured:
                trainer.read_all()
            seconds += time.perf_counter() - began
            forward += trainer.stage_timer.raster.get("forward_pairs", 0)
            backward += trainer.stage_timer.raster.get("backward_pairs", 0)
            if measured:
                background = trainer.renderer.background
                targets = trainer.photos if eval_views is None else eval_views
                found = quality(targets, _pictures(trainer, eval_views), background)
                points.append(
                    Point(
                        step=step,
                        seconds=seconds,
                        splats=trainer.splat_count,
                        psnr=found[0],
                        ssim=found[1],
                    )
                )
            if on_step is not None:
                on_step(step)
        if at_end is not None:
            at_end(_pictures(trainer, eval_views), trainer.renderer.background)
        return Trained(
            seconds=seconds,
            points=points,
            forward_pairs=forward,
            backward_pairs=backward,
            splats=trainer.splats(),
            near=trainer.frame.world_near,
        )


def _pictures(trainer: Trainer, eval_views: Dataset | None) -> PictureOf:
    """Renderer of the current splats over the fixed background, with the exposure of the photo;
    None: at the trained size."""
    background = trainer.renderer.background
    if eval_views is None:
        return lambda index: trainer.renderer.picture(index, background=background)
    cameras, splats = eval_views.scene.cameras, trainer.splats()

    def picture_of(index: int) -> np.ndarray:
        gain = trainer.photo_parameters.gain_of(index)
        rgb = render_camera(
            splats,
            cameras,
            index,
            background=trainer.renderer.background_before_gain(background, gain),
            near=trainer.frame.world_near,
            antialias=trainer.config.antialias,
            threads=trainer.config.threads,
            device="cpu",
        ).rgb
        return PhotoExposure.of(gain).apply(rgb)

    return picture_of
