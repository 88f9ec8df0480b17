"""transforms.json export of Blender cameras, with the points in a PLY file next to it."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..core import ColmapPoints, atomic_write, offset_between
from ..process.incremental_tasks import Check, Steps, run_in_thread
from . import camera_math as cm
from .export_sources import ExportInputs, points_to_export, reading_inputs
from .export_views import (
    Exported,
    ExportView,
    Tracked,
    all_or_none,
    in_file_coordinates,
    kept_lenses,
)

POINTS = "sparse_pc.ply"
"""nerfstudio's file name of the points."""
_KEYS = {"f": ("fl_x", "fl_y"), "fx": ("fl_x",), "fy": ("fl_y",), "cx": ("cx",), "cy": ("cy",)}
_OPENCV = frozenset({"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"})
_UNUSED = frozenset({"k4", "k5", "k6"})
"""Parameters of FULL_OPENCV without an agreed meaning in transforms.json."""


def exporting_transforms(path: str | Path, tracked: Tracked) -> Steps[Exported]:
    """Write a transforms.json of nerfstudio: camera to world, OpenGL axes; photos are not copied.

    Args:
        path: The file to write.
        tracked: The cameras.

    Raises:
        GsError: a file cannot be written.
        ValueError: a camera cannot be written, or the file belongs to a capture of the open file.
    """
    path = Path(path)
    inputs = yield from reading_inputs(tracked)
    write = partial(_write, path, inputs)
    return (yield from run_in_thread(write, f"Writing {path}"))


def _write(
    path: Path,
    inputs: ExportInputs,
    check: Check,
) -> Exported:
    """Write the files; no bpy."""
    views, source = inputs.views, inputs.source
    for known in inputs.captures:
        own = known if known.is_file() else known / path.name
        if own.exists() and own.resolve() == path.resolve():
            raise ValueError(f"{path} is the own file of {known}. Choose another name.")
    points, warnings = points_to_export(inputs.capture_points, source, origin=inputs.origin)
    points = replace(points, xyz=points.xyz + offset_between(inputs.origin, None))
    warnings += kept_lenses(views)
    away = sum(1 for view in views if view.photo and not _is_below(view.photo, path.parent))
    if away:
        warnings.append(
            f"{away} photos are not inside {path.parent}; copy them to its folder images, where "
            f"the file expects them."
        )
    further = {"ply_file_path": POINTS} if len(points) else {}
    text = transforms_text(in_file_coordinates(views, inputs.origin), path.parent, further)
    ply = _ply(points) if len(points) else b""
    with all_or_none(check):
        if ply:
            atomic_write(path.with_name(POINTS), ply)
        atomic_write(path, text.encode())
    return Exported.of(path, views, points, warnings)


def transforms_text(
    views: Sequence[ExportView],
    folder: Path,
    further: dict[str, Any] | None = None,
    *,
    times: Iterable[float] | None = None,
) -> str:
    """A transforms.json of these views.

    Args:
        views: Views in file order.
        folder: Folder of the file.
        further: Additional top-level keys.
        times: One for each view; None: a static scene.

    Raises:
        ValueError: a view's camera model has no name in transforms.json.
    """
    frames = [_frame(view, folder) for view in views]
    for frame, time in zip(frames, times or (), strict=times is not None):
        frame["time"] = time
    own = ("file_path", "transform_matrix", "time")
    first = {key: value for key, value in frames[0].items() if key not in own}
    shared = {k: v for k, v in first.items() if all(k in f and f[k] == v for f in frames)}
    own_keys = [{k: v for k, v in frame.items() if k not in shared} for frame in frames]
    return _text({**shared, **(further or {})}, own_keys)


def _text(shared: dict[str, Any], frames: list[dict[str, Any]]) -> str:
    """JSON with one key or frame per line."""
    lines = [f"{json.dumps(key)}: {json.dumps(value)}," for key, value in shared.items()]
    body = ",\n".join(json.dumps(frame) for frame in frames)
    return "\n".join(["{", *lines, '"frames": [', body, "]", "}"]) + "\n"


def _frame(view: ExportView, folder: Path) -> dict[str, Any]:
    camera = view.camera
    named = camera.named_params
    if camera.model in _OPENCV:
        model = "OPENCV"
    elif camera.model == "OPENCV_FISHEYE":
        model = camera.model
    elif camera.model == "FULL_OPENCV" and not any(named[key] for key in _UNUSED):
        model, named = "OPENCV", {k: v for k, v in named.items() if k not in _UNUSED}
    else:
        raise ValueError(
            f"{view.name} has the camera model {camera.model}, which transforms.json has no name "
            f"for. Export to COLMAP instead."
        )
    values: dict[str, Any] = {"camera_model": model, "w": camera.width, "h": camera.height}
    for name, value in named.items():
        for key in _KEYS.get(name, ("k1" if name == "k" else name,)):
            values[key] = value
    file = f"images/{view.name}"
    if view.photo is not None and _is_below(view.photo, folder):
        file = view.photo.resolve().relative_to(folder.resolve()).as_posix()
    return {
        "file_path": file,
        **values,
        "transform_matrix": cm.matrix_world_from_viewmat(view.viewmat).tolist(),
    }


def _is_below(file: Path, folder: Path) -> bool:
    return file.resolve().is_relative_to(folder.resolve())


def _ply(points: ColmapPoints) -> bytes:
    """A binary PLY, positions in double precision."""
    kinds = [*((axis, "<f8") for axis in "xyz"), *((c, "u1") for c in ("red", "green", "blue"))]
    rows = np.zeros(len(points), kinds)
    for i, axis in enumerate("xyz"):
        rows[axis] = points.xyz[:, i]
    for i, channel in enumerate(("red", "green", "blue")):
        rows[channel] = points.rgb[:, i]
    names = [f"property {'double' if kind == '<f8' else 'uchar'} {name}" for name, kind in kinds]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}", *names]
    return ("\n".join([*head, "end_header"]) + "\n").encode("ascii") + rows.tobytes()
