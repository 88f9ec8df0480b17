"""Operators on splats: filters, crop, scale, display, conversion of native splats."""

from collections.abc import Iterable
from typing import ClassVar

import bpy

from .. import compat
from ..interface.base_operator import BaseOperator, make_active
from ..interface.blocks import with_uid
from ..interface.incremental_operator import IncrementalOperator
from ..process.incremental_tasks import Pieces
from . import edit, native_splats, settings, uniform_scale
from .objects import active_splats, is_native, is_splats


class OnSplats(BaseOperator):
    """Base of operators on the active splat object, or on the one that the active object crops; by
    default they change its settings."""

    bl_options: ClassVar = {"REGISTER", "UNDO"}

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The object."""
        return (active_splats(context),)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """True if the active object is a splat object."""
        if is_splats(active_splats(context)):
            return True
        cls.poll_message_set("Select a splat object: import a splat PLY or train one")
        return False


class ResetFilters(OnSplats, bpy.types.Operator):
    """Show all splats again"""

    bl_idname = "gscore.reset_filters"
    bl_label = "Reset Filters"

    def act(self, context: bpy.types.Context) -> str:
        """Reset."""
        settings.reset_filters(active_splats(context))
        return ""


class AddCropBox(OnSplats, bpy.types.Operator):
    """Add a wire box around most splats and show only splats inside; move or scale the box"""

    bl_idname = "gscore.add_crop_box"
    bl_label = "Add Crop Box"

    def act(self, context: bpy.types.Context) -> str:
        """Add."""
        make_active(context, edit.add_crop_box(context, active_splats(context)))
        return ""


class MakeScaleEven(OnSplats, bpy.types.Operator):
    """Make the scale of the object and its parents uniform, keeping the volume, because splats
    cannot be stretched"""

    bl_idname = "gscore.make_scale_even"
    bl_label = "Make Scale Even"

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The objects with a changed scale."""
        return uniform_scale.uneven(active_splats(context))

    def act(self, context: bpy.types.Context) -> str:
        """Change the scales."""
        changed = uniform_scale.make_even(context, active_splats(context))
        if changed:
            return f"Made the scale uniform: {', '.join(changed)}."
        return "The scale is uniform already."


class ResetDisplay(IncrementalOperator, OnSplats, bpy.types.Operator):
    """Add the display modifier again after it was removed, or update it"""

    bl_idname = "gscore.reset_display"
    bl_label = "Restore Display"

    def pieces(self, context: bpy.types.Context) -> Pieces[str]:
        """Build the display if the file has none, then attach it."""
        ob = active_splats(context)
        name, uid = ob.name, ob.session_uid
        yield from settings.building()
        ob = with_uid(bpy.data.objects, uid)
        if ob is None:
            raise ValueError(f"{name} was removed; its display was not restored.")
        settings.attach(ob)
        return ""


class TakeNativeSplats(IncrementalOperator, bpy.types.Operator):
    """Convert a copy of Blender's own Gaussian splats to a splat object for filters, tools and
    training; the original is hidden"""

    bl_idname = "gscore.take_native_splats"
    bl_label = "Make Splat Object"
    bl_options: ClassVar = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """True if the active object is a cloud of native splats."""
        if is_native(context.object):
            return True
        cls.poll_message_set("Select Gaussian splats that Blender imported (5.3 or later)")
        return False

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The scene, and the cloud, which gets hidden."""
        return (context.scene, context.object)

    def pieces(self, context: bpy.types.Context) -> Pieces[str]:
        """Convert the splats."""
        made = yield from native_splats.taking(context.object)
        if context.mode == "OBJECT" and made.name in context.view_layer.objects:
            make_active(context, made)
        return f"{made.name} has {len(made.data.vertices):,} splats."


CLASSES = (
    ResetFilters,
    AddCropBox,
    MakeScaleEven,
    ResetDisplay,
    TakeNativeSplats,
)


def check_shown(ob: bpy.types.Object) -> None:
    """Raise ValueError unless the view layer shows an object, which Edit Mode requires."""
    if not ob.visible_get():
        raise ValueError(f"{ob.name} is hidden; show it, with its eye in the outliner, to edit it.")


def edit_vertices(context: bpy.types.Context, ob: bpy.types.Object) -> None:
    """Enter Edit Mode of only one object, in vertex select mode.

    Raises:
        ValueError: it is hidden.
    """
    check_shown(ob)
    make_active(context, ob)
    compat.tool_settings(context).mesh_select_mode = (True, False, False)
    bpy.ops.object.mode_set(mode="EDIT")
