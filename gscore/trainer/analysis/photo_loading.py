"""Photo loading before the first step: memory estimate, one visit of the photos, mask checks."""

import math
import time
from collections.abc import Callable
from typing import Any

from ...config import TrainConfig
from ...control import Control
from ...datasets import Dataset
from ...engine.base import Engine
from ...errors import Cancelled, DatasetError
from ...events import Estimated, Event, Progress
from ...text_format import count_text
from ..estimate.forecast import Estimate, check_fits, estimate
from .photo_visit import PhotoFacts, visit_photos

_LOADING_PERIOD = 0.5
"""Seconds between two events while photos are read."""
_DARK_MASK = 32
"""Maximum of a mask, of 255, below which it probably has class labels or is wrong."""


def load_photos(
    photos: Dataset,
    config: TrainConfig,
    *,
    points: int,
    depths: bool,
    announce: bool,
    emit: Callable[[Event], None],
    control: Control,
    engine: Engine[Any] | None = None,
) -> tuple[int | None, PhotoFacts]:
    """Estimate time and memory, decode the photos if they fit, and visit them.

    Returns the bytes of photos that may be kept in memory, None if all are there already; and the
    facts of the visit.

    Args:
        photos: The capture, whose photo headers have been read.
        config: The options.
        points: Expected number of splats at the start.
        depths: Whether there are depth maps.
        announce: Whether to emit the estimate, which is for a whole run.
        emit: Receives the estimate and progress events.
        control: Stops the loading.
        engine: Computes the training; None: the CPU.

    Raises:
        DeviceMemoryError: the training does not fit into the memory of the engine's device.
        GsError: the training does not fit into memory; the message has advice.
        DatasetError, FormatError: a photo cannot be read.
        Cancelled: stopped.
    """
    found = _estimate(photos, config, points, depths, engine)
    check_fits(found, config, "" if engine is None else engine.info.name)
    if announce:
        emit(
            Estimated(
                seconds=found.seconds,
                reading_seconds=found.reading_seconds,
                peak_bytes=found.peak_bytes,
                free_bytes=found.free_bytes,
                photos_kept=found.photos_kept,
                photo_bytes=found.photo_bytes,
                max_splats=config.max_splats,
                device_bytes=0 if found.device is None else found.device.peak_bytes,
                device_free_bytes=0 if found.device is None else found.device.free_bytes,
            )
        )
    if found.photos_kept:
        photos.preload(
            threads=config.threads,
            on_progress=progress_of("photos", config, emit),
            cancelled=lambda: control.stopping,
        )
    else:
        photos.limit_cache()
    facts = visit_photos(config, photos)
    if found.decodes_again:  # preloading has only checked that all can be decoded
        photos.limit_cache()
    all_there = found.photos_kept and not found.decodes_again
    return None if all_there else found.photo_bytes, facts


def _estimate(
    photos: Dataset, config: TrainConfig, points: int, depths: bool, engine: Engine[Any] | None
) -> Estimate:
    device = {}
    if engine is not None and engine.info.memory:
        info = engine.info
        device = {"device_memory": info.memory, "cost": info.cost, "pace": engine.pace()}
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
        **device,
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


def check_masks(photos: Dataset, facts: PhotoFacts) -> list[str]:
    """Return warnings about masks that are nearly black.

    Raises:
        DatasetError: all are black, so there are no pixels to train on.
    """
    found = dict(zip(photos.train, facts.brightest, strict=False))
    empty = [photos.names[i] for i, top in found.items() if top == 0]
    dark = [photos.names[i] for i, top in found.items() if 0 < top < _DARK_MASK]
    if empty and len(empty) == len(photos.train):
        views = count_text(len(empty), "training view")
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
        views = count_text(len(empty), "training view")
        warnings.append(f"The masks of {views} are black, for example {empty[0]}.")
    if dark:
        views = count_text(len(dark), "training view")
        warnings.append(
            f"The masks of {views} are nearly black, for example {dark[0]}: no pixel reaches "
            f"{_DARK_MASK} of 255, so these views have almost no weight. White pixels are trained; "
            f"convert class labels to 0 and 255."
        )
    return warnings
