"""Agisoft Metashape cameras, exported as XML (*Export Cameras*, Agisoft XML).

The schema is that of files with `<document version="1.2.0">` to `"2.0.0"`, written by Metashape 1.5
to 2.3. Lenses are those of the *Metashape User Manual, Professional Edition*, appendix "Camera
models" (version 2.2, frame and fisheye cameras): f, cx, cy, b1 and b2 in pixels, cx and cy from the
middle of the picture. A camera's `transform` maps its axes (x right, y down, z forwards) to those
of the chunk, and the transform of its component, or of the chunk in older files, maps these to the
world: metres, geocentric if the chunk has a geographic coordinate system.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from ...errors import FormatError
from ...io.colmap.model import ColmapCamera
from ...io.xml_text import Element, read_xml
from ...quoting import quoted
from ...scene import camera_centers
from ...text_format import count_text
from ...transforms import invert_rigid
from ..poses import rigid_matrix
from .posed import PosedPhoto, PosedPhotos, Size, brown_camera, colmap_camera, numbers

_COEFFICIENTS = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
_FISHEYES = ("fisheye", "equidistant_fisheye")
"""Both are the equidistant lens."""
_EARTH = (6.2e6, 6.5e6)
"""Distances from the Earth's centre at which cameras are geocentric, metres."""

Place = tuple[np.ndarray, np.ndarray, float]
"""Transform of a chunk to the world: rotation [3, 3], translation [3], scale."""
_HERE: Place = (np.eye(3), np.zeros(3), 1.0)


def is_xml(head: str) -> bool:
    """True if a text begins like a Metashape camera file."""
    return "<document" in head and ("<chunk" in head or "<sensors" in head)


def read_metashape(path: Path) -> PosedPhotos:
    """Read the aligned and enabled cameras of the largest component.

    Raises:
        DatasetError: the file is missing.
        FormatError: a value is missing or unusable, there is no aligned camera, or COLMAP has no
            model of a lens.
    """
    chunks = [c for c in read_xml(path).iter("chunk") if any(map(_is_aligned, _cameras(c)))]
    if len(chunks) != 1:
        found = f"{len(chunks)} chunks" if chunks else "no chunk"
        raise FormatError(
            f"{path} contains {found} with aligned cameras, expected 1. Align the photos and "
            "export the cameras of one chunk."
        )
    (chunk,), warnings = chunks, []
    every = list(_cameras(chunk))
    aligned = [camera for camera in every if _is_aligned(camera)]
    used = [camera for camera in aligned if camera.get("enabled") not in ("false", "0")]
    if len(used) < len(every):
        slaves = _slaves(chunk, every)
        without = len(every) - len(aligned) - slaves
        warnings.append(
            f"{count_text(len(every) - len(used), 'camera')} of {path} left out: "
            f"{without} not aligned, {len(aligned) - len(used)} not enabled"
            + (f", {slaves} slaves of a multi-camera rig" if slaves else "")
            + "."
        )
        if slaves:
            warnings.append(
                f"{path} states no pose of {count_text(slaves, 'slave camera')}, which are "
                "fixed to their masters. To use them, export the cameras in COLMAP's "
                "format too, and give the folder with that model and the photos."
            )
    components = Counter(camera.get("component_id", "") for camera in used)
    if not components:
        raise FormatError(f"{path}: no aligned camera is enabled. Enable some, and export again.")
    largest = components.most_common(1)[0][0]
    if len(components) > 1:
        others = len(used) - components[largest]
        warnings.append(
            f"{count_text(others, 'camera')} of {path} left out: they belong to other components "
            "than the largest, which are not placed. Align or merge them."
        )
        used = [camera for camera in used if camera.get("component_id", "") == largest]
    if any(camera.find("rolling_shutter") is not None for camera in used):
        warnings.append(
            f"{path} has cameras with rolling shutter motion, which is ignored; each has one pose."
        )
    place, lenses = _place(path, chunk, largest), _lenses(path, chunk)
    shots = [_shot(path, camera, place, lenses) for camera in used]
    return PosedPhotos(photos=shots, up=_up(shots), warnings=tuple(warnings))


def _cameras(chunk: Element) -> Iterator[Element]:
    """Cameras of the chunk, also those in groups."""
    for cameras in chunk.findall("cameras"):
        yield from cameras.iter("camera")


def _is_aligned(camera: Element) -> bool:
    return bool((camera.findtext("transform") or "").strip())


def _slaves(chunk: Element, cameras: list[Element]) -> int:
    """Number of cameras without a pose that belong to a master camera or a slave sensor."""
    sensors = {s.get("id") for s in chunk.findall("sensors/sensor") if s.get("master_id")}
    return sum(
        not _is_aligned(camera)
        and (camera.get("master_id") is not None or camera.get("sensor_id") in sensors)
        for camera in cameras
    )


