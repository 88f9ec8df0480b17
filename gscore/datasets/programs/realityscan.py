"""RealityScan (RealityCapture) cameras: its CSV files and its XMP sidecars.

Source of all formulas and equation numbers: M. Hornacek, "On the Coordinate Systems Employed in the
Import, Estimation, and Export of Camera Geometry by RealityScan", Epic Games, 8 June 2026
(RealityScan 2.2), linked from the camera geometry reference of RealityScan's documentation. Older
versions named the columns `heading`, `f`, `px` and `py`.
"""

import csv
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from ...errors import FormatError
from ...io.colmap.model import ColmapCamera
from ...io.files import read_bytes
from ...io.xml_text import Element, read_xml
from ...quoting import quoted
from ...scene import camera_centers
from ...transforms import viewmat_from_opengl
from ..poses import rigid_matrix
from .posed import PosedPhoto, PosedPhotos, Size, Values, brown_camera, numbers

_RENAMED = {"heading": "yaw", "f_35mm": "f", "px_norm": "px", "py_norm": "py"}
_ANGLES = ("name", "x", "y", "alt", "yaw", "pitch", "roll", "f")
_ROTATION = tuple(f"r{i}{j}" for i in range(3) for j in range(3))
_MATRIX = ("name", "tx", "ty", "tz", *_ROTATION, "f_pix", "px_pix", "py_pix")
_FILM = 36.0
"""Film width of the longer side of the photo, mm (34)."""
_XCR = "{http://www.capturingreality.com/ns/xcr/1.1#}"
_RDF = "{http://www.w3.org/1999/02/22-rdf-syntax-ns#}"
_BROWN = ("none", "perspective", "brown3", "brown4", "brown3t2", "brown4t2")
_LEAST_SPREAD = 0.02
"""Largest extent of a capture in longitudes and latitudes, degrees: about two kilometres."""


def is_csv(head: str) -> bool:
    """True if a text begins like a CSV file with poses and lenses."""
    return _columns(head) is not None


def read_csv(path: Path) -> PosedPhotos:
    """Read *Internal/External Camera Parameters*, or the same *OpenCV-compliant*.

    Raises:
        DatasetError: the file is missing.
        FormatError: a number is missing or unusable, or COLMAP has no model of the lens.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path} is not text in UTF-8. Export it again.") from error
    columns = _columns(text)
    if columns is None:
        raise FormatError(
            f"{path} does not begin with the columns {', '.join(_ANGLES)}. Export it from "
            "RealityScan as Internal/External Camera Parameters."
        )
    shots = []
    for i, row in enumerate(csv.reader(text.splitlines()), 1):
        if not row or row[0].startswith("#") or [w.strip().lower() for w in row[:1]] == ["name"]:
            continue
        where = f"{path}: line {i}"
        if len(row) != len(columns):
            raise FormatError(
                f"{where} has {len(row)} values, expected {len(columns)} as in the header. "
                "Export it again."
            )
        shots.append(_shot(where, dict(zip(columns, row, strict=True))))
    _check_no_degrees(path, shots)
    return PosedPhotos(photos=shots)


def _columns(text: str) -> list[str] | None:
    for line in text.splitlines()[:3]:
        if line.lstrip("# ").startswith("cameras "):
            continue
        # The OpenCV-compliant header ends in an explanation in parentheses.
        words = [w.strip().lower() for w in line.lstrip("# ").partition("(")[0].split(",")]
        names = [_RENAMED.get(word, word) for word in words]
        if set(_ANGLES) <= set(names) or set(_MATRIX) <= set(names):
            return names
    return None


def _shot(where: str, row: Mapping[str, str]) -> PosedPhoto:
    def get(*names: str) -> np.ndarray:
        return np.array([numbers(where, name, row.get(name, "0"), 1)[0] for name in names])

    radial, tilt = get("k1", "k2", "k3", "k4"), get("t2", "t1")  # swapped, (47), (48)
    _check_no_division(where, radial, tilt)
    if "f_pix" in row:
        pose = np.column_stack([get(*_ROTATION).reshape(3, 3), get("tx", "ty", "tz")])
        (focal,), center = get("f_pix"), get("px_pix", "py_pix")
        return PosedPhoto(
            name=row["name"],
            viewmat=rigid_matrix(where, "the pose", pose),
            camera=lambda size: brown_camera(
                where, size, focal=(focal, focal), center=center, radial=radial, tilt=tilt
            ),
        )
    pose = np.column_stack([_rotation(*get("yaw", "pitch", "roll")), get("x", "y", "alt")])
    return PosedPhoto(
        name=row["name"],
        viewmat=viewmat_from_opengl(rigid_matrix(where, "the pose", pose)),
        camera=_normalized(where, get("f")[0], get("px", "py"), radial=radial, tilt=tilt),
    )


def _check_no_division(where: str, radial: np.ndarray, tilt: np.ndarray) -> None:
    """Raise FormatError if only k1 is not zero, because a CSV does not distinguish the division
    model from Brown's."""
    if radial[0] != 0 and not radial[1:].any() and not tilt.any():
        raise FormatError(
            f"{where}: only k1 of the lens is not zero, {radial[0]:g}: this may be the division "
            "model, which a CSV does not distinguish from Brown's. Export XMP files, which state "
            "the model, or align with a Brown model and export again."
        )


def _normalized(
    where: str,
    focal: float,
    center: Values,
    *,
    radial: Values,
    tilt: Values,
) -> Callable[[Size], ColmapCamera]:
    """Camera from a 35 mm equivalent focal length and a principal point in units of the longer
    side, (27) to (34)."""

    def camera(size: Size) -> ColmapCamera:
        scale, f = max(size), focal * max(size) / _FILM
        middle = (size[0] / 2 + scale * center[0], size[1] / 2 + scale * center[1])
        return brown_camera(where, size, focal=(f, f), center=middle, radial=radial, tilt=tilt)

    return camera


