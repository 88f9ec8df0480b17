"""Frame results of a sequence, read from the run folders of its frames."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...config import TrainConfig
from ...config_file import differences
from ...errors import ConfigError
from ...events import ENDED
from ...io.metrics_file import read_metrics
from ...io.runs import read_run
from ...io.sequences import FRAME_FOLDER
from ...metrics import headline
from ..files import checkpoint
from .plan import PlannedFrame

_LONG = ("history", "evals")
_MEANS = ("psnr", "psnr_masked", "ssim", "lpips")


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


def completed(frame: PlannedFrame) -> FrameResult | None:
    """The result of a frame that needs no more training, or None.

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
    was, wanted = _frame_before(run.train), _frame_before(config)
    if was != wanted:
        changed.append(f"it started from {was or 'no other frame'}, not {wanted or 'from none'}")
    if changed:
        raise ConfigError(
            f"{folder} was trained with other options: {'; '.join(changed)}. Use the same options, "
            "or replace the sequence with --overwrite."
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
    """Whether a training got as far as its evaluation: one that was stopped just before has taken
    all steps and has nothing to say about them."""
    return bool(metrics.get("views"))


def result_of(frame: PlannedFrame, metrics: dict[str, Any]) -> FrameResult:
    """The result of a frame whose training has ended with these metrics."""
    short = {key: value for key, value in headline(metrics).items() if key not in _LONG}
    return FrameResult(number=frame.number, folder=frame.folder, start=frame.start, metrics=short)


def _frame_before(config: TrainConfig) -> str:
    """The folder of the frame whose splats a frame starts from; empty: it starts from none."""
    start = config.start_splats
    return start.parent.name if start and FRAME_FOLDER.fullmatch(start.parent.name) else ""


def _means_of(metrics: list[dict[str, Any]]) -> list[str]:
    """Keys of the figures that frames are judged by: `psnr_masked` where any has it."""
    masked = any("psnr_masked" in m for m in metrics)
    return [key for key in _MEANS if masked or key != "psnr_masked"]