def _place(path: Path, chunk: Element, component: str) -> Place:
    """Transform of the chunk, or of a component of it, to the world."""
    own = chunk.find(f"components/component[@id='{component}']/transform")
    transform = own if own is not None else chunk.find("transform")
    if transform is None:
        return _HERE
    where = f"{path}: the transform of the {'chunk' if own is None else 'component'}"
    turn = numbers(where, "rotation", transform.findtext("rotation", "1 0 0 0 1 0 0 0 1"), 9)
    shift = numbers(where, "translation", transform.findtext("translation", "0 0 0"), 3)
    (scale,) = numbers(where, "scale", transform.findtext("scale", "1"), 1)
    if scale <= 0:
        raise FormatError(f"{where}: scale is {scale:g}, expected more than 0. Export it again.")
    pose = np.column_stack([turn.reshape(3, 3), shift])
    return rigid_matrix(where, "rotation", pose)[:3, :3], shift, float(scale)


def _shot(
    path: Path, camera: Element, place: Place, lenses: dict[str, Callable[[], ColmapCamera]]
) -> PosedPhoto:
    label = camera.get("label", "")
    where = f"{path}: camera {quoted(label)}"
    stated = numbers(where, "transform", camera.findtext("transform"), 16).reshape(4, 4)
    pose = rigid_matrix(where, "transform", stated)
    turn, shift, scale = place
    pose[:3, 3] = scale * turn @ pose[:3, 3] + shift
    pose[:3, :3] = turn @ pose[:3, :3]
    sensor = camera.get("sensor_id", "")
    if sensor not in lenses:
        raise FormatError(
            f"{where} uses sensor {quoted(sensor)}, which does not exist. Export again."
        )
    lens = lenses[sensor]()
    return PosedPhoto(
        name=label,
        viewmat=invert_rigid(pose),
        camera=lambda size: lens,
        size=(lens.width, lens.height),
    )


def _lenses(path: Path, chunk: Element) -> dict[str, Callable[[], ColmapCamera]]:
    """Readers of lenses by sensor id, called only for used ones, so that others may be invalid."""
    sensors = chunk.findall("sensors/sensor")
    return {sensor.get("id", ""): partial(_lens, path, sensor) for sensor in sensors}


def _lens(path: Path, sensor: Element) -> ColmapCamera:
    where = f"{path}: sensor {quoted(sensor.get('label') or sensor.get('id'))}"
    calibrations = {c.get("class", "adjusted"): c for c in sensor.findall("calibration")}
    calibration = calibrations.get("adjusted", calibrations.get("initial"))
    if calibration is None:
        raise FormatError(
            f"{where} has no calibration. Align the photos, and export the cameras again."
        )
    size = _size(where, calibration, sensor)
    values = {
        name: float(numbers(where, name, calibration.findtext(name, "0"), 1)[0])
        for name in _COEFFICIENTS
    }
    for name in ("p3", "p4"):
        if values[name] != 0:
            raise FormatError(
                f"{where}: {name} is {values[name]:g}, which no camera model of COLMAP has; "
                "expected 0. Align without it, or export the cameras in COLMAP's format."
            )
    kind = calibration.get("type") or sensor.get("type") or "frame"
    if kind == "frame":
        return brown_camera(
            where,
            size,
            focal=(values["f"] + values["b1"], values["f"]),
            center=(size[0] / 2 + values["cx"], size[1] / 2 + values["cy"]),
            radial=[values[f"k{i}"] for i in (1, 2, 3, 4)],
            tilt=(values["p2"], values["p1"]),  # p1 and p2 are swapped in OpenCV
            skew=values["b2"],
        )
    if kind in _FISHEYES:
        return _fisheye(where, size, values)
    raise FormatError(
        f"{where} has the type {quoted(kind)}, expected frame or fisheye. Export the cameras in "
        "COLMAP's format, which crops or undistorts the photos."
    )


def _fisheye(where: str, size: Size, values: dict[str, float]) -> ColmapCamera:
    """Equidistant lens with tangential distortion: COLMAP's thin prism fisheye without a prism."""
    if values["b2"] != 0:
        raise FormatError(
            f"{where}: the skew (b2) of the lens is {values['b2']:g}, which no camera model of "
            "COLMAP has; expected 0. Align without it."
        )
    focal = {"fx": values["f"] + values["b1"], "fy": values["f"]}
    center = {"cx": size[0] / 2 + values["cx"], "cy": size[1] / 2 + values["cy"]}
    radial = {name: values[name] for name in ("k1", "k2", "k3", "k4")}
    tilt = {"p1": values["p2"], "p2": values["p1"]}
    model = "THIN_PRISM_FISHEYE" if any(tilt.values()) else "OPENCV_FISHEYE"
    return colmap_camera(where, model, size, focal | center | radial | tilt)


def _size(where: str, *elements: Element) -> Size:
    for element in elements:
        if (stated := element.find("resolution")) is not None:
            sides = (stated.get("width"), stated.get("height"))
            width, height = (numbers(where, "resolution", side, 1)[0] for side in sides)
            return int(width), int(height)
    raise FormatError(f"{where} states no resolution. Export the cameras again.")


def _up(shots: list[PosedPhoto]) -> np.ndarray | None:
    """Up direction, away from the Earth's centre, of a geocentric world; else the format does not
    state it."""
    if not shots:
        return None
    middle = camera_centers(np.stack([shot.viewmat for shot in shots])).mean(axis=0)
    distance = float(np.linalg.norm(middle))
    return middle / distance if _EARTH[0] < distance < _EARTH[1] else None
