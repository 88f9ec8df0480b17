"""Selection of imported objects: selected, chosen in the panel, framed in views."""

import bpy

from .. import stored_paths
from ..interface import framing
from ..interface.base_operator import make_active_in
from .footprint import frame_capture
from .importing import ImportedCapture


def choose(scene: bpy.types.Scene, made: ImportedCapture, *, set_up_views: bool = True) -> None:
    """Let the user find a capture that was imported into a scene, which no window has to show.

    Args:
        scene: Has it.
        made: It.
        set_up_views: Let the 3D views of the scene's windows show its points' colors, and turn them
            to it unless it was there before.
    """
    activate(scene, made.root)
    if set_up_views:
        for space in framing.views_of(scene) if made.renewed else frame_capture(scene, made.root):
            _set_up_view(space)
    settings = getattr(scene, "gscore", None)  # None where cameras alone are registered
    if settings is not None and not settings.capture_path.strip():
        settings.capture_path = made.root[stored_paths.SOURCE]
        settings.images = made.root["gs_images"]


def activate(scene: bpy.types.Scene, ob: bpy.types.Object) -> None:
    """Select an object and no other, and make it the active one, in a scene which no window has to
    show; not where the view layer leaves it out, nor while the user edits or paints another one,
    who could then not leave that mode any more."""
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
    space.shading.show_object_outline = False  # around a dot it leaves nothing but outline
    space.overlay.show_relationship_lines = False
