"""Run result: the return value of `train`, also for a run that had already finished."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...config import DataConfig, TrainConfig
from ...config_file import config_json
from ...events import ENDED, FINISHED, Done, headline_psnr
from ...io.block_record import RUN_BLOCK, read_block
from ...io.files import read_bytes
from ...io.metrics_file import read_metrics
from ...io.ply.splats import read_ply
from ...metrics import headline
from ...splats import Splats
from .checkpoint import Checkpoint
from .run_folder import RunFolder


@dataclass(frozen=True, kw_only=True)
class TrainResult:
    """Result of a run."""

    reason: str
    """`finished`; `target` or `converged`: ended before the last step; or why it was stopped."""
    steps: int
    """Number of steps taken."""
    splats: Splats
    """Splats in COLMAP world units, as written to point_cloud.ply."""
    train_seconds: float
    """Time spent in steps, without evaluation, files and pauses."""
    metrics: dict[str, Any]
    """Content of metrics.json."""
    output: Path
    """Output folder."""
    ended_before: bool = False
    """True if the run was to be resumed but had already ended."""

    @property
    def psnr(self) -> float | None:
        """Headline PSNR, dB: `gscore.headline_psnr` of the metrics."""
        return headline_psnr(self.metrics)

    @property
    def headline(self) -> dict[str, Any]:
        """Metrics without long lists, as in the output of `--json` and in `Done`."""
        long = ("history", "evals")
        return {k: v for k, v in headline(self.metrics).items() if k not in long}

    def event(self) -> Done:
        """Return the last event of a run."""
        return Done(
            step=self.steps,
            reason=self.reason,
            splats=len(self.splats),
            train_seconds=self.train_seconds,
            path=str(RunFolder(self.output).point_cloud),
            metrics=self.headline,
        )


def finished_run(
    folder: RunFolder, last: Checkpoint, config: TrainConfig, data: DataConfig
) -> TrainResult | None:
    """Return the result of the run in `folder` if it is complete with the same options.

    Args:
        folder: Output folder of the run.
        last: Its last checkpoint.
        config: Options now.
        data: Options of the capture now.

    Returns:
        The result; None: steps are left, results are missing, or an option changed.
    """
    metrics = read_metrics(folder.path)
    if metrics.get("steps") != last.steps or metrics.get("psnr") is None:
        return None
    reason = _reason(metrics, last, config)
    if reason not in ENDED or not folder.point_cloud.is_file() or not folder.config.is_file():
        return None
    if read_bytes(folder.config) != config_json(data, config).encode():
        return None
    if not _same_block(folder.path, data.source):
        return None
    return TrainResult(
        reason=reason,
        steps=last.steps,
        splats=read_ply(folder.point_cloud),
        train_seconds=float(metrics.get("train_seconds") or 0.0),
        metrics=metrics,
        output=folder.path,
        ended_before=True,
    )


def _same_block(run: Path, source: Path) -> bool:
    """Return whether `source` is still the block that a run was trained on; True without blocks."""
    was, now = read_block(run, RUN_BLOCK), read_block(source)
    return was is None or (now is not None and now.is_cell_of(was))


def _reason(metrics: dict[str, Any], last: Checkpoint, config: TrainConfig) -> str:
    """Reason why the run ended; metrics.json of `gscore eval` has none."""
    whole = not config.time_budget and last.steps == config.iterations
    return str(metrics.get("reason") or (FINISHED if whole else ""))
