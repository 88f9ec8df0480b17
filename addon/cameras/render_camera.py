"""Render camera: pose and intrinsics of a Blender camera for the rasterizer."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import bpy
import numpy as np

from ..compat import matrix_to_numpy
from . import camera_math as cm
from . import objects as co

Eye = Callable[[bpy.types.Object], tuple[np.ndarray, float]]
"""Function from an evaluated camera to an eye's matrix to the world, [4, 4], and horizontal
shift."""


@dataclass(frozen=True, kw_only=True)
class RenderCamera:
    """Pose and intrinsics of a Blender camera."""

    viewmat: np.ndarray
    """[4, 4] float64, Blender's world to camera, OpenCV axes."""
    K: np.ndarray
    """[3, 3] float64, pixels; orthographic: pixels per world unit."""
    width: int
    """Pixels."""
    height: int
    """Pixels."""
    near: float
    """Clip start, world units."""
    orthographic: bool
    """True if `K` is applied without division by z."""
    name: str = field(compare=False)
    """Name of the object."""


def render_camera(
    camera_object: bpy.types.Object,
    scene: bpy.types.Scene,
    *,
    depsgraph: bpy.types.Depsgraph | None = None,
    width: int | None = None,
    height: int | None = None,
    eye: Eye | None = None,
) -> RenderCamera:
    """The projection of a Blender camera, equal to Blender's own.

    Args:
        camera_object: The camera.
        scene: Defines resolution, percentage and pixel aspect.
        depsgraph: Source of the animated pose and lens; None: the object's current ones.
        width: Pixels; None: the scene's.
        height: Pixels; None: the scene's.
        eye: Pose and shift of an eye of a stereo pair; None: the camera's own.

    Raises:
        ValueError: the object is not a camera, is panoramic or custom, or its matrix is not a pose.
    """
    ob = camera_object.evaluated_get(depsgraph) if depsgraph else camera_object
    if ob.type != "CAMERA":
        raise ValueError(f"{ob.name} is not a camera. Choose a camera.")
    if ob.data.type not in ("PERSP", "ORTHO"):
        kind = {"PANO": "panoramic", "CUSTOM": "custom"}.get(ob.data.type, ob.data.type)
        raise ValueError(
            f"Camera {ob.name} is {kind}; splats are rendered by perspective and orthographic "
            f"cameras. Set its type to one of these."
        )
    frame, lens = co.frame_of(scene, width, height), co.lens_of(ob.data)
    matrix = matrix_to_numpy(ob.matrix_world)
    if eye is not None:
        matrix, shift = eye(ob)
        lens = replace(lens, shift_x=shift)
    return RenderCamera(
        viewmat=co.rigid_viewmat(matrix, ob.name),
        K=cm.intrinsics(lens, frame),
        width=frame.width,
        height=frame.height,
        near=ob.data.clip_start,
        orthographic=ob.data.type == "ORTHO",
        name=ob.name,
    )
