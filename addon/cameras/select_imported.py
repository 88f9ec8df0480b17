"""Selection of imported objects: select them, choose their capture, frame them in views."""

import bpy

from .. import stored_paths
from ..interface import framing
from ..interface.base_operator import make_active_in
from .capture_transform import frame_capture
from .importing import ImportedCapture


def choose(scene: bpy.types.Scene, made: ImportedCapture, *, set_up_views: bool = True) -> None:
    """Select and frame an imported capture; the scene need not be shown in a window.

    Args:
        scene: The scene.
        made: The imported capture.
        set_up_views: Show the points' colors in the 3D views of the scene's windows, and frame a
            new capture there.
    """
    activate(scene, made.root)
    if set_up_views:
        for space in framing.views_of(scene) if made.renewed else frame_capture(scene, made.root):
            _set_up_view(space)
    settings = getattr(scene, "gscore", None)  # None if only cameras are registered
    if settings is not None and not settings.capture_path.strip():
        settings.capture_path = made.root[stored_paths.SOURCE]
        settings.images = made.root["gs_images"]


def activate(scene: bpy.types.Scene, ob: bpy.types.Object) -> None:
    """Select only one object and make it active, in a scene that need not be shown in a window.

    Does nothing if the view layer excludes it, or while the user edits or paints another object,
    because Blender could then not leave that mode.
    """
    if bpy.context.scene == scene:
        layers = [bpy.context.view_layer]
    else:
        layers = [window.view_layer for window in _windows(scene)] or [scene.view_layers[0]]
    layer, active = layers[0], layers[0].objects.active
    if layer.objects.get(ob.name) == ob and (active is None or active.mode == "OBJECT"):
        make_active_in(layer, ob)


def _windows(scene: bpy.types.Scene) -> list[bpy.types.Window]:
    return [window for window in bpy.context.window_manager.windows if window.scene == scene]


def _set_up_view(space: bpy.types.SpaceView3D) -> None:
    space.shading.color_type = "VERTEX"
    space.shading.show_object_outline = False  # it would cover the small points
    space.overlay.show_relationship_lines = False
