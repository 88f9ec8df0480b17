"""The captures that an export goes back to, and the points that they and Blender have."""

import contextlib
from pathlib import Path

import bpy
import numpy as np

from .. import outcomes, stored_paths
from ..core import (
    Capture,
    ColmapModel,
    ColmapPoints,
    DataConfig,
    GsError,
    find_capture,
    read_capture,
)
from ..paths import absolute
from . import objects as co
from . import sfm_points

UNKNOWN_ERROR = -1.0
"""Reprojection error of a point that COLMAP did not make, pixels."""


def points_to_export(
    root: bpy.types.Object | None, source: Path | None, model: ColmapModel | None = None
) -> tuple[ColmapPoints, list[str]]:
    """The points as they are in Blender: deleted ones left out, untouched ones exact.

    Args:
        root: The capture's empty; without one there are no points.
        source: The capture's files, if they are there.
        model: Their COLMAP model, if that has been read already.

    Returns:
        Points, with the ids of the model where they come from it, and sentences for the user.
    """
    exact = model.points if model is not None else _points_without_tracks(source)
    ob = co.points_of(root) if root is not None else None
    if ob is None:
        return (ColmapPoints.none() if exact is None else exact), []
    now = sfm_points.positions_of(ob)
    places = sfm_points.indices_of(ob)
    if exact is None:
        note = "The capture's own files are not there; points are written in single precision."
        return _new_points(now, sfm_points.colors_of(ob)), [note]
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
    added = _new_points(now[~own], sfm_points.colors_of(ob)[~own], first)
    return _joined(kept, added), []


def source_of(root: bpy.types.Object | None) -> Path | None:
    """The capture that an empty was imported from, if it is still there."""
    text = stored_paths.read(root, stored_paths.SOURCE) if root is not None else ""
    path = Path(text)
    return path if text and path.exists() else None


def known_captures() -> list[Path]:
    """The captures of the open file that are there, imported or chosen to be trained."""
    roots = [ob for ob in bpy.data.objects if co.is_kind(ob, "capture")]
    found = [path for root in roots if (path := source_of(root)) is not None]
    for scene in bpy.data.scenes:
        for holder in outcomes.holders(scene):
            with contextlib.suppress(ValueError):  # none is chosen
                found.append(find_capture(absolute(holder.capture_path, "Capture")))
    return [path for path in dict.fromkeys(found) if path.exists()]


def _points_without_tracks(source: Path | None) -> ColmapPoints | None:
    """Points of a capture without a COLMAP model, in float64."""
    if source is None:
        return None
    try:
        capture: Capture = read_capture(DataConfig(source=source), photos_required=False)
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


def _joined(a: ColmapPoints, b: ColmapPoints) -> ColmapPoints:
    return ColmapPoints(
        ids=np.concatenate([a.ids, b.ids]),
        xyz=np.concatenate([a.xyz, b.xyz]),
        rgb=np.concatenate([a.rgb, b.rgb]),
        error=np.concatenate([a.error, b.error]),
        track_lengths=np.concatenate([a.track_lengths, b.track_lengths]),
    )
