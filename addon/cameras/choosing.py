"""A capture brought into a scene: imported, selected, chosen in the panel, and seen in views."""

from collections.abc import Callable
from pathlib import Path

import bpy

from .. import stored_paths
from ..interface.operators import make_active_in
from . import captures
from .captures import ImportedCapture


def into_scene(
    scene: bpy.types.Scene,
    path: str | Path,
    *,
    images: str = "images",
    photos: bool = True,
    points: bool = True,
    align: bool = True,
    set_up_views: bool = True,
    progress: Callable[[float], None] | None = None,
) -> ImportedCapture:
    """Import a capture into a scene, which no window has to show.

    Args:
        scene: As in `import_capture`, with all that it raises.
        path: As there.
        images: As there.
        photos: As there.
        points: As there.
        align: As there.
        set_up_views: Let the 3D views of the scene's windows show its points' colors.
        progress: As there.
    """
    made = captures.import_capture(
        scene, path, images=images, photos=photos, points=points, align=align, progress=progress
    )
    windows = [w for w in bpy.context.window_manager.windows if w.scene == scene]
    if bpy.context.scene == scene:
        layers = [bpy.context.view_layer]
    else:
        layers = [w.view_layer for w in windows] or [scene.view_layers[0]]
    make_active_in(layers[0], made.root)
    if set_up_views:
        for window in windows:
            _set_up_views(window.screen)
    settings = getattr(scene, "gscore", None)  # None where cameras alone are registered
    if settings is not None and not settings.capture_path.strip():
        settings.capture_path, settings.images = made.root[stored_paths.SOURCE], images
    return made


def _set_up_views(screen: bpy.types.Screen) -> None:
    for space in (area.spaces.active for area in screen.areas if area.type == "VIEW_3D"):
        space.shading.color_type = "VERTEX"
        space.shading.show_object_outline = False  # around a dot it leaves nothing but outline
        space.overlay.show_relationship_lines = False
