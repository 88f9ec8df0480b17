"""Stereo rendering: the camera of each eye, as Blender defines it."""

from collections.abc import Callable
from dataclasses import replace

import bpy
import numpy as np

from ..cameras import camera_math
from ..cameras.objects import frame_of, lens_of, rigid_viewmat
from ..cameras.render_camera import RenderCamera
from ..compat import matrix_to_numpy

Eye = Callable[[bpy.types.Object], tuple[np.ndarray, float]]
"""Function from an evaluated camera to the eye's matrix to the world, [4, 4], and horizontal
shift."""


def views_of(render: bpy.types.RenderSettings) -> list[str]:
    """Names of the pictures of a frame; one empty name without stereo."""
    eyes = [view.name for view in render.stereo_views if view.use]
    return eyes if render.use_multiview and eyes else [""]


def refusal(scene: bpy.types.Scene, camera: bpy.types.Object | None) -> str:
    """Why a scene cannot be rendered in stereo; empty if it can, or without stereo."""
    if not scene.render.use_multiview:
        return ""
    if scene.render.views_format != "STEREO_3D":
        return (
            "Multi-View is not supported: choose Stereo 3D, or turn off Stereoscopy, in the output "
            "properties."
        )
    if getattr(getattr(camera, "data", None), "type", "") == "PANO":
        return (
            "Panoramas are not supported in stereo: turn off Stereoscopy in the output properties."
        )
    return ""


def eye_of(engine: bpy.types.RenderEngine, view: str) -> Eye | None:
    """Make a view active and return its eye; None without stereo."""
    if not view:
        return None
    engine.active_view_set(view)
    return lambda camera: (
        matrix_to_numpy(engine.camera_model_matrix(camera)),
        engine.camera_shift_x(camera),
    )


def eye_camera(
    eye: Eye, camera: RenderCamera, ob: bpy.types.Object, scene: bpy.types.Scene
) -> RenderCamera:
    """The camera of an eye.

    Args:
        eye: The eye.
        camera: Camera between the eyes, or one of them.
        ob: The same camera as evaluated object.
        scene: Defines the pixels' aspect ratio.
    """
    matrix, shift = eye(ob)
    frame = frame_of(scene, camera.width, camera.height)
    K = camera_math.intrinsics(replace(lens_of(ob.data), shift_x=shift), frame)
    return replace(camera, viewmat=rigid_viewmat(matrix, ob.name), K=K)
