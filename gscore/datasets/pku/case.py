"""PKU-DyMVHumans case: layout detection of a multi-view video, and one of its frames."""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from ...config import DataConfig
from ...errors import ConfigError, DatasetError, GsError
from ...scene import PointCloud
from ...text_format import count_text
from ..capture import Capture
from ..colmap_source import read_colmap
from ..rig import with_rig
from . import cams as pku_cams
from . import json_layouts as pku_json
from . import neus as pku_neus
from .photos import VIEW_FOLDER

_NUMBER = re.compile(r"\d+")
_NEUS2 = re.compile(r"transforms?_(\d+)\.json")
_SPLITS = ("train", "test")


@dataclass(frozen=True, kw_only=True)
class PkuVideo:
    """A scenario of the data set, with the requested layout and frame."""

    case: Path
    """Folder of the scenario, with `cams`, `per_frame`, `data_COLMAP` and so on."""
    layout: str
    """Name of a folder in it, a key of `LAYOUTS`; empty: the first that has the frame."""
    frame: int | None
    """Number of the frame in the path; None: none."""

    def frames(self) -> dict[int, Path]:
        """Paths by frame number, ascending, of the layout or of the first that has frames.

        Each path identifies one frame, except in `per_view`, where it is that folder.

        Raises:
            DatasetError: there are none.
        """
        for layout in (self.layout,) if self.layout else LAYOUTS:
            paths = _list(self.case / layout, layout)
            if paths and self.frame is None:
                return paths
            if self.frame in paths:
                return {self.frame: paths[self.frame]}
        raise _no_frame(self, self.frame)


def find_video(source: Path) -> PkuVideo | None:
    """Scenario, layout and frame of a path in one of the data set's layouts, or None for others.

    A folder that also has a COLMAP model in `sparse` is an ordinary capture.
    """
    path = Path(os.path.abspath(source))  # noqa: PTH100 - the names may be those of links
    names = [path.name, path.parent.name, path.parent.parent.name]
    if path.is_file():
        number = _NEUS2.fullmatch(names[0])
        root = path.parent.parent if names[1] in _SPLITS else path.parent
        if number is None or root.name != "data_NeuS2":
            return None
        return PkuVideo(case=root.parent, layout=root.name, frame=int(number[1]))
    if not path.is_dir():
        return None
    if names[0] in LAYOUTS:
        return PkuVideo(case=path.parent, layout=names[0], frame=None)
    if names[1] in _FOLDER_A_FRAME and _NUMBER.fullmatch(names[0]):
        return PkuVideo(case=path.parent.parent, layout=names[1], frame=int(names[0]))
    if any((path / name).is_dir() for name in LAYOUTS) and not (path / "sparse").is_dir():
        return PkuVideo(case=path, layout="", frame=None)
    return None


def read_video(video: PkuVideo, config: DataConfig, *, photos_required: bool = True) -> Capture:
    """Read one frame: that of `config.frame`, that of the path, or the first.

    Raises:
        ConfigError: the path and the option give different frames.
        DatasetError: there is no such frame, or files of it are missing.
        FormatError: a file is truncated, corrupt or of another format.
    """
    frame_number = video.frame if config.frame is None else config.frame
    if video.frame is not None and frame_number != video.frame:
        raise ConfigError(
            f"{config.source} is frame {video.frame}, but `--frame` is {frame_number}. Give the "
            f"folder above it, or leave `--frame` out."
        )
    layouts = (video.layout,) if video.layout else tuple(LAYOUTS)
    for layout in layouts:
        listed = _list(video.case / layout, layout)
        if listed and (frame_number is None or frame_number in listed):
            break
    else:
        raise _no_frame(video, frame_number)
    frame = next(iter(listed)) if frame_number is None else frame_number
    capture = LAYOUTS[layout](config, video.case, listed[frame], frame, photos_required)
    warnings = list(capture.warnings)
    points = capture.points
    if len(points) == 0:
        points, notes = _points_of_colmap(video.case, frame, capture, listed[frame])
        warnings += notes
    if frame_number is None and len(listed) > 1:
        warnings.append(
            f"{video.case / layout} contains {count_text(len(listed), 'frame')}, {_span(listed)}; "
            f"using frame {frame}. Choose another with `--frame`."
        )
    return replace(capture, points=points, masks_are="composite", warnings=tuple(warnings))


