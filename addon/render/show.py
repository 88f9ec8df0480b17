"""Splats as they were trained, in the 3D view, by one button."""

from collections.abc import Iterable
from typing import ClassVar

import bpy
import numpy as np
from bpy.props import BoolProperty
from mathutils import Vector

from .. import stored_paths
from ..cameras import photos
from ..interface.operators import Acting, make_active
from ..splats import places
from ..splats.error_maps import is_map, show_map, siblings
from ..splats.objects import in_question, is_splats
from .operators import use_engine

_MOST = 0.9
"""Share of the splats, on each axis and then those nearest to their middle, that a view is turned
to: the rest is sky."""
_ROOM = 2.5
"""Distance from the middle, in radii of what is framed, at which Blender's usual lens shows it."""


def frame_of(ob: bpy.types.Object) -> tuple[np.ndarray, float]:
    """Middle [3] and radius of most of an object's splats, in Blender's world.

    Raises:
        ValueError: there are none, or their attributes are out of reach in Edit Mode.
    """
    placed = places.in_world(ob)
    if not len(placed):
        raise ValueError(f"{ob.name} shows no splats: it has none, or is in Edit Mode.")
    # Of a box, as the median lies on the ground wherever that has the most splats.
    middle = np.quantile(placed, [(1 - _MOST) / 2, (1 + _MOST) / 2], axis=0).mean(axis=0)
    return middle, float(np.quantile(np.linalg.norm(placed - middle, axis=1), _MOST))


class ShowSplats(Acting, bpy.types.Operator):
    """Show the splats as they were trained: engine, colors and shading are set, photos hidden, and
    the view is turned to the splats"""

    bl_idname = "gscore.show_splats"
    bl_label = "Show Splats"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    trained: BoolProperty(
        name="Trained",
        description="Those of the last training, whatever is active",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The scene, and splats that are hidden."""
        ob = _wanted(context, trained=self.trained)
        return (context.scene, ob) if ob.hide_viewport or ob.hide_render else (context.scene,)

    def act(self, context: bpy.types.Context) -> str:
        """Set all of it."""
        ob = _wanted(context, trained=self.trained)
        middle, radius = frame_of(ob)
        if any(map(is_map, _of_run(context, ob))):
            show_map(ob, False)
        ob.hide_set(False)
        if ob.hide_viewport or ob.hide_render:
            ob.hide_viewport = ob.hide_render = False
        make_active(context, ob)
        use_engine(context.scene)
        photos.show(context.scene, False)
        for area in context.screen.areas if context.screen else ():
            if area.type == "VIEW_3D":
                _turn(area.spaces.active, middle, radius)
        return ""


def _wanted(context: bpy.types.Context, *, trained: bool) -> bpy.types.Object:
    """The splats of the training, if these are asked for, else those that panels are about."""
    result = [context.scene.gscore.result] if trained else []
    for ob in (*result, in_question(context)):
        if is_splats(ob) and context.view_layer.objects.get(ob.name) == ob:
            splats = (other for other in _of_run(context, ob) if not is_map(other))
            return next(splats, ob) if is_map(ob) else ob
    raise ValueError("This scene shows no splats: train some, or import a splat PLY.")


def _of_run(context: bpy.types.Context, ob: bpy.types.Object) -> list[bpy.types.Object]:
    """The splats and maps of errors of an object's run, as far as the view layer has them."""
    if not stored_paths.read(ob, stored_paths.RUN):
        return []
    splats, maps = siblings(ob)
    return [other for other in (*splats, *maps) if other.name in context.view_layer.objects]


def _turn(space: bpy.types.SpaceView3D, middle: np.ndarray, radius: float) -> None:
    """Shade a view and look at the splats from where it looks; a camera's view stays its own."""
    space.shading.type = "RENDERED"
    region = space.region_3d
    if region.view_perspective != "CAMERA":
        region.view_location = Vector(middle)
        region.view_distance = max(_ROOM * radius, 1e-3)


CLASSES = (ShowSplats,)
