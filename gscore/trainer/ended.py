"""A run that is to go on but has ended already: its results are given back as they lie there."""

from typing import Any

from ..config import DataConfig, TrainConfig
from ..config_file import config_json
from ..events import ENDED, FINISHED
from ..io.files import read_bytes
from ..io.metrics_file import read_metrics
from ..io.ply import read_splats
from .checkpoint import Checkpoint
from .folder import RunFolder
from .session import TrainResult


def ended_run(
    folder: RunFolder, last: Checkpoint, config: TrainConfig, data: DataConfig
) -> TrainResult | None:
    """The result of the run in `folder` if nothing is left to do and nothing else is asked for.

    Args:
        folder: Of the run.
        last: Its last checkpoint.
        config: What is asked for now.
        data: The same.

    Returns:
        What the training returned then; None: there are steps left, results are missing, or an
        option is not what it was.
    """
    metrics = read_metrics(folder.path)
    if metrics.get("steps") != last.steps or metrics.get("psnr") is None:
        return None
    reason = _reason(metrics, last, config)
    if reason not in ENDED or not folder.point_cloud.is_file() or not folder.config.is_file():
        return None
    if read_bytes(folder.config) != config_json(data, config).encode():
        return None
    return TrainResult(
        reason=reason,
        steps=last.steps,
        splats=read_splats(folder.point_cloud),
        train_seconds=float(metrics.get("train_seconds") or 0.0),
        metrics=metrics,
        output=folder.path,
        ended_before=True,
    )


def _reason(metrics: dict[str, Any], last: Checkpoint, config: TrainConfig) -> str:
    """Why the run ended; `gscore eval` writes metrics.json without it."""
    whole = not config.time_budget and last.steps == config.iterations
    return str(metrics.get("reason") or (FINISHED if whole else ""))
