"""Run folder of a training, read without torch: progress, and files that may be removed."""

import contextlib
import re
import struct
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
"""The file by which a training holds its folder."""
AGENT = ".torchrun"
"""The file that says which torchrun has begun what is in a folder, until that has ended."""
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
"""Files that a training writes, and the page made of it."""
RUN_FOLDERS = ("checkpoints", "point_cloud", "previews", "snapshots")
"""Folders that a training writes."""
GUIDES = "guides"
"""Folder of the meshes and boxes that guide a training, where a front end writes them for it."""
GUIDE_FILE = re.compile(
    r"(?P<role>surface|free)-[0-9a-f]{8}(-\d{6,})?\.ply|within-[0-9a-f]{8}\.json"
)
"""Names that the add-on gives files in GUIDES: of meshes, for one frame or all, and of boxes."""
CAPTURE = "capture"
"""Folder of the capture made of plain photos, which a next training uses again."""
SEARCH_RECORD = "sfm.json"
"""In a capture whose cameras gscore found: what was found, and of which photos."""
MADE_OF = "made_of"
"""In that record: the photos' folder or the video, as an absolute path."""

_MOST_STATED = 1 << 27
"""Bytes before the tensors of a checkpoint."""
_CHECKPOINT = re.compile(r"step_(\d{8,})\.safetensors")
_SNAPSHOT = re.compile(r"step_(\d{6,})\.ply")
_BELOW = (
    rf"checkpoints/{_CHECKPOINT.pattern}(\.damaged)?",
    r"point_cloud/iteration_\d+/point_cloud\.ply",
    r"previews/step_\d{6,}\.png",
    rf"snapshots/{_SNAPSHOT.pattern}",
)
_NAMES = re.compile("|".join((*map(re.escape, RUN_FILES), *_BELOW)))
"""All paths below its folder that a training writes, whatever its options."""
_TEMPORARY = re.compile(r"\.(.+)\.[0-9a-f]{8}\.tmp")
"""What `atomic_write` leaves of a file when its process is killed."""


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
    """Of the last evaluation, dB; see `gscore.headline_psnr`."""
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
    """The process that trains into a folder now: its number, 0 where it cannot be read; None:
    nobody does."""
    return FolderLock(path, RUN_LOCK, "training").holder()


def options_of_run(config: Path) -> tuple[DataConfig, TrainConfig]:
    """The options in the config.json of a run. Where the run was moved, the capture of plain photos
    in its folder has moved along.

    Raises:
        ConfigError: as `load_config`.
    """
    data, train = load_config(config)
    beside = config.parent / CAPTURE
    if data.source.name == CAPTURE and not data.source.exists() and beside.is_dir():
        data = replace(data, source=beside.absolute())
    return data, train


def read_course(checkpoint: str | Path) -> list[tuple[int, float, float]]:
    """Step, loss and PSNR of a run up to one of its checkpoints, as often as it noted them.

    Reads what the checkpoint states before its tensors, without torch. Of one that cannot be read,
    or states no such thing, there are none: whether a run can go on from it, its training says.
    """
    try:
        with Path(checkpoint).open("rb") as file:
            (length,) = struct.unpack("<Q", file.read(8))
            text = file.read(min(length, _MOST_STATED)).decode()
        stated = parse_json(parse_json(text)["__metadata__"]["gscore"])
        rows = stated["session"]["meter"]["history"]
        found = [(row["step"], row["loss"], row["psnr"]) for row in rows]
        return [row for row in found if all(isinstance(value, float) for value in row[1:])]
    except (OSError, struct.error, ValueError, LookupError, TypeError, RecursionError):
        return []


def checkpoint_path(path: Path, step: int) -> Path:
    """Where the run in a folder keeps its checkpoint after `step`."""
    return path / "checkpoints" / f"step_{step:08d}.safetensors"


def checkpoints_in(path: Path) -> dict[int, Path]:
    """The checkpoints of the run in a folder by their steps, the latest last; none is opened."""
    return _numbered(path / "checkpoints", _CHECKPOINT)


def snapshots_in(path: Path) -> dict[int, Path]:
    """The snapshots of the run in a folder by their steps, the latest last."""
    return _numbered(path / "snapshots", _SNAPSHOT)


