"""Run folder of a training, read without torch: progress, and files that may be removed."""

import contextlib
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..config import DataConfig, TrainConfig
from ..config_file import load_config
from ..errors import ConfigError, DatasetError
from ..events import CONVERGED, FINISHED, TARGET, headline_psnr
from ..json_text import parse_json
from .block_record import RUN_BLOCK
from .exposure_json import EXPOSURE_FILE
from .files import read_bytes
from .lock import FolderLock
from .metrics_file import read_metrics
from .poses_json import POSES_FILE

RUN_LOCK = ".gscore.lock"
"""Lock file of a training."""
AGENT = ".torchrun"
"""File with the torchrun that started the training in a folder, until that has ended."""
RUN_FILES = (
    "config.json",
    "cfg_args",
    "cameras.json",
    EXPOSURE_FILE,
    POSES_FILE,
    RUN_BLOCK,
    "point_cloud.ply",
    "metrics.json",
    "report.html",
    "view.html",
)
"""Files that a training writes, and the web page made of it."""
RUN_FOLDERS = ("checkpoints", "point_cloud", "previews", "snapshots")
"""Folders that a training writes."""
GUIDES = "guides"
"""Folder of the meshes and boxes that guide a training, written by a front end."""
GUIDE_FILE = re.compile(
    r"(?P<role>surface|free)-[0-9a-f]{8}(-\d{6,})?\.ply|within-[0-9a-f]{8}\.json"
)
"""Names of the add-on's files in GUIDES: meshes, for one frame or all, and boxes."""
CAPTURE = "capture"
"""Folder of the capture made from plain photos, reused by the next training."""
SEARCH_RECORD = "sfm.json"
"""Record of SfM by gscore in a capture: its results and photos."""
MADE_OF = "made_of"
"""Key of that record: absolute path of the photos' folder or the video."""

_MOST_STATED = 1 << 27
"""Most bytes of a checkpoint's header."""
_CHECKPOINT = re.compile(r"step_(\d{8,})\.safetensors")
_SNAPSHOT = re.compile(r"step_(\d{6,})\.ply")
_BELOW = (
    rf"checkpoints/{_CHECKPOINT.pattern}(\.damaged)?",
    r"point_cloud/iteration_\d+/point_cloud\.ply",
    r"previews/step_\d{6,}\.png",
    rf"snapshots/{_SNAPSHOT.pattern}",
)
_NAMES = re.compile("|".join((*map(re.escape, RUN_FILES), *_BELOW)))
"""All paths below its folder that a training can write, with any options."""
_TEMPORARY = re.compile(r"\.(.+)\.[0-9a-f]{8}\.tmp")
"""Temporary files that `atomic_write` leaves when its process is killed."""


@dataclass(frozen=True, kw_only=True)
class RunInfo:
    """State of a run from the files in its folder."""

    path: Path
    steps: int
    """Steps taken at the last checkpoint; 0 without one."""
    iterations: int
    """Steps requested, or taken if the run ended early; 0 if its options cannot be read."""
    checkpoint: Path | None
    """The last checkpoint."""
    splats: Path | None
    """point_cloud.ply, if already written."""
    psnr: float | None
    """PSNR of the last evaluation, dB; see `gscore.headline_psnr`."""
    data: DataConfig | None
    """Options of the run; None if config.json is missing or broken."""
    train: TrainConfig | None
    problem: str
    """Reason why the run cannot be resumed from its checkpoint; empty if it can."""

    @property
    def finished(self) -> bool:
        """True if all steps were taken."""
        return 0 < self.iterations <= self.steps

    @property
    def resumable(self) -> bool:
        """True if `gscore train --resume` has steps left to take."""
        return self.checkpoint is not None and not self.problem and not self.finished


def read_run(path: str | Path) -> RunInfo | None:
    """State of the training in an output folder, or None if no training has written there.

    Reads file names and two small JSON files; checkpoints are not opened.
    """
    path = Path(path)
    if not results_in(path):
        return None
    data, train, problem = None, None, ""
    try:
        data, train = options_of_run(path / "config.json")
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
        psnr=headline_psnr(metrics),
        data=data,
        train=train,
        problem=problem,
    )


def training_in(path: Path) -> int | None:
    """Id of the process that trains into a folder now, 0 if it cannot be read; None: no
    training."""
    return FolderLock(path, RUN_LOCK, "training").holder()


def options_of_run(
    config: Path, *, warn: Callable[[str], None] = lambda text: None
) -> tuple[DataConfig, TrainConfig]:
    """Options in the config.json of a run. If the run was moved, the path of the capture in its
    folder is updated; `warn` as in `load_config`.

    Raises:
        ConfigError: as `load_config`.
    """
    data, train = load_config(config, warn=warn)
    capture = config.parent / CAPTURE
    if data.source.name == CAPTURE and not data.source.exists() and capture.is_dir():
        data = replace(data, source=capture.absolute())
    return data, train


def read_course(checkpoint: str | Path) -> list[tuple[int, float, float]]:
    """Logged steps, losses and PSNRs (dB) of a run up to one of its checkpoints.

    Reads the checkpoint's header, without torch. Empty if it cannot be read or has no such entries;
    whether a run can be resumed from it is checked by the training.
    """
    try:
        with Path(checkpoint).open("rb") as file:
            (length,) = struct.unpack("<Q", file.read(8))
            text = file.read(min(length, _MOST_STATED)).decode()
        stated = parse_json(parse_json(text)["__metadata__"]["gscore"])
        rows = stated["session"]["meter"]["history"]
        course = [(row["step"], row["loss"], row["psnr"]) for row in rows]
        return [row for row in course if all(isinstance(value, float) for value in row[1:])]
    except (OSError, struct.error, ValueError, LookupError, TypeError, RecursionError):
        return []