def _points_of_colmap(
    case: Path, frame: int, capture: Capture, path: Path
) -> tuple[PointCloud, list[str]]:
    """SfM points of the frame, or of the nearest one, moved to the world of a capture without
    points."""
    models = _list(case / "data_COLMAP", "data_COLMAP")
    if not models:
        return capture.points, []
    folder = models[min(models, key=lambda number: abs(number - frame))]
    try:
        model = read_colmap(DataConfig(source=folder), photos_required=False)
        points = with_rig(model, capture, where=folder, rig_at=path).points
    except GsError as error:
        return capture.points, [f"The points of {folder} cannot be used: {error}"]
    warning = f"{path} has no points; starting from those of {folder}, moved into its world."
    return points, [warning]


Reader = Callable[[DataConfig, Path, Path, int, bool], Capture]
"""Reads (options, scenario, path of the frame, number of the frame, whether photos must exist)."""

LAYOUTS: dict[str, Reader] = {
    "data_COLMAP": pku_cams.read_model_frame,
    "per_frame": pku_cams.read_per_frame,
    "per_view": pku_cams.read_per_view,
    "data_NeuS2": pku_json.read_neus2,
    "data_ngp": pku_json.read_ngp,
    "data_NeuS": pku_neus.read_neus,
}
"""Folders of a scenario, best first: layouts with SfM points and original photos come first."""

_FOLDER_A_FRAME = ("data_COLMAP", "per_frame", "data_ngp", "data_NeuS")
_EXAMPLES = {
    "": "000000",
    "data_COLMAP": "000000",
    "per_frame": "000000",
    "per_view": "cam_0/images/000000.png",
    "data_NeuS2": "transform_000000.json",
    "data_ngp": "000000",
    "data_NeuS": "000000",
}


def _list(folder: Path, layout: str) -> dict[int, Path]:
    """Frames of one layout by number, ascending; empty if it has none."""
    if not folder.is_dir():
        return {}
    found: dict[int, Path] = {}
    if layout in _FOLDER_A_FRAME:
        for path in folder.iterdir():
            if _NUMBER.fullmatch(path.name) and path.is_dir():
                found[int(path.name)] = path
    elif layout == "data_NeuS2":
        for place in (
            folder / "test",
            folder / "train",
            folder,
        ):  # the complete file overrides the splits
            for path in place.iterdir() if place.is_dir() else ():
                if match := _NEUS2.fullmatch(path.name):
                    found[int(match[1])] = path
    else:
        views = [f for f in folder.iterdir() if VIEW_FOLDER.fullmatch(f.name) and f.is_dir()]
        for name in ("images", "image"):
            for photo in (photo for view in views for photo in (view / name).glob("*.*")):
                if _NUMBER.fullmatch(photo.stem):
                    found[int(photo.stem)] = folder
    return dict(sorted(found.items()))


def _no_frame(video: PkuVideo, frame_number: int | None) -> DatasetError:
    listed = {
        name: frames
        for name in ((video.layout,) if video.layout else LAYOUTS)
        if (frames := _list(video.case / name, name))
    }
    where = video.case / video.layout
    if not listed:
        return DatasetError(
            f"{where} contains no frames; expected folders or files with their numbers, as in "
            f"{video.layout or 'data_COLMAP'}/{_EXAMPLES[video.layout]}."
        )
    have = "; ".join(f"{name} has {len(f)}, {_span(f)}" for name, f in listed.items())
    return DatasetError(
        f"{where} has no frame {frame_number}: {have}. Choose one of these with `--frame`."
    )


def _span(frames: dict[int, Path]) -> str:
    """Range of frames, such as "0 to 145 in steps of 5"."""
    numbers = list(frames)
    steps = {b - a for a, b in pairwise(numbers)}
    if len(numbers) == 1:
        return str(numbers[0])
    even = f" in steps of {steps.pop()}" if len(steps) == 1 else ""
    return f"{numbers[0]} to {numbers[-1]}{even}"
