"""Stereo rendering: the eyes of a picture, as Blender defines them."""

from collections.abc import Iterator

import bpy
import numpy as np

from ..cameras.render_camera import Eye
from ..compat import matrix_to_numpy


def eyes_of(
    engine: bpy.types.RenderEngine, render: bpy.types.RenderSettings
) -> Iterator[tuple[str, Eye | None]]:
    """Name and eye of each picture of a frame, made active in turn; an empty name and None without
    stereo."""
    eyes = [view.name for view in render.stereo_views if view.use]
    if not (render.use_multiview and eyes):
        yield "", None
        return

    def eye(camera: bpy.types.Object) -> tuple[np.ndarray, float]:
        matrix = matrix_to_numpy(engine.camera_model_matrix(camera))
        return matrix, engine.camera_shift_x(camera)

    for name in eyes:
        engine.active_view_set(name)
        yield name, eye


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
