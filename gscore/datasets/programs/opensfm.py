"""OpenSfM and OpenDroneMap cameras: reconstruction.json.

Schema: "Reconstruction file format" and "Geometric Models" of OpenSfM's documentation, and
`opensfm/io.py` (0.5 to 0.6), with the parameters of each `projection_type`. Image coordinates are
in units of the longer side, from the middle; poses are world to camera, x right, y down, z
forwards; the world's z is up.
"""

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FormatError
from ...io.colmap.model import ColmapCamera
from ...io.files import read_json
from ...quoting import quoted
from ...scene import PointCloud
from ...text_format import count_text
from ...transforms import quat_to_rotmat
from .posed import PosedPhoto, PosedPhotos, brown_camera, colmap_camera, numbers

_PINHOLES = ("perspective", "simple_radial", "radial", "brown")
_FISHEYES = ("fisheye", "fisheye_opencv")
_PANORAMAS = ("spherical", "equirectangular")
_UP = np.array([0.0, 0.0, 1.0])


def read_opensfm(path: Path) -> PosedPhotos:
    """Read the largest reconstruction of a file, with its points.

    Raises:
        DatasetError: the file is missing.
        FormatError: it is another file, a value is missing or unusable, or COLMAP has no model of a
            lens.
    """
    data = read_json(path)
    parts = data if isinstance(data, list) else [data]
    if not parts or not all(
        isinstance(part, dict) and all(isinstance(part.get(k), dict) for k in ("cameras", "shots"))
        for part in parts
    ):
        raise FormatError(
            f"{path} is not a reconstruction of OpenSfM: it must be a list of objects with cameras "
            "and shots. Run OpenSfM's reconstruct again."
        )
    best = max(parts, key=lambda part: len(part["shots"]))
    others = sum(len(part["shots"]) for part in parts) - len(best["shots"])
    warnings = [] if not others else [
        f"{path} contains {len(parts)} reconstructions that OpenSfM could not join; using the "
        f"largest with {count_text(len(best['shots']), 'photo')}, leaving out {others}."
    ]  # fmt: skip
    cameras = {name: _camera(f"{path}: camera {quoted(name)}", best["cameras"][name])
               for name in {_camera_of(path, key, shot) for key, shot in best["shots"].items()}
               if name in best["cameras"]}  # fmt: skip
    shots = [_shot(path, name, shot, cameras) for name, shot in best["shots"].items()]
    return PosedPhotos(photos=shots, points=_points(path, best), up=_UP, warnings=tuple(warnings))


def _camera_of(path: Path, name: str, shot: Any) -> str:
    if not isinstance(shot, dict) or not isinstance(shot.get("camera"), str):
        raise FormatError(f"{path}: shot {quoted(name)} names no camera. Reconstruct it again.")
    return shot["camera"]


def _shot(
    path: Path, name: str, shot: dict[str, Any], cameras: dict[str, ColmapCamera]
) -> PosedPhoto:
    where = f"{path}: shot {quoted(name)}"
    if shot["camera"] not in cameras:
        raise FormatError(f"{where} uses a camera that does not exist. Reconstruct it again.")
    camera = cameras[shot["camera"]]
    viewmat = np.eye(4)
    viewmat[:3, :3] = _rotation(numbers(where, "rotation", shot.get("rotation"), 3))
    viewmat[:3, 3] = numbers(where, "translation", shot.get("translation"), 3)
    size = (camera.width, camera.height)
    return PosedPhoto(name=name, viewmat=viewmat, camera=lambda _: camera, size=size)


def _rotation(vector: np.ndarray) -> np.ndarray:
    """Rotation [3, 3] from an axis [3] whose length is the angle, radians."""
    half = float(np.linalg.norm(vector)) / 2
    return quat_to_rotmat(np.array([np.cos(half), *(np.sinc(half / np.pi) / 2 * vector)]))


def _camera(where: str, stated: Any) -> ColmapCamera:
    if not isinstance(stated, dict):
        raise FormatError(f"{where} is not an object. Reconstruct it again.")

    def get(key: str, default: float | None = None) -> float:
        return float(numbers(where, key, [stated.get(key, default)], 1)[0])

    width, height = int(get("width")), int(get("height"))
    size, scale = (width, height), max(width, height)
    kind = stated.get("projection_type", "perspective")
    if kind in _PANORAMAS:
        params = np.array([width, height], np.float64)
        return ColmapCamera(model="EQUIRECTANGULAR", width=width, height=height, params=params)
    if kind not in (*_PINHOLES, *_FISHEYES):
        known = ", ".join((*_PINHOLES, *_FISHEYES, *_PANORAMAS))
        raise FormatError(
            f"{where}: projection_type is {quoted(kind)}, expected one of {known}. Reconstruct "
            "with one of these, or undistort and export to COLMAP's format."
        )
    fx, fy = (get("focal"),) * 2 if "focal" in stated else (get("focal_x"), get("focal_y"))
    fx, fy = scale * fx, scale * fy
    cx, cy = width / 2 + scale * get("c_x", 0.0), height / 2 + scale * get("c_y", 0.0)
    radial = [get(f"k{i}", 0.0) for i in (1, 2, 3, 4)]
    if kind in _FISHEYES:
        values = {"fx": fx, "fy": fy, "cx": cx, "cy": cy}
        values |= {f"k{i}": k for i, k in enumerate(radial, 1)}
        return colmap_camera(where, "OPENCV_FISHEYE", size, values)
    return brown_camera(
        where, size, focal=(fx, fy), center=(cx, cy), radial=radial,
        tilt=(get("p1", 0.0), get("p2", 0.0)),
    )  # fmt: skip


def _points(path: Path, part: dict[str, Any]) -> PointCloud:
    stated = part.get("points") or {}
    if not isinstance(stated, dict) or not all(isinstance(p, dict) for p in stated.values()):
        raise FormatError(f"{path}: points must be objects by their numbers. Reconstruct it again.")
    rows = [(p.get("coordinates"), p.get("color", [0, 0, 0])) for p in stated.values()]
    xyz = numbers(path.name, "coordinates of points", _flat([r[0] for r in rows]), 3 * len(rows))
    rgb = numbers(path.name, "color of points", _flat([r[1] for r in rows]), 3 * len(rows))
    colors = np.clip(np.rint(rgb), 0, 255).astype(np.uint8)
    return PointCloud(points=xyz.reshape(-1, 3), colors=colors.reshape(-1, 3))


def _flat(rows: list[Any]) -> list[Any]:
    """Numbers of lists of three, flattened; other lists are skipped, so that the length is
    refused."""
    return [n for row in rows for n in (row if isinstance(row, list) and len(row) == 3 else ())]