def checkpoint_path(path: Path, step: int) -> Path:
    """Path of the checkpoint after `step` of the run in a folder."""
    return path / "checkpoints" / f"step_{step:08d}.safetensors"


def checkpoints_in(path: Path) -> dict[int, Path]:
    """Checkpoints of the run in a folder by step, the latest last; none is opened."""
    return _numbered(path / "checkpoints", _CHECKPOINT)


def snapshots_in(path: Path) -> dict[int, Path]:
    """Snapshots of the run in a folder by step, the latest last."""
    return _numbered(path / "snapshots", _SNAPSHOT)


def _numbered(folder: Path, name: re.Pattern[str]) -> dict[int, Path]:
    by_step = {
        int(match[1]): file
        for file in folder.glob("*")
        if (match := name.fullmatch(file.name)) and file.is_file()
    }
    return dict(sorted(by_step.items()))


def results_in(path: Path) -> list[str]:
    """Names of files and folders in `path` with results of a training."""
    existing = {file.relative_to(path).parts[0] for file in _files_of_run(path)}
    return [name for name in (*RUN_FILES, *RUN_FOLDERS) if name in existing]


def other_files_in_run(path: Path) -> list[str]:
    """Files in the folder of a run that no training writes, as relative paths, without hidden files
    directly in the folder."""
    known = (*RUN_FILES, *RUN_FOLDERS, CAPTURE)
    above = [file.name for file in _listed(path) if not file.name.startswith(".")]
    below = [file.relative_to(path).as_posix() for file in _below(path)]
    odd = [name for name in below if not (_NAMES.fullmatch(name) or _is_unfinished(name))]
    return sorted([name for name in above if name not in known] + odd)


def check_replaceable(path: Path) -> None:
    """Raise unless all files that `remove_results` would remove were written by a training.

    A training writes its config.json before all other files, and it is removed last.

    Raises:
        ConfigError: files with the names of results were not written by gscore, or are linked.
    """
    if not (names := results_in(path)):
        return
    if not is_run(path):
        raise ConfigError(
            f"{path} has {', '.join(names)}, but no config.json by gscore, so they may be "
            "from another program. Choose another folder, or move them away."
        )
    linked = [name for name in RUN_FOLDERS if (path / name).is_symlink()]
    if linked:
        raise ConfigError(
            f"{path / linked[0]} is a link, whose target may be in use elsewhere. Remove the link, "
            "or choose another folder."
        )


def remove_results(path: Path) -> None:
    """Remove only the files that a training has written into a folder, by their exact names.

    Raises:
        ConfigError: see `check_replaceable`.
        OSError: a file cannot be removed.
    """
    check_replaceable(path)
    files = _files_of_run(path)
    for file in sorted(files, key=lambda file: file == path / "config.json"):
        file.unlink(missing_ok=True)
    folders = [path / name for name in RUN_FOLDERS]
    for folder in (*(path / "point_cloud").glob("iteration_*"), *folders):
        with contextlib.suppress(OSError):
            folder.rmdir()  # only an empty folder can be removed


def clear_run(path: str | Path) -> None:
    """Remove a training's results and guides from a folder, and the folder if it is then empty.

    Only for a folder without a running training. Files that cannot be removed stay.
    """
    path = Path(path)
    with contextlib.suppress(OSError, ConfigError):
        remove_results(path)
        for guide in _listed(path / GUIDES):
            if GUIDE_FILE.fullmatch(guide.name):
                guide.unlink(missing_ok=True)
        (path / GUIDES).rmdir()
    clear_unfinished(path)
    with contextlib.suppress(OSError):
        (path / RUN_LOCK).unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        path.rmdir()


def clear_unfinished(path: Path) -> None:
    """Remove unfinished files of a killed training; only while no other is running there."""
    for file in (*_listed(path), *_below(path)):
        if _is_unfinished(file.relative_to(path).as_posix()):
            with contextlib.suppress(OSError):
                file.unlink(missing_ok=True)


def is_run(path: Path) -> bool:
    """True if the config.json in a folder was written by a training of gscore."""
    try:
        content = parse_json(read_bytes(path / "config.json"))
    except (DatasetError, ValueError):
        return False
    return isinstance(content, dict) and {"gscore", "data", "train"} <= content.keys()


def _files_of_run(path: Path) -> list[Path]:
    files = [file for file in _listed(path) if file.name in RUN_FILES]
    return files + [f for f in _below(path) if _NAMES.fullmatch(f.relative_to(path).as_posix())]


def _is_unfinished(name: str) -> bool:
    """True for the temporary name of a file that trainings write."""
    folder, _, last = name.rpartition("/")
    match = _TEMPORARY.fullmatch(last)
    return bool(match and _NAMES.fullmatch(f"{folder}/{match[1]}".lstrip("/")))


def _below(path: Path) -> list[Path]:
    """All files in the folders of a run."""
    folders = [folder for folder in _listed(path) if folder.name in RUN_FOLDERS]
    entries = [file for folder in folders for file in folder.rglob("*")]
    return [file for file in entries if file.is_symlink() or not file.is_dir()]


def _listed(path: Path) -> list[Path]:
    """Sorted entries of a folder; empty if it is none."""
    try:
        return sorted(path.iterdir())
    except (OSError, ValueError):
        return []


def _length(train: TrainConfig | None, steps: int, metrics: dict[str, Any]) -> int:
    """Steps of a run; unknown (0) until its end if it has a time budget."""
    if train is None:
        return 0
    early = (TARGET, CONVERGED, FINISHED) if train.time_budget else (TARGET, CONVERGED)
    if steps and metrics.get("steps") == steps and metrics.get("reason") in early:
        return steps
    return 0 if train.time_budget else train.iterations
