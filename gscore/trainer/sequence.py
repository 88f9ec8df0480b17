"""Sequence training: frames one after another, each from the splats of the previous one."""

import contextlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from ..config import DataConfig, TrainConfig
from ..config_file import config_json, differences, from_dict
from ..control import Control
from ..datasets.frames import choose_frames, find_frames
from ..errors import Cancelled, ConfigError, FormatError, GsError
from ..events import ENDED, Event, FrameStarted, SequenceDone, Started, Warn
from ..io.files import atomic_write
from ..io.output_paths import check_output_path
from ..io.runs import check_replaceable, clear_run, results_in
from ..io.sequences import FRAME_FOLDER, SEQUENCE_FILE, read_sequence
from ..live.viewer_clients import ViewerClients
from ..sequence_options import SequenceOptions
from ..text_format import count_text
from .distributed.consistency import all_ready
from .distributed.process_group import ProcessGroup
from .distributed.work_queue import WorkQueue
from .files.run_folder import RunFolder
from .files.run_result import TrainResult
from .frames.frame_results import SequenceListing, SequenceResult, completed, is_measured, result_of
from .frames.plan import (
    PER_FRAME,
    PlannedFrame,
    check_guides,
    check_shareable,
    independent_runs,
    plan_frames,
    run_of_frame,
)
from .run import train

_FREE = ("keep_checkpoints",)
"""Options of a sequence that may differ between processes that train parts of it."""


def train_sequence(
    config: TrainConfig,
    data: DataConfig,
    output: Path,
    on_event: Callable[[Event], None] | None = None,
    control: Control | None = None,
    *,
    options: SequenceOptions | None = None,
    resume: bool = False,
    overwrite: bool = False,
    viewers: ViewerClients | None = None,
    frame: int | None = None,
    group: ProcessGroup | None = None,
    agent: str = "",
) -> SequenceResult:
    """Train every frame into its own folder below `output`.

    The first frame and all keyframes start from the points of their captures, or
    `config.start_splats`, and take `config.iterations` steps; the others start from the splats of
    the previous frame. Complete frames of an interrupted sequence are kept, and an incomplete one
    is resumed. The bits of a frame do not depend on the process that trains it.

    Args:
        config: Training options.
        data: Capture options; see `datasets.frames.find_frames` for `source`.
        output: Folder for the results; created if missing.
        on_event: Called with each event of each frame, with `FrameStarted` before them and
            `SequenceDone` at the end.
        control: Requests of other threads to stop, pause or save.
        options: Selection of frames, keyframes, and the start from the previous frame.
        resume: Resume the sequence in `output`.
        overwrite: Replace the sequence in `output`, or the frames of the run of `frame`.
        viewers: Viewer clients, whose frame requests are rendered between steps.
        frame: Train only the run with this frame number, from its keyframe up to the next, and
            resume it if it has begun. Other processes may train other runs into `output`
            meanwhile. None: all frames.
        group: Process group whose ranks share the runs of frames. All ranks call this with the same
            arguments and reach the same `output`; only rank 0 returns all frames and emits
            `SequenceDone` for all.
        agent: Identifier of the torchrun that restarts lost processes, see `WorkQueue`.

    Returns:
        The result. A stop by `control` is not an error.

    Raises:
        ConfigError: `output` contains another sequence, or none to resume.
        GsError: as `train`, with the frame's name; complete frames stay.
        Cancelled: stopped before the first step of the first frame.
    """
    options = options or SequenceOptions()
    emit, control = on_event or (lambda event: None), control or Control()

    def opened(writes: bool = True) -> _Sequence:
        check_output_path(output, data)
        chosen = choose_frames(find_frames(data), options.frames)
        frames = plan_frames(chosen, config, output, options)
        check_guides(_to_train(frames, options, frame, begun=resume, overwrite=overwrite))
        return _Sequence(config, data, output, options, frames, emit, viewers, writes=writes)

    if group:
        return _train_distributed(
            group, output, opened, control, resume=resume, overwrite=overwrite, agent=agent
        )
    sequence = opened()
    runs = sequence.runs
    if frame is not None:
        runs = [run_of_frame(sequence.frames, runs, frame)]
        _open_part(output, [sequence.frames[i] for i in runs[0]], options, overwrite=overwrite)
        resume = True
    else:
        _open(output, resume=resume, overwrite=overwrite)
    reason = sequence.through(runs, control, resume=resume)
    return sequence.end(reason, [place for run in runs for place in run])