def _rotation(yaw: float, pitch: float, roll: float) -> np.ndarray:
    """[3, 3] camera to world, the camera's y up and z backwards (section 5.1).

    The document rotates a body by Rz(yaw) Ry(pitch) Rx(roll) in axes north, east, down, with the
    camera's x to the right wing and y to the nose. Both changes of axes are the same half turn,
    which gives Rz(-yaw) Rx(pitch) Ry(roll) in axes east, north, up.
    """
    z, x, y = np.radians([-yaw, pitch, roll])
    about_z = [[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]]
    about_x = [[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]]
    about_y = [[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]]
    return np.array(about_z) @ about_x @ about_y


def _check_no_degrees(path: Path, shots: Sequence[PosedPhoto]) -> None:
    """Raise FormatError if x and y are longitudes and latitudes, which are not lengths."""
    if len(shots) < 2:
        return
    centers = camera_centers(np.stack([shot.viewmat for shot in shots]))
    spread, middle = np.ptp(centers, axis=0), centers.mean(axis=0)
    across = spread[:2].max()
    on_earth = abs(middle[0]) <= 180 and abs(middle[1]) <= 90 and across <= _LEAST_SPREAD
    if on_earth and np.abs(middle[:2]).max() > 100 * across and spread[2] > 10 * across:
        raise FormatError(
            f"{path}: x and y look like longitudes and latitudes, around {middle[0]:.4f}, "
            f"{middle[1]:.4f}. Export it with a local or projected coordinate system, in metres."
        )


def has_pose(head: str) -> bool:
    """True if the first bytes of an XMP file contain RealityScan's pose."""
    return "capturingreality.com/ns/xcr" in head and "xcr:Rotation" in head


def read_xmps(sidecars: Sequence[Path], root: Path) -> PosedPhotos:
    """Read the XMP files of *Export > Metadata (XMP)*, one for each photo.

    Args:
        sidecars: Files with a pose.
        root: Folder that names are relative to.

    Raises:
        DatasetError: a file is missing.
        FormatError: a value is missing or unusable, or COLMAP has no model of the lens.
    """
    shots, worlds = [], Counter[str]()
    for path in sidecars:
        element = _description(path)
        if _value(element, "Coordinates") in ("relative", "rigid"):
            worlds[_value(element, "ComponentId")] += 1
        shots.append(_of_sidecar(path, element, path.relative_to(root).with_suffix("").as_posix()))
    if len(worlds) > 1 or 0 < worlds.total() < len(shots):
        raise FormatError(
            f"The XMP files in {root} are of {max(2, len(worlds))} components, each in its own "
            "coordinates. Export those of one component, or with absolute coordinates."
        )
    return PosedPhotos(photos=shots)


def _description(path: Path) -> Element:
    for element in read_xml(path).iter(f"{_RDF}Description"):
        if _value(element, "Rotation"):
            return element
    raise FormatError(f"{path} has no xcr:Rotation. Export the XMP files again.")


def _value(element: Element, key: str) -> str:
    """Text of an attribute or element; empty without one."""
    inner = element.find(_XCR + key)
    return (element.get(_XCR + key) or (inner.text if inner is not None else "") or "").strip()


def _of_sidecar(path: Path, element: Element, name: str) -> PosedPhoto:
    where = str(path)

    def get(key: str, count: int, default: str = "") -> np.ndarray:
        return numbers(where, f"xcr:{key}", _value(element, key) or default, count)

    for key, usual in (("Skew", 0.0), ("AspectRatio", 1.0)):
        if (value := get(key, 1, str(usual))[0]) != usual:
            raise FormatError(
                f"{where}: xcr:{key} is {value:g}, expected {usual:g}: its formula is not "
                "published. Align without K+, and export again."
            )
    model = _value(element, "DistortionModel") or "none"
    if model not in _BROWN:
        raise FormatError(
            f"{where}: xcr:DistortionModel is {quoted(model)}, whose published formula does not "
            f"match its files; expected one of {', '.join(_BROWN)}. Choose a Brown model in the "
            "alignment settings, or export undistorted photos with COLMAP's format."
        )
    k1, k2, k3, k4, t1, t2 = get("DistortionCoeficients", 6, "0 0 0 0 0 0")
    if model in ("none", "perspective"):
        k1 = k2 = k3 = k4 = t1 = t2 = 0.0
    turn = get("Rotation", 9).reshape(3, 3)
    pose = np.column_stack([turn, -turn @ get("Position", 3)])
    return PosedPhoto(
        name=name,
        viewmat=rigid_matrix(where, "xcr:Rotation", pose),
        camera=_normalized(
            where,
            get("FocalLength35mm", 1)[0],
            np.concatenate([get("PrincipalPointU", 1, "0"), get("PrincipalPointV", 1, "0")]),
            radial=(k1, k2, k3, k4),
            tilt=(t2, t1),  # swapped, (47), (48)
        ),
    )


def sidecars_in(folder: Path, *, below: bool = True) -> Iterator[Path]:
    """XMP files with RealityScan's pose in a folder, or in any below it, sorted by name."""
    for path in sorted(folder.rglob("*") if below else folder.iterdir()):
        if path.suffix.lower() == ".xmp" and path.is_file():
            with path.open("rb") as file:
                head = file.read(1 << 13)
            if has_pose(head.replace(b"\0", b"").decode("latin-1")):
                yield path
