"""Scene camera: that of a photo, or a new one around a ball, in place of Blender's default."""

import math
from dataclasses import replace

import bpy
import numpy as np
from mathutils import Euler, Matrix, Vector

from ..interface import framing
from . import camera_math as cm
from . import objects as co

_DEFAULT = Matrix.LocRotScale((7.358891, -6.925791, 4.958309), Euler((1.109319, 0, 0.814928)), None)
"""Pose of the camera in Blender's startup file."""
_SAME = 1e-4
"""Tolerance of its entries, world units."""
_MARGIN = 1.3
"""Distance of a new camera per distance at which the ball touches the picture's sides: the ball of
`framing.ball` leaves out a tenth of the splats, for example a head."""


def is_chosen(scene: bpy.types.Scene) -> bool:
    """True if the scene camera, or one bound to a marker, is not Blender's default as it was."""
    return any(marker.camera for marker in scene.timeline_markers) or not (
        scene.camera is None or _is_default(scene.camera)
    )


def _is_default(ob: bpy.types.Object) -> bool:
    """True if an object is the camera of Blender's startup file, unchanged."""
    if ob.type != "CAMERA" or ob.parent is not None or ob.constraints:
        return False
    if ob.animation_data is not None or ob.data.animation_data is not None:
        return False
    lens = replace(co.lens_of(ob.data), ortho_scale=cm.Lens.ortho_scale)  # Blender's versions vary
    apart = np.abs(np.array(ob.matrix_basis) - np.array(_DEFAULT)).max()
    return lens == cm.Lens() and not ob.data.dof.use_dof and bool(apart < _SAME)


def direction_of(scene: bpy.types.Scene) -> Vector:
    """Direction of a 3D view of the scene's windows, a unit vector; without one, that of Blender's
    default camera."""
    for space in framing.views_of(scene):
        return space.region_3d.view_rotation @ Vector((0, 0, -1))
    return -_DEFAULT.col[2].xyz


def use_photo(scene: bpy.types.Scene, ob: bpy.types.Object) -> list[str]:
    """Make a photo's camera the scene camera, with the photo's resolution and pixel aspect.

    The resolution percentage stays.

    Returns:
        A sentence if the pixels are not square.

    Raises:
        ValueError: a custom property of the camera is missing or invalid; nothing is changed.
    """
    own, render = co.photo_camera_of(ob), scene.render
    _, frame = cm.lens_from_intrinsics(own.K, own.width, own.height)
    scene.camera = ob
    render.resolution_x, render.resolution_y = own.width, own.height
    render.pixel_aspect_x, render.pixel_aspect_y = frame.pixel_aspect_x, frame.pixel_aspect_y
    aspect = frame.pixel_aspect_x / frame.pixel_aspect_y
    if abs(aspect - 1) <= 1e-3:
        return []
    return [
        f"fx and fy of {own.image} differ; the scene's pixel aspect is now {aspect:.4f} for it."
    ]


def add(scene: bpy.types.Scene, ahead: Vector, middle: np.ndarray, radius: float) -> None:
    """Make a new camera the scene camera, with a ball and a margin in its picture.

    Args:
        scene: Its resolution and pixel aspect stay.
        ahead: Viewing direction, a unit vector.
        middle: [3] centre of the ball.
        radius: Of the ball, world units.
    """
    data = bpy.data.cameras.new("Splats")
    ob = bpy.data.objects.new("Splats Camera", data)
    scene.collection.objects.link(ob)
    frame, lens = co.frame_of(scene), co.lens_of(data)
    K = cm.intrinsics(lens, frame)
    half = math.atan(min(frame.width / K[0, 0], frame.height / K[1, 1]) / 2)
    distance = _MARGIN * max(radius, 1e-6) / math.sin(half)
    ob.location = Vector(middle) - distance * ahead
    ob.rotation_euler = ahead.to_track_quat("-Z", "Y").to_euler()
    framing.extend_clipping(data, distance + radius)
    scene.camera = ob