def _numbered(folder: Path, name: re.Pattern[str]) -> dict[int, Path]:
    found = {
        int(match[1]): file
        for file in folder.glob("*")
        if (match := name.fullmatch(file.name)) and file.is_file()
    }
    return dict(sorted(found.items()))


def results_in(path: Path) -> list[str]:
    """Names of files and folders in `path` that hold what a training writes."""
    there = {file.relative_to(path).parts[0] for file in _files_of_run(path)}
    return [name for name in (*RUN_FILES, *RUN_FOLDERS) if name in there]


def others_in_run(path: Path) -> list[str]:
    """What lies in the folder of a run and no training writes, as paths below it, hidden files of
    the folder itself left out."""
    known = (*RUN_FILES, *RUN_FOLDERS, CAPTURE)
    above = [file.name for file in _listed(path) if not file.name.startswith(".")]
    below = [file.relative_to(path).as_posix() for file in _below(path)]
    odd = [name for name in below if not (_NAMES.fullmatch(name) or _is_unfinished(name))]
    return sorted([name for name in above if name not in known] + odd)


def check_replaceable(path: Path) -> None:
    """Raise unless what `remove_results` would remove from a folder is known to be a training's.

    Every training writes its config.json before all else, and it is removed after all else.

    Raises:
        ConfigError: what has the names of results was not written by gscore, or lies elsewhere.
    """
    if not (names := results_in(path)):
        return
    if not is_run(path):
        raise ConfigError(
            f"{path} holds {', '.join(names)}, but no config.json by gscore, so they may be "
            "somebody else's. Choose another folder, or move them away."
        )
    linked = [name for name in RUN_FOLDERS if (path / name).is_symlink()]
    if linked:
        raise ConfigError(
            f"{path / linked[0]} is a link, and what it leads to may serve others too. Remove the "
            "link, or choose another folder."
        )


def remove_results(path: Path) -> None:
    """Remove what a training has written into a folder, by its exact names, and nothing else.

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
    """Remove what a training has written into a folder, with what was put there to
    guide it, and the folder if nothing else is in it.

    Only for a folder in which no training is running. What cannot be removed stays.
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
    """Remove what a killed training was just writing; only while no other one is running there."""
    for file in (*_listed(path), *_below(path)):
        if _is_unfinished(file.relative_to(path).as_posix()):
            with contextlib.suppress(OSError):
                file.unlink(missing_ok=True)


def is_run(path: Path) -> bool:
    """Whether the config.json in a folder is one that a training of gscore has written."""
    try:
        content = parse_json(read_bytes(path / "config.json"))
    except (DatasetError, ValueError):
        return False
    return isinstance(content, dict) and {"gscore", "data", "train"} <= content.keys()


def _files_of_run(path: Path) -> list[Path]:
    files = [file for file in _listed(path) if file.name in RUN_FILES]
    return files + [f for f in _below(path) if _NAMES.fullmatch(f.relative_to(path).as_posix())]


def _is_unfinished(name: str) -> bool:
    """Whether it is the temporary name of a file that trainings write."""
    folder, _, last = name.rpartition("/")
    match = _TEMPORARY.fullmatch(last)
    return bool(match and _NAMES.fullmatch(f"{folder}/{match[1]}".lstrip("/")))


def _below(path: Path) -> list[Path]:
    """All files in the folders of a run."""
    folders = [folder for folder in _listed(path) if folder.name in RUN_FOLDERS]
    found = [file for folder in folders for file in folder.rglob("*")]
    return [file for file in found if file.is_symlink() or not file.is_dir()]


def _listed(path: Path) -> list[Path]:
    """What lies in a folder; nothing where it is none."""
    try:
        return sorted(path.iterdir())
    except (OSError, ValueError):
        return []


def _length(train: TrainConfig | None, steps: int, metrics: dict[str, Any]) -> int:
    """Steps of a run; budgets and goals leave them open until it has ended."""
    if train is None:
        return 0
    early = (TARGET, CONVERGED, FINISHED) if train.time_budget else (TARGET, CONVERGED)
    if steps and metrics.get("steps") == steps and metrics.get("reason") in early:
        return steps
    return 0 if train.time_budget else train.iterations
