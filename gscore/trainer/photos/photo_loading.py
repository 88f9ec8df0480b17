"""Photo loading before the first step: memory needed, cache in memory or not, checked masks."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from ...config import TrainConfig
from ...control import Control
from ...datasets import Dataset
from ...datasets.dataset import map_threads
from ...errors import Cancelled, DatasetError
from ...events import Estimated, Event, Progress
from ...text_format import count_words
from ..estimate.forecast import Estimate, check_fits, estimate

_LOADING_PERIOD = 0.5
"""Seconds between two events while photos are read."""
_DARK_MASK = 32
"""Of 255: masks that are nowhere brighter hold labels, or are wrong."""


@dataclass(frozen=True, kw_only=True)
class LoadedPhotos:
    """What became of the photos."""

    cache: int | None
    """Bytes of photos that may be kept in memory; None: all are in memory already."""
    warnings: list[str]
    """Sentences for the user."""


def load_photos(
    photos: Dataset,
    config: TrainConfig,
    *,
    points: int,
    depths: bool,
    announce: bool,
    emit: Callable[[Event], None],
    control: Control,
) -> LoadedPhotos:
    """Tell what the training will take, decode the photos where they fit, and check the masks.

    Args:
        photos: Their headers have been read.
        config: How to train.
        points: Splats that it starts from, as far as that is known.
        depths: Whether there are depth maps.
        announce: Whether to tell what the training will take: all of it, not the rest of it.
        emit: Told of the estimate and how far reading is.
        control: Asked whether to stop.

    Raises:
        GsError: The training would not fit into memory; says what would.
        DatasetError: The masks leave nothing to train on.
        Cancelled: Stopped.
    """
    found = _estimate(photos, config, points, depths)
    check_fits(found, config)
    if announce:
        emit(_event(found, config))
    if found.photos_kept:
        photos.preload(
            threads=config.threads,
            on_progress=progress_of("photos", config, emit),
            cancelled=lambda: control.stopping,
        )
    else:
        photos.keep_few()
    warnings = _check_masks(photos, config.threads)
    if found.photos_anew:  # all of them were good
        photos.keep_few()
    all_there = found.photos_kept and not found.photos_anew
    return LoadedPhotos(cache=None if all_there else found.photo_bytes, warnings=warnings)


def _estimate(photos: Dataset, config: TrainConfig, points: int, depths: bool) -> Estimate:
    cameras = photos.scene.cameras
    sizes = list(zip(cameras.widths.tolist(), cameras.heights.tolist(), strict=True))
    pixels = int((cameras.widths * cameras.heights).sum())
    return estimate(
        config,
        sizes,
        points=points,
        masks=photos.nbytes > 3 * pixels,
        subject=photos.mask_mode == "composite",
        depths=depths,
        cloud=len(photos.scene.points),
        decoding=photos.decoding_bytes(config.threads),
    )


def _event(found: Estimate, config: TrainConfig) -> Estimated:
    return Estimated(
        seconds=found.seconds,
        peak_bytes=found.peak_bytes,
        free_bytes=found.free_bytes,
        photos_kept=found.photos_kept,
        photo_bytes=found.photo_bytes,
        max_splats=config.max_splats,
    )


def progress_of(
    what: str,
    config: TrainConfig,
    emit: Callable[[Event], None],
    control: Control | None = None,
) -> Callable[[int, int], None]:
    """What tells now and then how much of `what` is read; with `control` it can be stopped."""
    began = last = time.monotonic()

    def on_progress(done: int, total: int) -> None:
        nonlocal last
        if control is not None and control.stopping:
            raise Cancelled(f"Reading the {what} was stopped.")
        now = time.monotonic()
        if now - last < _LOADING_PERIOD:
            return
        last = now
        emit(
            Progress(
                step=0,
                iterations=config.iterations,
                loss=math.nan,
                psnr=math.nan,
                splats=0,
                steps_per_s=0.0,
                eta_s=math.nan,
                elapsed_s=now - began,
                phase=f"reading {what} {done}/{total}",
            )
        )

    return on_progress


def _brightest(photos: Dataset, index: int) -> int:
    """The largest value of a view's mask, 0 to 255; 255 without a mask."""
    mask = photos.mask(index)
    return 255 if mask is None else int(mask.max())


def _check_masks(photos: Dataset, threads: int) -> list[str]:
    """Sentences about masks that leave (nearly) nothing to train on; DatasetError if all do."""
    if photos.mask_mode == "none":
        return []
    brightest = map_threads(partial(_brightest, photos), photos.train, threads=threads)
    found = dict(zip(photos.train, brightest, strict=True))
    empty = [photos.names[i] for i, top in found.items() if top == 0]
    dark = [photos.names[i] for i, top in found.items() if 0 < top < _DARK_MASK]
    if len(empty) == len(photos.train):
        views = count_words(len(empty), "training view")
        if any(photos.files[i].mask_inverted for i in photos.train):
            raise DatasetError(
                f"The masks of all {views} in {photos.source} are white, so inverted they leave "
                "nothing to train on: leave out --invert-masks, or choose --mask-mode none."
            )
        raise DatasetError(
            f"The masks of all {views} in {photos.source} are black, so there is nothing to train "
            "on. White is what counts: give --invert-masks if it marks what to leave out, or "
            "choose --mask-mode none."
        )
    warnings = []
    if empty:
        views = count_words(len(empty), "training view")
        warnings.append(f"The masks of {views} are black, for example {empty[0]}.")
    if dark:
        views = count_words(len(dark), "training view")
        warnings.append(
            f"The masks of {views} are nearly black, for example {dark[0]}: nothing in them "
            f"reaches {_DARK_MASK} of 255, so these views hardly count. White is what counts; "
            f"labels of several classes must be made 0 and 255."
        )
    return warnings
