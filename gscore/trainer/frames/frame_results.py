"""Frame results of a sequence, read from the run folders of its frames."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ..._version import __version__
from ...config import TrainConfig
from ...config_file import differences
from ...errors import ConfigError
from ...events import ENDED
from ...io.metrics_file import read_metrics
from ...io.runs import read_run
from ...io.sequences import FRAME_FOLDER, SequenceIndex, write_sequence
from ...metrics import headline
from ...sequence_options import SequenceOptions
from ..files import checkpoint
from .plan import PlannedFrame

_LONG = ("history", "evals")
_MEANS = ("psnr", "psnr_masked", "ssim", "lpips")


@dataclass(frozen=True, kw_only=True)
class FrameResult:
    """Result of one frame."""

    number: int
    folder: Path
    start: Path | None
    """PLY of the start splats; None: started from the points of its capture."""
    metrics: dict[str, Any]
    """metrics.json without its lists."""

    def to_dict(self, root: Path) -> dict[str, Any]:
        """Return the result as JSON values, with paths relative to `root`, the sequence folder."""
        keys = ("splats", "steps", "train_seconds", "split", *_means_of([self.metrics]))
        return {
            "frame": self.number,
            "folder": self.folder.relative_to(root).as_posix(),
            "start": None if self.start is None else self.start.parent.name,
        } | {key: self.metrics.get(key) for key in keys}


@dataclass(frozen=True, kw_only=True)
class SequenceResult:
    """Result of a sequence."""

    reason: str
    """`finished`, or why it was stopped."""
    total: int
    """Number of requested frames."""
    frames: list[FrameResult] = field(default_factory=list)
    """Complete frames, in order."""
    output: Path
    """Folder of the sequence."""

    @property
    def headline(self) -> dict[str, Any]:
        """Mean metrics of the complete frames (None unless all have the value), and total seconds;
        `psnr_masked` only if masks hide pixels."""
        metrics = [frame.metrics for frame in self.frames]
        out: dict[str, Any] = {"frames": len(metrics), "frames_total": self.total}
        for key in _means_of(metrics):
            values = [m[key] for m in metrics if m.get(key) is not None]
            whole = values and len(values) == len(metrics)
            out[key] = sum(values) / len(values) if whole else None
        return out | {"train_seconds": sum(m.get("train_seconds") or 0.0 for m in metrics)}


def completed(frame: PlannedFrame) -> FrameResult | None:
    """Return the result of a frame if its training is complete, else None.

    Raises:
        ConfigError: it was trained with other options.
    """
    folder, config = frame.folder, frame.config
    run = read_run(folder)
    if run is None or run.train is None or run.data is None or run.splats is None:
        return None
    # Paths may be written differently, and the folder may have been moved.
    changed = differences(run.train, config, ignore=checkpoint.FREE)
    changed += differences(run.data, frame.data, ignore=("source", "rig", "test_list"))
    was, now = _frame_before(run.train), _frame_before(config)
    if was != now:
        changed.append(f"it started from {was or 'no other frame'}, not {now or 'from none'}")
    if changed:
        raise ConfigError(
            f"{folder} was trained with other options: {'; '.join(changed)}. Use the same options, "
            "or replace the sequence with `--overwrite`."
        )
    metrics = read_metrics(folder)
    if not is_measured(metrics):
        return None
    early = config.time_budget or config.target_psnr or config.early_stop
    try:
        good = metrics["reason"] in ENDED if early else metrics["steps"] >= config.iterations
    except (KeyError, TypeError):
        return None
    return result_of(frame, metrics) if good else None


def is_measured(metrics: dict[str, Any]) -> bool:
    """Return whether a training was evaluated; one stopped just before has steps but no metrics."""
    return bool(metrics.get("views"))


def result_of(frame: PlannedFrame, metrics: dict[str, Any]) -> FrameResult:
    """Return the result of a frame with these final metrics."""
    short = {key: value for key, value in headline(metrics).items() if key not in _LONG}
    return FrameResult(number=frame.number, folder=frame.folder, start=frame.start, metrics=short)


def _frame_before(config: TrainConfig) -> str:
    """Folder name of the frame that a frame starts from; empty: none."""
    start = config.start_splats
    return start.parent.name if start and FRAME_FOLDER.fullmatch(start.parent.name) else ""


def _means_of(metrics: list[dict[str, Any]]) -> list[str]:
    """Keys of the averaged metrics, with `psnr_masked` if any frame has it."""
    masked = any("psnr_masked" in m for m in metrics)
    return [key for key in _MEANS if masked or key != "psnr_masked"]


class SequenceListing:
    """Complete frames of a sequence, trained by any process."""

    def __init__(
        self, output: Path, options: SequenceOptions, frames: Sequence[PlannedFrame]
    ) -> None:
        self._output, self._options, self._frames = output, options, frames
        self._known: dict[int, FrameResult] = {}

    def refresh(self) -> None:
        """Find frames that other processes have completed.

        Raises:
            ConfigError: a frame was trained with other options.
        """
        for place, frame in enumerate(self._frames):
            found = None if place in self._known else completed(frame)
            if found is not None:
                self._known[place] = found

    def add(self, place: int, result: FrameResult) -> None:
        """Add a complete frame."""
        self._known[place] = result

    def result(self, reason: str, places: Sequence[int]) -> SequenceResult:
        """Return the result of the sequence, or of the part at `places`."""
        return SequenceResult(
            reason=reason,
            total=len(places),
            frames=[self._known[place] for place in places if place in self._known],
            output=self._output,
        )

    def write(self) -> None:
        """Write sequence.json, and again if another process completed a frame meanwhile, so that
        the last writer lists all frames in order.

        Raises:
            GsError: the file cannot be written.
        """
        written = -1
        self.refresh()
        while written != len(self._known):
            written = len(self._known)
            whole = self.result("", range(len(self._frames)))
            index = SequenceIndex(
                options=asdict(self._options),
                frames=[frame.to_dict(self._output) for frame in whole.frames],
                mean=whole.headline,
            )
            write_sequence(self._output, index, version=__version__)
            self.refresh()