def read_options(output: Path) -> SequenceOptions | None:
    """Return the options of the sequence in a folder, or None if there is none.

    Raises:
        FormatError: its sequence.json is invalid.
    """
    index = read_sequence(output)
    if index is None:
        return None
    try:
        return from_dict(SequenceOptions, index.options, where="options")
    except ConfigError as error:
        raise FormatError(
            f"{output / SEQUENCE_FILE} was written by another gscore ({error}); start a new "
            f"sequence with all options in another folder, without `--resume`."
        ) from error


class _Sequence:
    """One call of `train_sequence`."""

    def __init__(
        self,
        config: TrainConfig,
        data: DataConfig,
        output: Path,
        options: SequenceOptions,
        frames: list[PlannedFrame],
        emit: Callable[[Event], None],
        viewers: ViewerClients | None,
        *,
        writes: bool,
    ) -> None:
        """`writes`: whether this process writes the list of complete frames."""
        self.output = output
        self.frames = frames
        self.runs = independent_runs(len(frames), options)
        """Runs of frames that depend on each other, by index."""
        self._writes = writes
        per_frame = {name: getattr(config, name) for name in PER_FRAME}
        self._config = config_json(data, replace(frames[0].config, **per_frame)).encode()
        self._options = options
        self._emit = emit
        self._viewers = viewers
        self._listed = SequenceListing(output, options, frames)
        self._done = 0

    def through(self, runs: Iterable[range], control: Control, *, resume: bool) -> str:
        """Train the incomplete frames of these runs; returns the reason of the end."""
        if resume:
            self._listed.refresh()
        for place in (place for run in runs for place in run):
            if self._done and control.stop_reason:
                return control.stop_reason
            reason = self._frame(place, control, resume=resume)
            if reason != "finished":
                return reason
        return "finished"

    def end(self, reason: str, places: Sequence[int]) -> SequenceResult:
        """Emit and return the result of the frames at `places`."""
        result = self._listed.result(reason, places)
        self._emit(
            SequenceDone(
                reason=reason,
                frames=len(result.frames),
                path=str(self.output / SEQUENCE_FILE),
                train_seconds=result.headline["train_seconds"],
                metrics=result.headline,
            )
        )
        return result

    def write(self) -> None:
        """Write the options and the list of complete frames, if this process `writes`."""
        if self._writes:
            atomic_write(self.output / "config.json", self._config)
            self._listed.write()

    def write_if_begun(self) -> None:
        """Like `write`, after all processes have ended; no effect if no frame was started."""
        if _begun(self.output):
            self.write()

    def warn(self, message: str) -> None:
        """Emit a warning for the whole sequence."""
        self._emit(Warn(message=message))

    def _frame(self, place: int, control: Control, *, resume: bool) -> str:
        """Train a frame unless it is complete; returns the reason of the end."""
        frame = self.frames[place]
        result = completed(frame) if resume else None
        self._emit(
            FrameStarted(
                frame=frame.number,
                place=place + 1,
                frames=len(self.frames),
                output=str(frame.folder),
                iterations=frame.config.iterations,
                start="" if frame.start is None else str(frame.start),
                complete=result is not None,
            )
        )
        if result is None:
            try:
                ended = self._train(frame, control, resume=resume)
            except Cancelled:
                if not self._done:
                    raise
                return control.stop_reason
            if ended.reason not in ENDED:
                return ended.reason
            if not is_measured(ended.metrics):
                return control.stop_reason
            result = result_of(frame, ended.metrics)
        self._listed.add(place, result)
        self._done += 1
        if not self._options.keep_checkpoints:
            # Checkpoints are three times as large as the splats, and complete frames need none.
            marks = frame.config.checkpoint_iterations
            RunFolder(frame.folder).drop_checkpoints(keep=0, protected=marks)
        self._list()
        return "finished"

    def _train(self, frame: PlannedFrame, control: Control, *, resume: bool) -> TrainResult:
        resumes = resume and bool(RunFolder(frame.folder).checkpoints())
        try:
            return train(
                frame.config,
                frame.data,
                frame.folder,
                self._on_event,
                control,
                resume=resumes,
                overwrite=not resumes,
                viewers=self._viewers,
            )
        except GsError as error:
            raise type(error)(f"{frame.folder.name}: {error}") from error
        finally:
            with contextlib.suppress(OSError):
                self.output.rmdir()  # only if nothing was ever written

    def _on_event(self, event: Event) -> None:
        if isinstance(event, Started):  # options and captures have been checked
            self.write()
        self._emit(event)

    def _list(self) -> None:
        if self._writes:
            self._listed.write()


