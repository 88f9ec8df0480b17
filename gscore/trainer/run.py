"""`train`: everything that must be right before the first step, then a session."""

import contextlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ..config import DataConfig, TrainConfig, flag_of
from ..config_file import differences, load_config
from ..control import Control
from ..datasets import load_dataset
from ..depth.maps import MapFolder
from ..errors import BackendError, ConfigError, FormatError, GsError
from ..events import Event
from ..io.ply import read_splats
from ..metrics import find_lpips
from .depth.setup import prepare_depth
from .files import checkpoint
from .files.ended import TrainResult, ended_run
from .files.folder import RunFolder, open_folder
from .host.heap import large_pieces_apart
from .host.state import ordinary_state
from .photos.loading import load_photos, progress_of
from .premises import look_over
from .rows.frame import Frame
from .session import Session
from .trainer import Trainer


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
        overwrite: Replace another run in `output`; files that no training writes stay.
        start_checkpoint: Go on from this checkpoint of another folder.

    Returns:
        How it ended. Stopping by `control` is no error.

    Raises:
        GsError: bad input, a folder in use, too little memory, a full disk or a diverged training.
        Cancelled: stopped by `control` while the photos were read; nothing was written.
    """
    emit, control = on_event or (lambda event: None), control or Control()
    large_pieces_apart()
    opened = open_folder(output, resume=resume, overwrite=overwrite, data=data)
    with opened as folder, ordinary_state():
        before, damaged = _checkpoint_to_start_from(folder, resume, start_checkpoint)
        if resume and before is not None and not damaged:
            ended = ended_run(folder, before, config, data)
            if ended is not None:
                emit(ended.event())
                return ended
        start = None if config.start_splats is None else read_splats(config.start_splats)
        lpips, lpips_reason = find_lpips(config.lpips, threads=config.threads)
        photos = load_dataset(data, cancelled=lambda: control.stopping)
        frame = None
        if before is not None:
            changed = _other_capture_options(folder, data) if resume else []
            checkpoint.check_compatible(before, config, photos, changed=changed)
            with checkpoint.understood(before.path):
                frame = Frame.from_dict(before.trainer["frame"])
        if data.depths:
            MapFolder(photos.source / data.depths)  # refuses a folder that is not there
        loaded = load_photos(
            photos,
            config,
            splats=start,
            depths=bool(data.depths),
            announce=before is None,
            emit=emit,
            control=control,
        )
        photos.content_hash()  # of what is trained on: when it is wanted, files may be others
        with _memory_in_words():
            depth = prepare_depth(
                data, config, photos, on_progress=progress_of("depth maps", config, emit, control)
            )
            trainer = Trainer(
                config,
                photos,
                frame=frame,
                start=start,
                depth=depth.loss_targets,
                points=depth.points,
                photo_cache=loaded.cache,
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
            del start  # of no more use, and as large as the parameters
            if before is not None:
                with checkpoint.understood(before.path):
                    trainer.restore(before.trainer, before.tensors)
                    session.restore(before.session)
                before.tensors.clear()  # the model replaces them as it grows
                if other_isa := checkpoint.other_isa(before):
                    session.warn(other_isa, "isa")
                for path in damaged:
                    session.warn(_set_aside(path, before.steps), "damaged_checkpoint")
            notes = (*photos.warnings, *loaded.warnings, *look_over(trainer))
            if overwrite:
                folder.clear()
            for message in notes:
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
        except FormatError as error:
            damaged.append(path)
            if len(damaged) == len(paths) > 1:
                raise FormatError(
                    f"All {len(paths)} checkpoints in {path.parent} are damaged, the oldest: "
                    f"{error} Start anew with --overwrite."
                ) from error
            if len(damaged) == len(paths):
                raise FormatError(f"{error} Or start anew with --overwrite.") from error
    return None, []


def _other_capture_options(folder: RunFolder, data: DataConfig) -> list[str]:
    """How `data` differs from the capture's options of the run in a folder, as they are given."""
    with contextlib.suppress(ConfigError):
        stored, _ = load_config(folder.config)
        found = differences(stored, data, ignore=("source", "rig", "test_list"))
        pairs = [change.partition(" ") for change in found]
        return [f"{flag_of(name)} {rest}" for name, _, rest in pairs]
    return []


def _set_aside(path: Path, step: int) -> str:
    """Rename a damaged checkpoint, so that it is not looked at again; a sentence about it."""
    aside = path.with_name(f"{path.name}.damaged")
    try:
        path.replace(aside)
    except OSError as error:
        raise GsError(f"Cannot rename the damaged {path}: {error.strerror}.") from error
    return f"{path.name} is damaged (now {aside.name}); going on from step {step} before it."


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
