"""cameras.json: camera file of 3DGS viewers, stored with a model."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError
from ..json_text import parse_json
from ..quoting import brief
from ..scene import FARTHEST, Cameras, checked_origin, is_focal
from ..transforms import invert_rigid
from .files import atomic_write, read_bytes
from .world_file import checked_up


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
    try:
        entries = parse_json(read_bytes(path))
    except ValueError as error:
        raise FormatError(f"{path} is not JSON: {error}. Copy or export it again.") from error
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
