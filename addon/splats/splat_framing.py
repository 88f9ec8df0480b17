"""Framing of an object's visible splats, in 3D views and by the scene camera, on the bulk of them
as estimated from a sample.
"""

import bpy
import numpy as np

from .. import attributes, compat
from ..cameras import scene_camera
from ..cameras.objects import cameras_of, root_of
from ..interface import framing
from . import objects


def frame_of(ob: bpy.types.Object) -> tuple[np.ndarray, float]:
    """Centre [3] and radius of the bulk of an object's splats in Blender's world, weighted by
    opacity, so that haze of faint splats counts little.

    Raises:
        ValueError: there are none.
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
    cameras = [camera.matrix_world for camera in _cameras(ob)]
    views = framing.views_of(scene)
    for space in views:
        if cameras:
            framing.show_from(space, cameras, placed, weights)
        else:
            framing.show_ball(space, *framing.ball(placed, weights))
    return views


def set_camera(scene: bpy.types.Scene, ob: bpy.types.Object, *, may_add: bool = True) -> list[str]:
    """Set a scene camera for an object's splats, unless the user chose one (`is_chosen`).

    It is the photo camera of the capture with the direction most similar to that of the 3D view;
    without photo cameras a new one that looks as the view does, with the ball of `frame_of` in its
    picture.

    Args:
        scene: The scene.
        ob: The splats.
        may_add: Add a camera where the capture has none.

    Returns:
        Warnings.

    Raises:
        ValueError: as `frame_of`.
    """
    if scene_camera.is_chosen(scene):
        return []
    ahead, cameras = scene_camera.direction_of(scene), _cameras(ob)
    if not cameras:
        if may_add:
            scene_camera.add(scene, ahead, *frame_of(ob))
        return []
    try:
        return scene_camera.use_photo(
            scene, cameras[framing.most_similar([c.matrix_world for c in cameras], ahead)]
        )
    except ValueError as error:
        return [str(error)]


def _cameras(ob: bpy.types.Object) -> list[bpy.types.Object]:
    """The photo cameras of the capture that an object belongs to."""
    root = root_of(ob)
    return [] if root is None else cameras_of(root)


def _shown(ob: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """[M, 3] means and [M] weights of splats."""
    placed = in_world(ob)
    if not len(placed):
        raise ValueError(f"{ob.name} has no splats to show.")
    return placed, opacities(ob)


_MOST = 200_000
"""Largest sample of splats; its quantiles agree with those of all to 0.001."""


def in_world(ob: bpy.types.Object) -> np.ndarray:
    """[M, 3] float64: means in Blender's world; an even sample of many splats. M is 0 for none.

    Raises:
        ValueError: as `objects.catch_up`, or positions are missing or not finite.
    """
    objects.catch_up(ob)
    found = _some(ob, attributes.POSITION)
    if not len(found):
        return np.zeros((0, 3))
    x, y, z = found.T.astype(np.float64)
    matrix = compat.matrix_to_numpy(ob.matrix_world)
    # Spelled out, because starting the threads of a matrix product takes longer than the product.
    return np.stack([a * x + b * y + c * z + d for a, b, c, d in matrix[:3]]).T


def opacities(ob: bpy.types.Object) -> np.ndarray:
    """[M] float64 opacities in [0, 1] of the splats of `in_world`.

    Raises:
        ValueError: as `in_world`.
    """
    return _some(ob, attributes.BASE)[:, 3].astype(np.float64)


def _some(ob: bpy.types.Object, name: str) -> np.ndarray:
    """An even sample of the rows of an attribute."""
    with objects.readable(ob) as data:
        if not len(data.vertices):  # an empty mesh has no attributes
            return np.zeros((0, 4))
        values = attributes.column(data, name)
    return values[:: -(-len(values) // _MOST) or 1]
