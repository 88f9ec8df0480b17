"""`train`: everything that must be right before the first step, then a session."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ..config import DataConfig, TrainConfig
from ..control import Control
from ..datasets import Dataset, load_dataset
from ..errors import BackendError, Cancelled, ConfigError, DatasetError, FormatError, GsError
from ..events import Event, Progress
from ..io.ply import is_antialiased, read_splats
from ..metrics import find_lpips
from . import checkpoint
from .depth_setup import prepare_depth
from .folder import RunFolder, open_folder
from .frame import Frame
from .memory import check_memory
from .session import Session, TrainResult
from .torch_threads import one_torch_thread
from .trainer import Trainer

_FAR_FROM_ORIGIN = 1e4
_DEPTH_BYTES = 11
"""Bytes a pixel while depth maps are read: value and confidence in float32, and the target."""
_LOADING_PERIOD = 0.5
"""Seconds between two events while photos are read."""


def train(
    config: TrainConfig,
    data: DataConfig,
    output: Path,
    on_event: Callable[[Event], None] | None = None,
    control: Control | None = None,
    *,
    resume: bool = False,
    overwrite: bool = False,
    start_checkpoint: Path | None = None,
) -> TrainResult:
    """Train splats from a capture and write them, their metrics and a report into a folder.

    Nothing in the folder is touched before the options, the capture and the memory are found good.

    Args:
        config: How to train.
        data: What to train on.
        output: Folder for the results; made if it is not there.
        on_event: Called with each event, in the thread that called `train`.
        control: Through which others ask to stop, pause or save.
        resume: Go on from the last checkpoint in `output`.
        overwrite: Replace another run in `output`.
        start_checkpoint: Go on from this checkpoint of another folder.

    Returns:
        How it ended. Stopping by `control` is no error.

    Raises:
        GsError: bad input, a folder in use, too little memory, a full disk or a diverged training.
        Cancelled: stopped by `control` while the photos were read; nothing was written.
    """
    emit, control = on_event or (lambda event: None), control or Control()
    with open_folder(output, resume=resume, overwrite=overwrite) as folder, one_torch_thread():
        before, damaged = _checkpoint_to_start_from(folder, resume, start_checkpoint)
        start = None if config.start_splats is None else read_splats(config.start_splats)
        lpips, lpips_reason = find_lpips(config.lpips, threads=config.threads)
        photos = load_dataset(data)
        frame = None
        if before is not None:
            checkpoint.check_compatible(before, config, photos)
            with checkpoint.understood(before.path):
                frame = Frame.from_dict(before.trainer["frame"])
        _check_fits(config, photos, depths=bool(data.depths))
        _decode(photos, config, emit, control)
        empty = _check_masks(photos)
        with _memory_in_words():
            depth = prepare_depth(
                data, config, photos, on_progress=_progress("depth maps", config, emit, control)
            )
            trainer = Trainer(
                config,
                photos,
                frame=frame,
                start=start,
                depth=depth.loss_targets,
                points=depth.points,
            )
            if before is not None:
                checkpoint.check_same_depth(before, trainer)
            session = Session(
                trainer,
                folder,
                data,
                emit=emit,
                control=control,
                lpips=lpips,
                lpips_reason=lpips_reason,
                depth=depth,
            )
            if before is not None:
                with checkpoint.understood(before.path):
                    trainer.restore(before.trainer, before.tensors)
                    session.restore(before.session)
                for path in damaged:
                    session.warn(_set_aside(path, before.steps), "damaged_checkpoint")
            elif overwrite:
                folder.clear()
            for message in (*photos.warnings, *empty, *_own_warnings(trainer)):
                session.warn(message, "capture")
            for message in depth.warnings:
                session.warn(message, "depth")
            return session.run()


def _checkpoint_to_start_from(
    folder: RunFolder, resume: bool, start_checkpoint: Path | None
) -> tuple[checkpoint.Checkpoint | None, list[Path]]:
    """The checkpoint to go on from, and later ones in the folder that are damaged.

    Raises:
        FormatError: the checkpoint that was named, or each one in the folder, is damaged.
    """
    if resume and start_checkpoint is not None:
        raise ConfigError("Give either --resume or --start-checkpoint, not both.")
    if start_checkpoint is not None:
        return checkpoint.load(start_checkpoint), []
    damaged: list[Path] = []
    paths = folder.checkpoints() if resume else []
    for path in reversed(paths):
        try:
            return checkpoint.load(path), damaged
        except FormatError:
            damaged.append(path)
            if len(damaged) == len(paths):
                raise
    return None, []


def _set_aside(path: Path, step: int) -> str:
    """Rename a damaged checkpoint, so that it is not looked at again; a sentence about it."""
    aside = path.with_name(f"{path.name}.damaged")
    try:
        path.replace(aside)
    except OSError as error:
        raise GsError(f"Cannot rename the damaged {path}: {error.strerror}.") from error
    return f"{path.name} is damaged (now {aside.name}); going on from step {step} before it."


def _check_fits(config: TrainConfig, photos: Dataset, *, depths: bool) -> None:
    cameras = photos.scene.cameras
    pixels = cameras.widths * cameras.heights
    check_memory(
        splats=config.max_splats,
        sh_degree=config.sh_degree,
        pixels=int(pixels.max(initial=0)),
        photos=photos.nbytes + (_DEPTH_BYTES * int(pixels.sum()) if depths else 0),
    )


def _decode(
    photos: Dataset, config: TrainConfig, emit: Callable[[Event], None], control: Control
) -> None:
    """Decode all photos now, so that steps take even times, and tell how far it is."""
    photos.preload(
        threads=config.threads,
        on_progress=_progress("photos", config, emit),
        cancelled=lambda: control.stopping,
    )


def _progress(
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


def _check_masks(photos: Dataset) -> list[str]:
    """Sentences about masks that leave nothing to train on; DatasetError if all do."""
    if photos.mask_mode == "none":
        return []
    masks = {i: photos.mask(i) for i in photos.train}
    empty = [photos.names[i] for i, mask in masks.items() if mask is not None and not mask.any()]
    if len(empty) == len(masks):
        raise DatasetError(
            f"The masks of all {len(empty)} training views in {photos.source} are black, so there "
            "is nothing to train on. White is what counts: invert them, or choose --mask-mode none."
        )
    if empty:
        return [f"The masks of {len(empty)} training views are black, for example {empty[0]}."]
    return []


def _own_warnings(trainer: Trainer) -> Iterator[str]:
    """Sentences about what the training world implies for the results."""
    frame, config = trainer.frame, trainer.config
    near = frame.near / frame.similarity.scale
    if near < 0.999 * config.near:
        yield (
            f"The capture is small in its own units, so the near plane was lowered from "
            f"{config.near:g} to {near:.3g}; use the same when rendering (--near {near:.3g})."
        )
    if config.start_splats and is_antialiased(config.start_splats) != config.antialias:
        yield (
            f"{config.start_splats} was trained {'without' if config.antialias else 'with'} "
            "antialiasing, unlike this run; small splats change their opacity at first."
        )
    offset = float(np.abs(frame.similarity.shift).max()) * frame.similarity.scale / frame.extent
    if offset > _FAR_FROM_ORIGIN:
        yield (
            f"The capture lies {offset:.0f} times its own size from the origin; the float32 "
            "numbers of a PLY are coarse there. Move its origin near the cameras before exporting."
        )


@contextmanager
def _memory_in_words() -> Iterator[None]:
    """BackendError where memory runs out."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        # torch raises a RuntimeError with these words instead of a MemoryError.
        if not isinstance(error, MemoryError) and "can't allocate memory" not in str(error):
            raise
        raise BackendError(
            "Out of memory; use fewer splats (--max-splats), smaller photos (-r 2), or close "
            "programs. The last checkpoint is kept."
        ) from error
