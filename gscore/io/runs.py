"""The folder a training left behind, read without torch: how far it is, and what may be removed."""

import contextlib
import math
import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..config import DataConfig, TrainConfig
from ..config_file import load_config
from ..errors import ConfigError, DatasetError
from ..events import CONVERGED, FINISHED, TARGET, judged_psnr
from ..json_text import parse_json
from .files import read_bytes

RUN_LOCK = ".gscore.lock"
"""The file by which a training holds its folder."""
RUN_FILES = (
    "config.json",
    "cfg_args",
    "cameras.json",
    "point_cloud.ply",
    "metrics.json",
    "report.html",
)
"""Files that a training writes."""
RUN_FOLDERS = ("checkpoints", "point_cloud", "previews", "snapshots")
"""Folders that a training writes."""

_CHECKPOINT = re.compile(r"step_(\d{8,})\.safetensors")
_UNFINISHED = tuple(f".{name}.*.tmp" for name in RUN_FILES)
"""What `atomic_write` leaves of a file when its process is killed."""
_UNFINISHED_BELOW = (".*.safetensors.????????.tmp", ".*.ply.????????.tmp", ".*.png.????????.tmp")
"""The same in the folders of a run."""


@dataclass(frozen=True, kw_only=True)
class RunInfo:
    """What the folder of a run tells about it."""

    path: Path
    steps: int
    """Steps taken when the last checkpoint was written; 0 without one."""
    iterations: int
    """Steps the run was asked for, or took where it ended by itself; 0 if its options cannot be
    read."""
    checkpoint: Path | None
    """The last checkpoint."""
    splats: Path | None
    """point_cloud.ply, where it is written already."""
    psnr: float | None
    """Of the last evaluation, dB; see `gscore.judged_psnr`."""
    data: DataConfig | None
    """Options of the run, None where config.json is missing or broken."""
    train: TrainConfig | None
    problem: str
    """Why the run cannot go on though there is a checkpoint; empty if it can."""

    @property
    def finished(self) -> bool:
        """Whether all steps were taken."""
        return 0 < self.iterations <= self.steps

    @property
    def resumable(self) -> bool:
        """Whether `gscore train --resume` has steps left to take."""
        return self.checkpoint is not None and not self.problem and not self.finished


def read_run(path: str | Path) -> RunInfo | None:
    """How far the training in an output folder is, or None if no training has written there.

    Looks at names and at two small JSON files; checkpoints are not opened.
    """
    path = Path(path)
    if not results_in(path):
        return None
    data, train, problem = None, None, ""
    try:
        data, train = load_config(path / "config.json")
    except (ConfigError, OSError) as error:
        problem = str(error)
    steps, checkpoint = max(checkpoints_in(path).items(), default=(0, None))
    splats, metrics = path / "point_cloud.ply", read_metrics(path)
    return RunInfo(
        path=path,
        steps=steps,
        iterations=_length(train, steps, metrics),
        checkpoint=checkpoint,
        splats=splats if splats.is_file() else None,
        psnr=_number(judged_psnr(metrics)),
        data=data,
        train=train,
        problem=problem,
    )


def checkpoint_path(path: Path, step: int) -> Path:
    """Where the run in a folder keeps its checkpoint after `step`."""
    return path / "checkpoints" / f"step_{step:08d}.safetensors"


def checkpoints_in(path: Path) -> dict[int, Path]:
    """The checkpoints of the run in a folder by their steps, the latest last; none is opened."""
    found = {
        int(match[1]): file
        for file in (path / "checkpoints").glob("*.safetensors")
        if (match := _CHECKPOINT.fullmatch(file.name)) and file.is_file()
    }
    return dict(sorted(found.items()))


def read_metrics(path: Path) -> dict[str, Any]:
    """The metrics.json that a training or an evaluation left in a folder.

    Returns:
        Its content; empty where it is missing, broken or no regular file.
    """
    try:
        content = parse_json(read_bytes(path / "metrics.json"))
    except (DatasetError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def results_in(path: Path) -> list[str]:
    """Names of files and folders in `path` that a training has written."""
    return [name for name in (*RUN_FILES, *RUN_FOLDERS) if (path / name).exists()]


def remove_results(path: Path) -> None:
    """Remove what a training has written into a folder, and nothing else.

    Raises:
        OSError: a file cannot be removed.
    """
    for name in RUN_FOLDERS:
        shutil.rmtree(path / name, ignore_errors=True)
    for name in RUN_FILES:
        (path / name).unlink(missing_ok=True)


def clear_run(path: str | Path) -> None:
    """Remove what a training has written into a folder and the folder if nothing else is in it.

    Only for a folder in which no training is running. What cannot be removed stays.
    """
    path = Path(path)
    with contextlib.suppress(OSError):
        remove_results(path)
    clear_unfinished(path)
    with contextlib.suppress(OSError):
        (path / RUN_LOCK).unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        path.rmdir()  # only an empty folder can be removed


def clear_unfinished(path: Path) -> None:
    """Remove what a killed training was just writing; only while no other one is running there."""
    leftovers = [file for pattern in _UNFINISHED for file in path.glob(pattern)]
    for name in RUN_FOLDERS:
        for pattern in _UNFINISHED_BELOW:
            leftovers += (path / name).rglob(pattern)
    for file in leftovers:
        with contextlib.suppress(OSError):
            file.unlink(missing_ok=True)


def _number(value: Any) -> float | None:
    good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if good else None


def _length(train: TrainConfig | None, steps: int, metrics: dict[str, Any]) -> int:
    """Steps of a run; budgets and goals leave them open until it has ended."""
    if train is None:
        return 0
    early = (TARGET, CONVERGED, FINISHED) if train.time_budget else (TARGET, CONVERGED)
    if steps and metrics.get("steps") == steps and metrics.get("reason") in early:
        return steps
    return 0 if train.time_budget else train.iterations
