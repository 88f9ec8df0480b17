"""`train`: everything that must be right before the first step, then a session."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ..config import DataConfig, Switch, TrainConfig
from ..control import Control
from ..datasets import load_dataset
from ..depth.maps import MapFolder
from ..errors import BackendError
from ..events import Event
from ..live.onlookers import Onlookers
from ..metrics import find_lpips, lpips_warnings
from .beginning import Beginning
from .depth.setup import prepare_depth
from .depth.stereo import StereoStart, stereo_start
from .files.ended import TrainResult
from .files.folder import open_folder
from .host.heap import large_pieces_apart
from .host.state import ordinary_state
from .photos.loading import load_photos, progress_of
from .premises import look_over
from .schedule.enough import enough_steps
from .session import Session
from .trainer import Trainer
from .views.judged import judge_photos


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
    onlookers: Onlookers | None = None,
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
        onlookers: Those who watch, whose pictures are drawn between steps.

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
        beginning = Beginning(
            folder, config, data, resume=resume, start_checkpoint=start_checkpoint
        )
        if beginning.ended is not None:
            emit(beginning.ended.event())
            return beginning.ended
        lpips, lpips_reason = find_lpips(config.lpips, threads=config.threads)
        photos = load_dataset(data, cancelled=lambda: control.stopping)
        config, enough = enough_steps(
            config, photos=len(photos.train), mask_mode=photos.mask_mode, taken=beginning.taken
        )
        frame = beginning.frame(photos)
        if data.depths:
            MapFolder(photos.source / data.depths)  # refuses a folder that is not there
        loaded = load_photos(
            photos,
            config,
            splats=beginning.splats,
            depths=bool(data.depths),
            announce=not beginning.goes_on,
            emit=emit,
            control=control,
        )
        photos.content_hash()  # of what is trained on: when it is wanted, files may be others
        with _memory_in_words():
            depth = prepare_depth(
                data, config, photos, on_progress=progress_of("depth maps", config, emit, control)
            )
            points = photos.scene.points if depth.points is None else depth.points
            stereo = StereoStart()
            if beginning.wants_stereo:
                telling = progress_of("depth of photos", config, emit, control)
                stereo = stereo_start(config, photos, points, on_view=telling)
            exposure, placing = judge_photos(config, photos)
            trainer = Trainer(
                config,
                photos,
                frame=frame,
                start=beginning.splats,
                depth=depth.loss_targets,
                points=points if stereo.points is None else stereo.points,
                gains=exposure.gains,
                placing=placing,
                photo_cache=loaded.cache,
            )
            session = Session(
                trainer,
                folder,
                data,
                emit=emit,
                control=control,
                lpips=lpips,
                lpips_reason=lpips_reason,
                depth=depth,
                stereo=stereo,
                exposure=exposure,
                placing=placing,
                onlookers=onlookers,
                enough=enough,
            )
            beginning.go_on(trainer, session)
            notes = (*photos.warnings, *loaded.warnings, *look_over(trainer))
            if overwrite:
                folder.clear()
            for message in notes:
                session.warn(message, "capture")
            for message in lpips_warnings(lpips_reason):
                session.warn(message, "evaluation")
            for message in depth.warnings:
                session.warn(message, "depth")
            if stereo.why and not stereo.added and config.stereo is Switch.ON:
                session.warn(stereo.why, "stereo")
            return session.run()


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
