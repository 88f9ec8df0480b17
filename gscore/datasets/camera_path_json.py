"""Camera path files: cameras.json, nerfstudio's camera_path.json and transforms.json."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ConfigError, DatasetError, FormatError
from ..io.cameras_json import read_cameras_json
from ..io.colmap.lenses import NO_PINHOLE
from ..io.files import atomic_write, read_json
from ..quoting import quoted
from ..scene import Cameras
from ..text_format import count_text
from ..transforms import opengl_from_viewmat, viewmat_from_opengl
from .capture import View
from .poses import check_focal, rigid_matrix
from .transforms_json import views_of_file

_LARGEST = 1 << 16
"""Most pixels of a side."""
_LENS_TOLERANCE = 1e-6
"""Largest difference between a lens and that of nerfstudio's path, share of the picture's size."""


@dataclass(frozen=True, kw_only=True)
class MovingCamera:
    """Camera path with its frame rate."""

    cameras: Cameras
    """One camera per picture, in order of time."""
    fps: float | None
    """Pictures per second; None: not stated."""
    warnings: tuple[str, ...] = ()
    """Messages for the user."""


def read_camera_path(path: str | Path) -> MovingCamera:
    """Read a cameras.json, the camera_path.json of nerfstudio's viewer, or a transforms.json.

    The world is kept as in the file. The frames of a transforms.json are sorted by `time` if all
    have one, else in file order. nerfstudio's field of view is vertical, in degrees
    (`nerfstudio/cameras/camera_paths.py`).

    Raises:
        DatasetError: the file is missing, or has no cameras.
        FormatError: it is another file, or one of its cameras cannot be rendered.
    """
    path = Path(path)
    data = read_json(path)
    if isinstance(data, list):
        moving = MovingCamera(cameras=read_cameras_json(path), fps=None)
    elif isinstance(data, dict) and isinstance(data.get("camera_path"), list):
        moving = _nerfstudio(path, data)
    elif isinstance(data, dict) and isinstance(data.get("frames"), list):
        moving = _transforms(path, data)
    else:
        raise FormatError(
            f"{path} is not a camera path: expected a cameras.json (a list), or an object with a "
            f"list `camera_path` (nerfstudio) or `frames` (transforms.json). Export it again."
        )
    if not len(moving.cameras):
        raise DatasetError(f"{path} contains no cameras. Export it again.")
    return moving


def write_nerfstudio_path(path: str | Path, cameras: Cameras, *, fps: float) -> None:
    """Write the camera_path.json of nerfstudio's viewer, with a keyframe for each camera.

    Times are evenly spaced from 0 to 1, for nerfstudio's dynamic scenes.

    Args:
        path: The file.
        cameras: In order of time; of one size, with square pixels and a centred principal point.
        fps: Pictures per second.

    Raises:
        ConfigError: a camera has a lens that the format cannot state.
        GsError: the file cannot be written.
    """
    width, height = int(cameras.widths[0]), int(cameras.heights[0])
    lenses = cameras.Ks[:, [0, 1, 0, 1], [0, 1, 2, 2]] / width
    ideal = np.stack([lenses[:, 1], lenses[:, 1], *np.full((2, len(cameras)), 0.5)], axis=1)
    ideal[:, 3] *= height / width
    sizes = (cameras.widths != width) | (cameras.heights != height)
    for i in np.flatnonzero(sizes | (np.abs(lenses - ideal).max(axis=1) > _LENS_TOLERANCE)):
        raise ConfigError(
            f"{path}: nerfstudio's camera_path.json cannot store a shifted lens, pixels that "
            f"are not square, or a change of size, as {cameras.names[i]} has. Write a "
            f"transforms.json."
        )
    poses = opengl_from_viewmat(cameras.viewmats)
    fovs = np.degrees(2 * np.arctan(0.5 * height / cameras.Ks[:, 1, 1]))
    keyframes, entries = [], []
    for pose, fov, time in zip(poses, fovs, np.linspace(0, 1, len(cameras)), strict=True):
        lens = {"fov": float(fov), "aspect": width / height}
        matrix = pose.ravel().tolist()
        further = {"override_transition_enabled": False, "override_transition_sec": None}
        keyframes.append({"matrix": matrix, **lens, **further})
        entries.append({"camera_to_world": matrix, **lens, "render_time": float(time)})
    content = {
        "default_fov": float(fovs[0]),
        "default_transition_sec": 1 / fps,
        "keyframes": keyframes,
        "camera_type": "perspective",
        "render_height": height,
        "render_width": width,
        "fps": fps,
        "seconds": len(cameras) / fps,
        "is_cycle": False,
        "smoothness_value": 0.0,
        "camera_path": entries,
    }
    lines = (f"{json.dumps(key)}: {_text(value)}" for key, value in content.items())
    atomic_write(path, ("{\n" + ",\n".join(lines) + "\n}\n").encode())


def _text(value: Any) -> str:
    """JSON; of a list, one item per line."""
    if not isinstance(value, list):
        return json.dumps(value)
    return "[\n" + ",\n".join(json.dumps(item) for item in value) + "\n]"


def _nerfstudio(path: Path, data: dict[str, Any]) -> MovingCamera:
    kind = data.get("camera_type", "perspective")
    if kind != "perspective":
        raise FormatError(
            f"{path}: camera_type is {quoted(kind)}, but paths need perspective cameras. "
            f"Export the path with that type."
        )
    width, height = (_side(path, data, key) for key in ("render_width", "render_height"))
    viewmats, Ks, names = [], [], []
    for i, entry in enumerate(data["camera_path"]):
        where = f"{path}: camera {i}"
        if not isinstance(entry, dict):
            raise FormatError(f"{where} is not an object. Export the path again.")
        pose = _rows(entry.get("camera_to_world"))
        viewmats.append(viewmat_from_opengl(rigid_matrix(where, "camera_to_world", pose)))
        fov = _number(where, "fov", entry.get("fov"))
        focal = 0.5 * height / math.tan(0.5 * math.radians(fov)) if 0 < fov < 180 else math.nan
        check_focal(where, (focal, focal), width, height)
        Ks.append(np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]))
        names.append(f"frame_{i + 1:06d}.png")
    count = len(names)
    cameras = Cameras(
        viewmats=np.array(viewmats, np.float64).reshape(-1, 4, 4),
        Ks=np.array(Ks, np.float64).reshape(-1, 3, 3),
        widths=np.full(count, width, np.int64),
        heights=np.full(count, height, np.int64),
        names=tuple(names),
    )
    return MovingCamera(cameras=cameras, fps=_pace(path, data))


def _pace(path: Path, data: dict[str, Any]) -> float | None:
    """Pictures per second; None: not stated."""
    fps = data.get("fps")
    stated = None if fps is None else _number(str(path), "fps", fps)
    if stated is not None and not 0 < stated <= 1000:
        raise FormatError(f"{path}: fps is {stated:g}, expected up to 1000. Export the path again.")
    return stated


def _transforms(path: Path, data: dict[str, Any]) -> MovingCamera:
    views, _ = views_of_file(path, data, photos_required=False)
    times = [frame.get("time") for frame in data["frames"]]
    if views and all(time is not None for time in times):
        at = [_number(f"{path}: frame {i}", "time", time) for i, time in enumerate(times)]
        views = [view for _, view in sorted(zip(at, views, strict=True), key=lambda pair: pair[0])]
    distorted = sum(_is_distorted(path, view) for view in views)
    count = len(views)
    Ks = np.tile(np.eye(3), (count, 1, 1))
    for K, view in zip(Ks, views, strict=True):
        K[[0, 1, 0, 1], [0, 1, 2, 2]] = view.camera.params[:4]
    frames = count_text(count, "frame")
    warning = f"{path}: {distorted} of {frames} have lens distortion, which is ignored."
    return MovingCamera(
        cameras=Cameras(
            viewmats=np.array([view.viewmat for view in views], np.float64).reshape(-1, 4, 4),
            Ks=Ks,
            widths=np.array([view.camera.width for view in views], np.int64),
            heights=np.array([view.camera.height for view in views], np.int64),
            names=tuple(view.name for view in views),
        ),
        fps=_pace(path, data),
        warnings=(warning,) if distorted else (),
    )


def _is_distorted(path: Path, view: View) -> bool:
    """True for a camera with lens distortion, which is ignored; FormatError for other than pinhole
    models."""
    camera = view.camera
    if camera.model in NO_PINHOLE or "FISHEYE" in camera.model:
        raise FormatError(
            f"{path}: {view.name} has a camera of the model {camera.model}, but paths need "
            f"perspective cameras. Export the path with that type."
        )
    return bool(np.any(camera.params[4:]))


def _rows(value: Any) -> Any:
    """Sixteen numbers as four rows; other values unchanged."""
    if isinstance(value, list) and len(value) == 16:
        return [value[i : i + 4] for i in range(0, 16, 4)]
    return value


def _side(path: Path, data: dict[str, Any], key: str) -> int:
    value = data.get(key)
    if type(value) is not int or not 0 < value <= _LARGEST:
        raise FormatError(
            f"{path}: {key} is {quoted(value)}, expected a number of pixels up to {_LARGEST}. "
            f"Export the path again."
        )
    return value


def _number(where: str, key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < math.inf:
        raise FormatError(
            f"{where}: {key} is {quoted(value)}, expected a number. Export the path again."
        )
    return float(value)
