"""cameras.json: camera file of 3DGS viewers, stored with a model."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError
from ..json_text import parse_json
from ..quoting import brief, quoted
from ..scene import FARTHEST, Cameras, checked_origin, is_focal
from ..transforms import invert_rigid
from .files import atomic_write, read_bytes, read_json

WORLD_FILE = "world.json"
_LARGEST = (1e-6, 1e6)
"""Valid range of the largest component of a direction."""


def write_up(folder: Path, up: np.ndarray | None, origin: np.ndarray | None = None) -> None:
    """Write the up direction and the local origin of the model in `folder`.

    Args:
        folder: Folder of the model.
        up: [3], of any length; None: unknown.
        origin: [3], as `Cameras.origin`; None: none. Without both an existing file is removed.

    Raises:
        GsError: the file cannot be written.
    """
    facts = {} if up is None else {"up": checked_up(up).tolist()}
    facts |= {} if origin is None else {"origin": checked_origin(origin).tolist()}
    if facts:
        atomic_write(folder / WORLD_FILE, json.dumps(facts).encode())
    else:
        (folder / WORLD_FILE).unlink(missing_ok=True)


def read_up(folder: Path) -> np.ndarray | None:
    """[3] float64, unit: up direction in the world of the model in `folder`; None: unknown.

    Raises:
        FormatError: the file is damaged.
    """
    return _stated(folder)[0]


def read_origin(folder: Path) -> np.ndarray | None:
    """[3] float64: local origin of the model in `folder`; None: none.

    Raises:
        FormatError: the file is damaged.
    """
    return _stated(folder)[1]


def _stated(folder: Path) -> tuple[np.ndarray | None, np.ndarray | None]:
    path = folder / WORLD_FILE
    if not path.exists():
        return None, None
    try:
        facts = parse_json(read_bytes(path))
        origin = checked_origin(facts["origin"]) if "origin" in facts else None
        # A file with neither is damaged: reading `up` raises.
        up = checked_up(facts["up"]) if "up" in facts or origin is None else None
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(
            f"{path} states no up direction: expected up with three numbers, found {error}. "
            "Remove it to take the up direction from the cameras."
        ) from error
    return up, origin


def checked_up(values: object) -> np.ndarray:
    """Up direction as [3] float64 of length 1.

    Raises:
        ValueError: `values` are no three finite numbers, or have no length.
    """
    up = np.asarray(values)
    if up.shape != (3,) or up.dtype.kind not in "if":
        raise ValueError(f"up, {quoted(values)}")
    up = up.astype(np.float64)
    if not _LARGEST[0] < np.abs(up).max() < _LARGEST[1]:  # also refuses NaN
        raise ValueError(f"up, {quoted(values)}")
    return up / np.linalg.norm(up)


def write_cameras(path: str | Path, cameras: Cameras) -> None:
    """Write cameras in the official layout: position and rotation are camera to world, OpenCV axes.

    The official layout has no principal point and assumes the centre. Added are `cx` and `cy`,
    which other readers skip, and, if known, `up` of the world and its local `origin` in the first
    camera.

    Raises:
        GsError: the file cannot be written.
    """
    world_from_camera = invert_rigid(cameras.viewmats)
    entries = [
        {
            "id": i,
            "img_name": cameras.names[i],
            "width": int(cameras.widths[i]),
            "height": int(cameras.heights[i]),
            "position": world_from_camera[i, :3, 3].tolist(),
            "rotation": world_from_camera[i, :3, :3].tolist(),
            "fy": float(cameras.Ks[i, 1, 1]),
            "fx": float(cameras.Ks[i, 0, 0]),
            "cx": float(cameras.Ks[i, 0, 2]),
            "cy": float(cameras.Ks[i, 1, 2]),
        }
        for i in range(len(cameras))
    ]
    if entries and cameras.up is not None:
        entries[0]["up"] = cameras.up.tolist()
    if entries and cameras.origin is not None:
        entries[0]["origin"] = cameras.origin.tolist()
    lines = ",\n".join(json.dumps(entry) for entry in entries)
    atomic_write(path, f"[\n{lines}\n]\n".encode())


def read_cameras_json(path: str | Path) -> Cameras:
    """Read a cameras.json; without `cx` and `cy` the principal point is the centre.

    Raises:
        DatasetError: the file is missing.
        FormatError: it is not JSON, or an entry lacks a key or has numbers of the wrong shape.
    """
    path = Path(path)
    entries = read_json(path)
    if not isinstance(entries, list):
        raise FormatError(
            f"{path} must be a list of cameras, got {type(entries).__name__}. Export it again."
        )
    count = len(entries)
    poses, intrinsics = np.tile(np.eye(4), (count, 1, 1)), np.tile(np.eye(3), (count, 1, 1))
    sizes, names = np.zeros((count, 2), np.int64), []
    up, origin = None, None
    for i, entry in enumerate(entries):
        try:
            names.append(_fill(entry, poses[i], intrinsics[i], sizes[i]))
            up = checked_up(entry["up"]) if "up" in entry else up
            origin = checked_origin(entry["origin"]) if "origin" in entry else origin
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise FormatError(
                f"{path}: camera {i} has no valid {brief(error)}; expected img_name, width, "
                f"height, position [3], rotation [3][3], fx, fy. Export it again."
            ) from error
    return Cameras(
        viewmats=invert_rigid(poses),
        Ks=intrinsics,
        widths=sizes[:, 0].copy(),
        heights=sizes[:, 1].copy(),
        names=tuple(names),
        up=up,
        origin=origin,
    )


def _fill(entry: Any, pose: np.ndarray, intrinsics: np.ndarray, size: np.ndarray) -> str:
    """Write one entry into its rows and return its name; raises KeyError, TypeError or ValueError
    for invalid ones."""
    width, height = entry["width"], entry["height"]
    if type(width) is not int or type(height) is not int or width <= 0 or height <= 0:
        raise ValueError("width, height")
    size[:] = width, height
    pose[:3, 3] = _numbers(entry, "position", (3,))
    pose[:3, :3] = _numbers(entry, "rotation", (3, 3))
    intrinsics[0, 0] = _numbers(entry, "fx", ())
    intrinsics[1, 1] = _numbers(entry, "fy", ())
    intrinsics[0, 2] = _numbers(entry, "cx", ()) if "cx" in entry else width / 2
    intrinsics[1, 2] = _numbers(entry, "cy", ()) if "cy" in entry else height / 2
    for key, focal in (("fx", intrinsics[0, 0]), ("fy", intrinsics[1, 1])):
        if not is_focal(float(focal), width, height):
            raise ValueError(f"{key}, {focal:g}")
    rotation = pose[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0:
        raise ValueError("rotation")
    if not isinstance(entry["img_name"], str):
        raise ValueError("img_name")
    return entry["img_name"]


def _numbers(entry: Any, key: str, shape: tuple[int, ...]) -> np.ndarray:
    try:
        values = np.array(entry[key], np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(key) from error
    if values.shape != shape or not (np.abs(values) <= FARTHEST).all():
        raise ValueError(key)
    return values
