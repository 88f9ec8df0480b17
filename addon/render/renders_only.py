"""Render-only effects: camera settings that renders show and 3D views do not."""

import bpy

from .shutter_lens import has_depth_of_field, has_motion_blur


def renders_only(depsgraph: bpy.types.Depsgraph, camera: bpy.types.Object | None) -> str:
    """Status text with the effects that a view in Rendered shading lacks; empty: none.

    Args:
        depsgraph: Depsgraph of the view.
        camera: Camera of the view; None: no camera.
    """
    if camera is None or camera.type != "CAMERA":
        return ""
    scene, data = depsgraph.scene, camera.data
    found = {
        "Depth of Field": has_depth_of_field(camera),
        "Motion Blur": has_motion_blur(scene.render) and depsgraph.view_layer_eval.use_motion_blur,
        "Panoramic": data.type == "PANO",
        "Stereoscopy": scene.render.use_multiview,
    }
    names = [name for name, there in found.items() if there]
    return f"In renders only: {', '.join(names)}" if names else ""
