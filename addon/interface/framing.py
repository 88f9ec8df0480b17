"""Framing of 3D views: on the bulk of some points, from the view's direction or from a camera."""

from collections.abc import Iterable, Sequence

import bpy
import numpy as np
from mathutils import Matrix, Vector

MOST = 0.9
"""Share of the weight that a view shows, on each axis and then nearest to the centre; the rest is
sky."""
_ROOM = 2.5
"""View distance in radii of the framed ball, for Blender's default lens."""
_USUAL_LENS = 50.0
_CENTRAL = 0.25
"""Tangent of the largest angle between a camera's axis and its subject."""


def ball(places: np.ndarray, weights: np.ndarray | None = None) -> tuple[np.ndarray, float]:
    """Centre [3] and radius of the bulk of points [N, 3], N > 0; weights [N], None: equal."""
    weights = np.ones(len(places)) if weights is None else weights
    low, high = (1 - MOST) / 2, (1 + MOST) / 2
    # The centre of a box, because the median is on the ground if most points are there.
    middle = np.array([np.mean(quantiles(axis, weights, (low, high))) for axis in places.T])
    away = np.linalg.norm(places - middle, axis=1)
    return middle, float(quantiles(away, weights, (MOST,))[0])


def quantiles(values: np.ndarray, weights: np.ndarray, shares: Sequence[float]) -> np.ndarray:
    """Weighted quantiles [S] of values [N], weights [N], N > 0; equal weights if all are 0."""
    order = np.argsort(values)
    ranks = np.cumsum(weights[order] if weights.any() else np.ones(len(values)))
    at = np.searchsorted(ranks, np.multiply(shares, ranks[-1]))
    return values[order][np.minimum(at, len(values) - 1)]


def views_of(scene: bpy.types.Scene) -> list[bpy.types.SpaceView3D]:
    """The 3D views of all windows that show a scene."""
    windows = (one for one in bpy.context.window_manager.windows if one.scene == scene)
    areas = (area for window in windows for area in window.screen.areas)
    return [area.spaces.active for area in areas if area.type == "VIEW_3D"]


def most_similar(cameras: Iterable[Matrix], direction: Vector) -> int:
    """Index of the camera matrix with the most similar viewing direction, the first of several."""
    likeness = [-m.col[2].xyz.normalized().dot(direction) for m in cameras]
    return likeness.index(max(likeness))


def show_ball(space: bpy.types.SpaceView3D, middle: np.ndarray, radius: float) -> None:
    """Frame a sphere from a view's direction; camera views stay unchanged."""
    region, radius = space.region_3d, max(radius, 1e-3 / _ROOM)
    if region.view_perspective != "CAMERA":
        region.view_location = Vector(middle)
        region.view_distance = _ROOM * radius * space.lens / _USUAL_LENS
        extend_clipping(space, region.view_distance + radius)


def show_from(
    space: bpy.types.SpaceView3D,
    cameras: Sequence[Matrix],
    places: np.ndarray,
    weights: np.ndarray,
) -> None:
    """Move a view to the camera whose direction is nearest to its own, levelled, and set its
    pivot to the subject in the camera's centre; camera views stay unchanged.

    Args:
        space: The view.
        cameras: Camera matrices in Blender's world, at least one.
        places: [N, 3] points of the scene, N > 0.
        weights: [N].
    """
    region = space.region_3d
    if region.view_perspective == "CAMERA":
        return
    nearest = cameras[most_similar(cameras, region.view_rotation @ Vector((0, 0, -1)))]
    ahead, eye = -nearest.col[2].xyz.normalized(), nearest.translation
    depth = depth_of(places, weights, np.array(eye), np.array(ahead))
    if region.view_perspective == "PERSP" and not region.lock_rotation:
        region.view_rotation = ahead.to_track_quat("-Z", "Y")
    region.view_distance = depth
    region.view_location = eye + depth * ahead
    extend_clipping(space, 2 * depth)


def depth_of(places: np.ndarray, weights: np.ndarray, eye: np.ndarray, ahead: np.ndarray) -> float:
    """Distance along a camera's axis to the subject in the centre of its picture.

    The median of the depths of central points, weighted also by 1 / depth², their size in the
    picture; without central points the median distance of all.

    Args:
        places: [N, 3].
        weights: [N].
        eye: [3] camera position.
        ahead: [3] viewing direction, a unit vector.
    """
    offsets = places - eye
    depths = offsets @ ahead
    across = np.linalg.norm(offsets - depths[:, None] * ahead, axis=1)
    central = (depths > 0) & (across < _CENTRAL * depths)
    if not central.any():
        return max(float(np.median(np.linalg.norm(offsets, axis=1))), 1e-3)
    depths = depths[central]
    return float(quantiles(depths, weights[central] / depths**2, (0.5,))[0])


def extend_clipping(owner: bpy.types.SpaceView3D | bpy.types.Camera, distance: float) -> None:
    """Extend the clipping range of a view or camera."""
    owner.clip_end = max(owner.clip_end, 10 * distance)
    owner.clip_start = min(owner.clip_start, 1e-2 * distance)
