"""Trains the frames of a sequence one after another, each from the splats of the one before."""

import contextlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from .._version import __version__
from ..config import DataConfig, TrainConfig
from ..config_file import config_json, differences, from_dict
from ..control import Control
from ..datasets.frames import SequenceFrame, choose_frames, find_frames
from ..errors import Cancelled, ConfigError, FormatError, GsError
from ..events import ENDED, Event, FrameStarted, SequenceDone, Started
from ..io.files import atomic_write
from ..io.metrics_file import read_metrics
from ..io.places import check_place
from ..io.runs import check_replaceable, clear_run, read_run, results_in
from ..io.sequences import FRAME_FOLDER, SEQUENCE_FILE, SequenceIndex, read_sequence, write_sequence
from ..live.onlookers import Onlookers
from ..metrics import headline
from ..sequence_options import SequenceOptions
from ..words import count_words
from .files import checkpoint
from .files.folder import RunFolder
from .run import train

_LONG = ("history", "evals")
_MEANS = ("psnr", "psnr_masked", "ssim", "lpips")


def _means_of(metrics: list[dict[str, Any]]) -> list[str]:
    """Keys of the figures that frames are judged by: `psnr_masked` where any has it."""
    masked = any("psnr_masked" in m for m in metrics)
    return [key for key in _MEANS if masked or key != "psnr_masked"]


@dataclass(frozen=True, kw_only=True)
class FrameResult:
    """How the training of one frame ended."""

    number: int
    folder: Path
    start: Path | None
    """PLY it started from; None: from the points of its capture."""
    metrics: dict[str, Any]
    """metrics.json without its lists."""

    def to_dict(self, root: Path) -> dict[str, Any]:
        """The result as JSON values, with paths relative to the folder of the sequence."""
        keys = ("splats", "steps", "train_seconds", "split", *_means_of([self.metrics]))
        return {
            "frame": self.number,
            "folder": self.folder.relative_to(root).as_posix(),
            "start": None if self.start is None else self.start.parent.name,
        } | {key: self.metrics.get(key) for key in keys}


@dataclass(frozen=True, kw_only=True)
class SequenceResult:
    """How a sequence ended."""

    reason: str
    """`finished`, or why it was stopped."""
    total: int
    """Frames that were asked for."""
    frames: list[FrameResult] = field(default_factory=list)
    """Those that are complete, in order."""
    output: Path

    @property
    def headline(self) -> dict[str, Any]:
        """Means over the complete frames (None unless all have the value), and their seconds;
        `psnr_masked` only where masks hide pixels."""
        metrics = [frame.metrics for frame in self.frames]
        out: dict[str, Any] = {"frames": len(metrics), "frames_total": self.total}
        for key in _means_of(metrics):
            values = [m[key] for m in metrics if m.get(key) is not None]
            whole = values and len(values) == len(metrics)
            out[key] = sum(values) / len(values) if whole else None
        return out | {"train_seconds": sum(m.get("train_seconds") or 0.0 for m in metrics)}


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
    onlookers: Onlookers | None = None,
) -> SequenceResult:
    """Train every frame into a folder of its own below `output`.

    The first frame starts from the points of its capture, or `config.start_splats`, and takes
    `config.iterations` steps; the others start from the splats of the frame before. Frames that an
    interrupted sequence has completed are kept, one that it has begun goes on from its checkpoint.

    Args:
        config: How to train.
        data: What to train on; see `datasets.frames.find_frames` for `source`.
        output: Folder for the results; made if it is not there.
        on_event: Called with each event of each frame, with `FrameStarted` before them and
            `SequenceDone` at the end.
        control: Through which others ask to stop, pause or save.
        options: Which frames, and what goes from one to the next.
        resume: Go on with the sequence in `output`.
        overwrite: Replace the sequence in `output`.
        onlookers: Those who watch, whose pictures are drawn between steps.

    Returns:
        How it ended. Stopping by `control` is no error.

    Raises:
        ConfigError: `output` holds another sequence, or none to resume.
        GsError: as `train`, with the frame's name; frames that are complete stay.
        Cancelled: stopped before the first step of the first frame.
    """
    options = options or SequenceOptions()
    check_place(output, data)
    frames = choose_frames(find_frames(data), options.frames)
    _open(output, resume=resume, overwrite=overwrite)
    emit = on_event or (lambda event: None)
    run = _Run(config, data, output, options, frames, emit, onlookers)
    return run.through(control or Control(), resume=resume)


def read_options(output: Path) -> SequenceOptions | None:
    """Options of the sequence in a folder, or None if there is none.

    Raises:
        FormatError: its sequence.json is something else.
    """
    index = read_sequence(output)
    if index is None:
        return None
    try:
        return from_dict(SequenceOptions, index.options, where="options")
    except ConfigError as error:
        raise FormatError(
            f"{output / SEQUENCE_FILE} was written by another gscore ({error}); give all options "
            f"without --resume, in another folder."
        ) from error