def _to_train(
    frames: list[PlannedFrame],
    options: SequenceOptions,
    number: int | None,
    *,
    begun: bool,
    overwrite: bool,
) -> list[PlannedFrame]:
    """Return the incomplete frames: of all, or of the run with the frame `number`.

    `begun`: existing frames are resumed.
    """
    if number is not None:
        run = run_of_frame(frames, independent_runs(len(frames), options), number)
        frames, begun = [frames[place] for place in run], not overwrite
    return [frame for frame in frames if not (begun and completed(frame))]


def _train_distributed(
    group: ProcessGroup,
    output: Path,
    opened: Callable[[bool], _Sequence],
    control: Control,
    *,
    resume: bool,
    overwrite: bool,
    agent: str,
) -> SequenceResult:
    """Train runs of frames in turn with the other ranks until none is left."""
    shared = WorkQueue(group=group, output=output, agent=agent)
    with all_ready(group):
        sequence = opened(group.is_rank0)
        idle = check_shareable(sequence.runs, group.size)
        if group.is_rank0:
            begun = shared.has_started
            resume, overwrite = resume or begun, overwrite and not begun
            _open(output, resume=resume, overwrite=overwrite, ours=begun)
    if idle:
        sequence.warn(idle)
    runs, through = sequence.runs, sequence.through
    reason = shared.work(
        len(runs),
        lambda turns, resume: through((runs[turn] for turn in turns), control, resume=resume),
        resume=resume,
        close=sequence.write_if_begun,
    )
    return sequence.end(reason, range(len(sequence.frames)))


def _open(output: Path, *, resume: bool, overwrite: bool, ours: bool = False) -> None:
    """Raise unless a sequence may be trained into `output`, and clear it with `overwrite`.

    `ours`: this sequence opened it before, and may have ended before the first frame.
    """
    begun = _begun(output)
    if read_sequence(output) is None and not begun:
        if resume and not ours:
            raise ConfigError(f"{output} contains no sequence to resume; leave `--resume` out.")
        _check_no_run(output)
    elif overwrite:
        _clear(begun)
        (output / SEQUENCE_FILE).unlink(missing_ok=True)
    elif not resume:
        raise ConfigError(
            f"{output} contains another sequence ({count_text(len(begun), 'frame')} started); "
            "continue it with `--resume`, replace it with `--overwrite`, or choose another folder."
        )


def _open_part(
    output: Path, frames: Sequence[PlannedFrame], options: SequenceOptions, *, overwrite: bool
) -> None:
    """Check that these frames may be trained into `output` next to others, which stay.

    Raises:
        ConfigError: the other frames belong to another sequence.
    """
    stored = read_options(output)
    if stored is None and not _begun(output):
        _check_no_run(output)
    if stored is not None:
        changed = differences(stored, options, ignore=_FREE)
        if changed:
            raise ConfigError(
                f"{output} contains frames of a sequence with other options: "
                f"{'; '.join(changed)}. All parts of a sequence need the same options."
            )
    if overwrite:
        folders = {frame.folder for frame in frames}
        _clear([path for path in _begun(output) if path in folders])


def _begun(output: Path) -> list[Path]:
    """Return the folders of frames with results."""
    frames = [path for path in output.glob("frame_*") if FRAME_FOLDER.fullmatch(path.name)]
    return sorted(path for path in frames if results_in(path))


def _check_no_run(output: Path) -> None:
    if names := results_in(output):
        raise ConfigError(
            f"{output} contains a single run ({', '.join(names)}); choose another folder."
        )


def _clear(folders: Sequence[Path]) -> None:
    for path in folders:
        check_replaceable(path)
    for path in folders:
        clear_run(path)
