"""Framing of an object's visible splats in 3D views."""

import bpy
import numpy as np

from ..cameras.objects import cameras_of, root_of
from ..interface import framing
from . import bounds


def frame_of(ob: bpy.types.Object) -> tuple[np.ndarray, float]:
    """Centre [3] and radius of the bulk of an object's splats in Blender's world, weighted by
    opacity, so that haze of faint splats counts little.

    Raises:
        ValueError: there are none, or their attributes are not accessible in Edit Mode.
    """
    return framing.ball(*_shown(ob))


def turn_views(scene: bpy.types.Scene, ob: bpy.types.Object) -> list[bpy.types.SpaceView3D]:
    """Frame an object's splats in the 3D views of a scene's windows; returns these views.

    If the capture's cameras are in the scene, a view moves to the one with the most similar
    direction, where splats look best and a view of a room is inside. Otherwise it shows the ball
    of `frame_of`.

    Raises:
        ValueError: as `frame_of`.
    """
    placed, weights = _shown(ob)
    root = root_of(ob)
    cameras = [] if root is None else [camera.matrix_world for camera in cameras_of(root)]
    views = framing.views_of(scene)
    for space in views:
        if cameras:
            framing.show_from(space, cameras, placed, weights)
        else:
            framing.show_ball(space, *framing.ball(placed, weights))
    return views


def _shown(ob: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """[M, 3] means and [M] weights of splats."""
    placed = bounds.in_world(ob)
    if not len(placed):
        raise ValueError(f"{ob.name} has no splats to show, or is in Edit Mode.")
    return placed, bounds.opacities(ob)
