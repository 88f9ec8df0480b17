"""Photo loading before the first step: memory estimate, cache size and mask checks."""

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
"""Maximum of a mask, of 255, below which it probably has class labels or is wrong."""


@dataclass(frozen=True, kw_only=True)
class LoadedPhotos:
    """Result of `load_photos`."""

    cache: int | None
    """Bytes of photos that may be kept in memory; None: all are already in memory."""
    warnings: list[str]
    """Warnings for the user, as sentences."""


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
    """Estimate time and memory, decode the photos if they fit, and check the masks.

    Args:
        photos: The capture, whose photo headers have been read.
        config: The options.
        points: Expected number of splats at the start.
        depths: Whether there are depth maps.
        announce: Whether to emit the estimate, which is for a whole run.
        emit: Receives the estimate and progress events.
        control: Stops the loading.

    Raises:
        GsError: the training does not fit into memory; the message has advice.
        DatasetError: the masks leave no pixels to train on.
        Cancelled: stopped.
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
        photos.limit_cache()
    warnings = _check_masks(photos, config.threads)
    if found.decodes_again:  # preloading has only checked that all can be decoded
        photos.limit_cache()
    all_there = found.photos_kept and not found.decodes_again
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
        stored=photos.decoding_pixels,
    )


def _event(found: Estimate, config: TrainConfig) -> Estimated:
    return Estimated(
        seconds=found.seconds,
        reading_seconds=found.reading_seconds,
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
    """Return a progress callback for reading `what`, called with (done, total); it emits Progress
    events and raises Cancelled if `control` stops."""
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
    """Maximum of a view's mask, 0 to 255; 255 without a mask."""
    mask = photos.mask(index)
    return 255 if mask is None else int(mask.max())


def _check_masks(photos: Dataset, threads: int) -> list[str]:
    """Return warnings about masks that are nearly black; raise DatasetError if all are black."""
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
                "no pixels to train on. Leave out `--invert-masks`, or use `--mask-mode none`."
            )
        raise DatasetError(
            f"The masks of all {views} in {photos.source} are black, so there are no pixels to "
            "train on. White pixels are trained: use `--invert-masks` if white marks pixels to "
            "ignore, or `--mask-mode none`."
        )
    warnings = []
    if empty:
        views = count_words(len(empty), "training view")
        warnings.append(f"The masks of {views} are black, for example {empty[0]}.")
    if dark:
        views = count_words(len(dark), "training view")
        warnings.append(
            f"The masks of {views} are nearly black, for example {dark[0]}: no pixel reaches "
            f"{_DARK_MASK} of 255, so these views have almost no weight. White pixels are trained; "
            f"convert class labels to 0 and 255."
        )
    return warnings
