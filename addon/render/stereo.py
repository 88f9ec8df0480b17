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
"""Gives matrix to the world, [4, 4], and horizontal shift of an evaluated camera as an eye has
them."""


def views_of(render: bpy.types.RenderSettings) -> list[str]:
    """Names of the pictures of a frame; an empty one where there is but one picture."""
    eyes = [view.name for view in render.stereo_views if view.use]
    return eyes if render.use_multiview and eyes else [""]


def refusal(scene: bpy.types.Scene, camera: bpy.types.Object | None) -> str:
    """Why there are no such pictures of a scene; empty where there are, or none are wanted."""
    if not scene.render.use_multiview:
        return ""
    if scene.render.views_format != "STEREO_3D":
        return (
            "Views of several cameras are not rendered: choose Stereo 3D, or turn off Stereoscopy, "
            "in the output properties."
        )
    if getattr(getattr(camera, "data", None), "type", "") == "PANO":
        return (
            "Panoramas are not rendered in stereo: turn off Stereoscopy in the output properties."
        )
    return ""


def eye_of(engine: bpy.types.RenderEngine, view: str) -> Eye | None:
    """An eye, of which the next picture will be; None where there is but one picture."""
    if not view:
        return None
    engine.active_view_set(view)
    return lambda camera: (
        matrix_to_numpy(engine.camera_model_matrix(camera)),
        engine.camera_shift_x(camera),
    )


def seen_by(
    eye: Eye, camera: RenderCamera, ob: bpy.types.Object, scene: bpy.types.Scene
) -> RenderCamera:
    """A camera as an eye looks through it.

    Args:
        eye: Which one.
        camera: Between the eyes, or one of them.
        ob: The same, evaluated.
        scene: Gives the pixels' aspect.
    """
    matrix, shift = eye(ob)
    frame = frame_of(scene, camera.width, camera.height)
    K = camera_math.intrinsics(replace(lens_of(ob.data), shift_x=shift), frame)
    return replace(camera, viewmat=rigid_viewmat(matrix, ob.name), K=K)