class _Run:
    """One call of `train_sequence`."""

    def __init__(
        self,
        config: TrainConfig,
        data: DataConfig,
        output: Path,
        options: SequenceOptions,
        frames: list[SequenceFrame],
        emit: Callable[[Event], None],
        onlookers: Onlookers | None,
    ) -> None:
        self._config = replace(config, steps_a_photo=0)  # frames take what was asked for
        self._data = data
        self._output = output
        self._options = options
        self._frames = frames
        self._emit = emit
        self._onlookers = onlookers
        self._complete: list[FrameResult] = []

    def through(self, control: Control, *, resume: bool) -> SequenceResult:
        """Train all frames that are not complete."""
        for place in range(len(self._frames)):
            reason = self._frame(place, control, resume=resume)
            if reason == "finished" and place + 1 < len(self._frames):
                reason = control.stop_reason or reason
            if reason != "finished":
                return self._end(reason)
        return self._end("finished")

    def _frame(self, place: int, control: Control, *, resume: bool) -> str:
        """Train a frame unless it is complete; why that ended."""
        frame = self._frames[place]
        folder = self._output / frame.name
        config, data = self._config_of(place), self._data_of(place)
        metrics = _completed(folder, config, data) if resume else None
        self._emit(
            FrameStarted(
                frame=frame.number,
                place=place + 1,
                frames=len(self._frames),
                output=str(folder),
                iterations=config.iterations,
                start="" if config.start_splats is None else str(config.start_splats),
                complete=metrics is not None,
            )
        )
        if metrics is None:
            goes_on = resume and bool(RunFolder(folder).checkpoints())
            try:
                result = train(
                    config,
                    data,
                    folder,
                    self._tell,
                    control,
                    resume=goes_on,
                    overwrite=not goes_on,
                    onlookers=self._onlookers,
                )
            except Cancelled:
                if not self._complete:
                    raise
                return control.stop_reason
            except GsError as error:
                raise type(error)(f"{frame.name}: {error}") from error
            finally:
                with contextlib.suppress(OSError):
                    self._output.rmdir()  # only if nothing was ever written
            if result.reason not in ENDED:
                return result.reason
            metrics = _short(result.metrics)
        self._complete.append(
            FrameResult(
                number=frame.number, folder=folder, start=config.start_splats, metrics=metrics
            )
        )
        if not self._options.keep_checkpoints:
            # They are three times as large as the splats, and only a frame in training needs them.
            RunFolder(folder).drop_checkpoints(keep=0, protected=config.checkpoint_iterations)
        self._write_index()
        return "finished"

    def _config_of(self, place: int) -> TrainConfig:
        config, options = self._config, self._options
        if place == 0 or not options.warm_start:
            return config
        return replace(
            config,
            iterations=options.next_iterations or max(1, config.iterations // 4),
            time_budget=config.time_budget / 4,
            start_splats=RunFolder(self._complete[-1].folder).point_cloud.absolute(),
            start_opacity=options.carried_opacity,
            prune_share=0.0,  # else each frame would have fewer than the one before
        )

    def _data_of(self, place: int) -> DataConfig:
        """What to read of a frame: with the first one's rig, unless both read the same cameras."""
        data, first = self._frames[place].data, self._frames[0].data
        if not self._options.fixed_rig or data.source == first.source:
            return data
        return replace(data, rig=first.source.absolute())

    def _tell(self, event: Event) -> None:
        if isinstance(event, Started):  # from here on, options and captures are known to be good
            text = config_json(self._data, self._config)
            atomic_write(self._output / "config.json", text.encode())
            self._write_index()
        self._emit(event)

    def _write_index(self) -> None:
        index = SequenceIndex(
            options=asdict(self._options),
            frames=[frame.to_dict(self._output) for frame in self._complete],
            mean=self._result("").headline,
        )
        write_sequence(self._output, index, version=__version__)

    def _result(self, reason: str) -> SequenceResult:
        return SequenceResult(
            reason=reason,
            total=len(self._frames),
            frames=list(self._complete),
            output=self._output,
        )

    def _end(self, reason: str) -> SequenceResult:
        result = self._result(reason)
        self._emit(
            SequenceDone(
                reason=reason,
                frames=len(self._complete),
                path=str(self._output / SEQUENCE_FILE),
                train_seconds=result.headline["train_seconds"],
                metrics=result.headline,
            )
        )
        return result


def _open(output: Path, *, resume: bool, overwrite: bool) -> None:
    """Raise unless a sequence may be trained into `output`, and clear it for another one."""
    frames = [path for path in output.glob("frame_*") if FRAME_FOLDER.fullmatch(path.name)]
    begun = sorted(path for path in frames if results_in(path))
    if read_sequence(output) is None and not begun:
        if resume:
            raise ConfigError(f"{output} holds no sequence to resume; leave --resume out.")
        if names := results_in(output):
            raise ConfigError(
                f"{output} holds a run of its own ({', '.join(names)}); choose another folder."
            )
    elif overwrite:
        for path in begun:
            check_replaceable(path)
        for path in begun:
            clear_run(path)
        (output / SEQUENCE_FILE).unlink(missing_ok=True)
    elif not resume:
        raise ConfigError(
            f"{output} holds another sequence ({count_words(len(begun), 'frame')} begun); go on "
            "with it with --resume, replace it with --overwrite, or choose another folder."
        )


def _completed(folder: Path, config: TrainConfig, data: DataConfig) -> dict[str, Any] | None:
    """The metrics of a frame that needs no more training, or None.

    Raises:
        ConfigError: it was trained with other options.
    """
    run = read_run(folder)
    if run is None or run.train is None or run.data is None or run.splats is None:
        return None
    # Paths may be written differently, and the folder may have been moved.
    changed = differences(run.train, config, ignore=checkpoint.FREE)
    changed += differences(run.data, data, ignore=("source", "rig", "test_list"))
    if changed:
        raise ConfigError(
            f"{folder} was trained with other options: {'; '.join(changed)}. Use the same options, "
            "or replace the sequence with --overwrite."
        )
    metrics = read_metrics(folder)
    early = config.time_budget or config.target_psnr or config.early_stop
    try:
        good = metrics["reason"] in ENDED if early else metrics["steps"] >= config.iterations
    except (KeyError, TypeError):
        return None
    return _short(metrics) if good else None


def _short(metrics: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in headline(metrics).items() if key not in _LONG}
