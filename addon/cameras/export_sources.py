"""Export sources: the captures behind an export, with the points of their files and of Blender."""

import contextlib
from dataclasses import dataclass, fields
from pathlib import Path

import bpy
import numpy as np

from .. import run_links, stored_paths
from ..core import (
    Capture,
    ColmapModel,
    ColmapPoints,
    DataConfig,
    GsError,
    find_capture,
    offset_between,
    read_capture,
)
from ..interface.blocks import block_of, with_uid
from ..paths import absolute
from ..process.incremental_tasks import Steps, run_in_thread
from . import objects as co
from . import sfm_points
from .capture_transform import origin_of
from .export_views import ExportView, Tracked, collecting

UNKNOWN_ERROR = -1.0
"""Reprojection error of a point without a COLMAP model, pixels."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ExportPoints:
    """Points of a capture, read from Blender."""

    positions: np.ndarray
    """[P, 3] float32."""
    indices: np.ndarray
    """Rows of the exported points, from `sfm_points.unique_places`."""
    linear: np.ndarray | None
    """Linear colours from `sfm_points.linear_of`; None: the object has no colours."""
    name: str
    """Name of the object."""

    @property
    def colors(self) -> np.ndarray:
        """[P, 3] uint8 sRGB; ValueError without colours."""
        if self.linear is None:
            raise ValueError(
                f"{self.name} has lost its color attribute {sfm_points.COLOR!r}. Import the "
                "capture again."
            )
        return sfm_points.encoded(self.linear)


def reading_points(root: int | None) -> Steps[ExportPoints | None]:
    """Read the points of a capture, one attribute per step.

    Args:
        root: Session uid of its empty; None: no capture.

    Raises:
        ValueError: the points were removed or changed meanwhile.
    """
    empty = with_uid(bpy.data.objects, root)
    ob = None if empty is None else co.points_of(empty)
    if ob is None:
        return None
    uid, name, values = ob.session_uid, ob.name, []
    for read in (sfm_points.positions_of, sfm_points.linear_of, sfm_points.places_of):
        yield f"Reading {name}"
        gone = f"{name} was removed while it was exported: export it again."
        values.append(read(block_of(bpy.data.objects, uid, gone)))
    positions, linear, places = values
    if len({len(rows) for rows in values if rows is not None}) != 1:
        raise ValueError(f"{name} was changed while it was exported: export it again.")
    indices = yield from run_in_thread(
        lambda check: sfm_points.unique_places(places), f"Reading {name}"
    )
    return ExportPoints(positions=positions, indices=indices, linear=linear, name=name)


@dataclass(frozen=True, kw_only=True)
class ExportInputs:
    """Inputs of an export, read from Blender; later steps need no bpy."""

    views: list[ExportView]
    capture_points: ExportPoints | None
    """Points of the capture whose world is written; None: there are none."""
    source: Path | None
    """Files of that capture, if they exist."""
    captures: list[Path]
    """Captures that must not be overwritten."""
    origin: np.ndarray | None
    """[3] local origin of views and points; None: there is none."""


def reading_inputs(tracked: Tracked) -> Steps[ExportInputs]:
    """Read the inputs; errors as `collecting` and `reading_points`."""
    root = tracked.root
    source, captures, origin = source_of(root), known_captures(), origin_of(root)
    uid = None if root is None else root.session_uid
    views = yield from collecting(tracked)
    capture_points = yield from reading_points(uid)
    return ExportInputs(
        views=views, capture_points=capture_points, source=source, captures=captures, origin=origin
    )


def points_to_export(
    capture_points: ExportPoints | None,
    source: Path | None,
    model: ColmapModel | None = None,
    *,
    origin: np.ndarray | None = None,
) -> tuple[ColmapPoints, list[str]]:
    """The points of the Blender object: without deleted ones, unmoved ones in float64. No bpy.

    Args:
        capture_points: Points of the object; None: the points of the capture's files.
        source: The capture's files, if they exist.
        model: Their COLMAP model, if already read.
        origin: [3] local origin of points and model; None: there is none.

    Returns:
        Points, with the model's ids where they come from it, and sentences for the user.

    Raises:
        ValueError: the object has no colours.
    """
    exact = model.points if model is not None else _points_without_tracks(source, origin)
    if capture_points is None:
        return (ColmapPoints.none() if exact is None else exact), []
    now, places = capture_points.positions, capture_points.indices
    if exact is None:
        note = "The capture's files are missing; points are written in single precision."
        return _new_points(now, capture_points.colors), [note]
    own = (places >= 0) & (places < len(exact))
    rows = places[own]
    then = exact.xyz[rows]
    still = (now[own] == then.astype(np.float32)).all(axis=1, keepdims=True)
    kept = ColmapPoints(
        ids=exact.ids[rows],
        xyz=np.where(still, then, now[own].astype(np.float64)),
        rgb=exact.rgb[rows],
        error=exact.error[rows],
        track_lengths=exact.track_lengths[rows],
    )
    if own.all():
        return kept, []
    first = int(exact.ids.max(initial=0)) + 1
    added = _new_points(now[~own], capture_points.colors[~own], first)
    names = (field.name for field in fields(ColmapPoints))
    both = {name: np.concatenate([getattr(kept, name), getattr(added, name)]) for name in names}
    return ColmapPoints(**both), []


def source_of(root: bpy.types.Object | None) -> Path | None:
    """The capture that an empty was imported from, if it still exists."""
    text = stored_paths.read(root, stored_paths.SOURCE) if root is not None else ""
    path = Path(text)
    return path if text and path.exists() else None


def known_captures() -> list[Path]:
    """Existing captures of the open file, imported or chosen for training."""
    roots = [ob for ob in bpy.data.objects if co.is_kind(ob, "capture")]
    known = [path for root in roots if (path := source_of(root)) is not None]
    for scene in bpy.data.scenes:
        for holder in run_links.holders(scene):
            with contextlib.suppress(ValueError):  # none is chosen
                known.append(find_capture(absolute(holder.capture_path, "Capture")))
    return [path for path in dict.fromkeys(known) if path.exists()]


def _points_without_tracks(source: Path | None, origin: np.ndarray | None) -> ColmapPoints | None:
    """Points of a capture without a COLMAP model, in float64."""
    if source is None:
        return None
    try:
        capture: Capture = read_capture(
            DataConfig(source=source),
            photos_required=False,
            origin=offset_between(origin, None),
        )
    except (GsError, OSError):
        return None
    return _new_points(capture.points.points, capture.points.colors)


def _new_points(xyz: np.ndarray, rgb: np.ndarray, first: int = 1) -> ColmapPoints:
    count = len(xyz)
    return ColmapPoints(
        ids=np.arange(first, first + count, dtype=np.int64),
        xyz=np.asarray(xyz, np.float64).reshape(-1, 3),
        rgb=rgb,
        error=np.full(count, UNKNOWN_ERROR),
        track_lengths=np.zeros(count, np.int32),
    )
