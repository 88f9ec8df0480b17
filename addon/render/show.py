"""Show operator: one button that displays splats in the 3D view as they were trained."""

from collections.abc import Iterable

import bpy
from bpy.props import BoolProperty

from .. import stored_paths
from ..cameras import photos
from ..interface.base_operator import Undoable, make_active
from ..splats import splat_framing
from ..splats.error_maps import is_map, show_map, siblings
from ..splats.objects import in_question, is_splats
from .operators import use_engine


class ShowSplats(Undoable, bpy.types.Operator):
    """Show the splats as they were trained: set engine, colors and shading, hide photos, and align
    views with the photo camera of the most similar direction; it becomes the scene camera, or a new
    one does, if there is none but Blender's default"""

    bl_idname = "gscore.show_splats"
    bl_label = "Show Splats"

    trained: BoolProperty(
        name="Trained",
        description="Show the splats of the last training instead of the active object",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The scene, and hidden splats."""
        ob = _shown_object(context, trained=self.trained)
        return (context.scene, ob) if ob.hide_viewport or ob.hide_render else (context.scene,)

    def run(self, context: bpy.types.Context) -> None:
        """Apply all settings."""
        ob = _shown_object(context, trained=self.trained)
        splat_framing.frame_of(ob)  # raises for empty splats before anything is set
        if any(map(is_map, _of_run(context, ob))):
            show_map(ob, False)
        ob.hide_set(False)
        if ob.hide_viewport or ob.hide_render:
            ob.hide_viewport = ob.hide_render = False
        make_active(context, ob)
        use_engine(context.scene)
        photos.show(context.scene, False)
        context.view_layer.update()  # to evaluate the matrix of hidden objects
        for space in splat_framing.turn_views(context.scene, ob):
            space.shading.type = "RENDERED"
        self.warn(splat_framing.set_camera(context.scene, ob))


def _shown_object(context: bpy.types.Context, *, trained: bool) -> bpy.types.Object:
    """The splats of the training if `trained`, else those that panels are about."""
    result = [context.scene.gscore.result] if trained else []
    for ob in (*result, in_question(context)):
        if is_splats(ob) and context.view_layer.objects.get(ob.name) == ob:
            splats = (other for other in _of_run(context, ob) if not is_map(other))
            return next(splats, ob) if is_map(ob) else ob
    raise ValueError("This scene shows no splats: train some, or import a splat PLY.")


def _of_run(context: bpy.types.Context, ob: bpy.types.Object) -> list[bpy.types.Object]:
    """The splats and error maps of an object's run that are in the view layer."""
    if not stored_paths.read(ob, stored_paths.RUN):
        return []
    splats, maps = siblings(ob)
    return [other for other in (*splats, *maps) if other.name in context.view_layer.objects]
