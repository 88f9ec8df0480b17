"""Edit operators of splats: grade, separate, join, delete, rotate; Object and Edit Mode."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

import bpy
import numpy as np
from bpy.props import BoolProperty, FloatProperty, FloatVectorProperty

from .. import attributes
from ..core import rgb_to_sh0, sh0_to_rgb
from ..interface.base_operator import make_active
from ..interface.blocks import with_uid
from ..interface.incremental_operator import IncrementalOperator
from ..process.incremental_tasks import Check, Steps, run_in_thread
from . import edit, objects, separate_join
from .edit_guard import EditGuard
from .operators import OnSplats, edit_vertices
from .read_chunked import read_chunked

_LUMA = np.array([0.2126, 0.7152, 0.0722])
"""Luma weights of Rec. 709."""
_BLOCK = 1 << 14
"""Splats per block, so that intermediate results stay in the cache."""


@dataclass(frozen=True, kw_only=True)
class Grade:
    """Grading operations in this order on sRGB values; three values are per channel."""

    lift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """New value of black; white stays."""
    gamma: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Above 1 brightens the midtones; black and white stay."""
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """New value of white; black stays."""
    saturation: float = 1.0
    """0 for grey."""


def graded(base: np.ndarray, grade: Grade) -> np.ndarray:
    """[N, 4] float32: graded `radiance:base` [N, 4], bit-identical for a neutral grade.

    View-dependent coefficients stay unchanged; values below 0, which they may raise again, keep
    their sign.
    """
    out = base.copy()
    if grade != Grade():
        for at in range(0, len(base), _BLOCK):
            out[at : at + _BLOCK, :3] = _colors(base[at : at + _BLOCK, :3], grade)
    return out


def _colors(sh0: np.ndarray, grade: Grade) -> np.ndarray:
    """[K, 3] float64 coefficients of colours [K, 3]."""
    colors = sh0_to_rgb(sh0.astype(np.float64))
    lift, gamma, gain = (np.array(v) for v in (grade.lift, grade.gamma, grade.gain))
    colors = lift + colors * (1 - lift)
    if (gamma != 1).any():
        colors = np.sign(colors) * np.abs(colors) ** (1 / gamma)
    colors *= gain
    grey = (colors @ _LUMA)[:, None]
    return rgb_to_sh0(grey + (colors - grey) * grade.saturation)


class Editing(IncrementalOperator, OnSplats):
    """Base of edits that leave Edit Mode for the edit, and return to it."""

    leaves_edit_mode: ClassVar = True
    """True if the operator is available in Edit Mode."""

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The points."""
        return (objects.active_splats(context).data,)

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Leave Edit Mode, edit, and enter it again."""
        ob = objects.active_splats(context)
        objects.catch_up(ob)
        if not self.leaves_edit_mode:
            objects.check_writable(ob)
        uid, edited = ob.session_uid, ob.mode == "EDIT"
        if edited:
            bpy.ops.object.mode_set(mode="OBJECT")
        guard = None
        try:
            objects.check_writable(ob)
            context.view_layer.update()  # else the guard would detect earlier changes
            guard = EditGuard(ob)
            return (yield from self.edit(context, guard))
        finally:
            if guard is not None:
                guard.close()
            if edited:
                _edit_again(context, uid)

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """The edit in steps; raises ValueError if it is not possible."""
        raise NotImplementedError


def _edit_again(context: bpy.types.Context, uid: int) -> None:
    """Return to Edit Mode of an object, if it exists and no other mode is active."""
    ob = with_uid(bpy.data.objects, uid)
    if ob is None or context.mode != "OBJECT" or ob.name not in context.view_layer.objects:
        return
    if ob.visible_get():
        edit_vertices(context, ob)


class GradeSplats(Editing, bpy.types.Operator):
    """Change the colors of the selected splats, or of all; their view dependence stays"""

    bl_idname = "gscore.grade_splats"
    bl_label = "Grade Splats"

    lift: FloatVectorProperty(
        name="Lift", description="New value of black", min=-1.0, max=0.99, default=(0, 0, 0)
    )
    gamma: FloatVectorProperty(
        name="Gamma",
        description="Above 1 brightens the midtones",
        min=0.05,
        max=20.0,
        default=(1, 1, 1),
    )
    gain: FloatVectorProperty(
        name="Gain", description="New value of white", min=0.0, max=20.0, default=(1, 1, 1)
    )
    saturation: FloatProperty(
        name="Saturation", description="Color saturation; 0: grey", min=0.0, max=10.0, default=1.0
    )
    only_selected: BoolProperty(
        name="Only Selected",
        description="Change only selected splats; by default on if there are any",
        options={"SKIP_SAVE"},
    )

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Grade."""
        ob = guard.there()
        selected, whole = attributes.selected(ob.data), len(ob.data.vertices)
        if self.options.is_invoke and not self.properties.is_property_set("only_selected"):
            self.only_selected = bool(selected.any())
        some = selected if self.only_selected else slice(None)
        grade = Grade(
            lift=tuple(self.lift),
            gamma=tuple(self.gamma),
            gain=tuple(self.gain),
            saturation=self.saturation,
        )
        columns = yield from read_chunked(ob, [attributes.BASE])
        base = columns[attributes.BASE]

        def change(check: Check) -> int:
            base[some] = graded(base[some], grade)
            return len(base[some])

        count = yield from run_in_thread(change, self.bl_label)
        mesh = guard.to_change().data
        kind = mesh.attributes[attributes.BASE].data_type
        attributes.fill(mesh, attributes.BASE, kind, base.ravel())
        mesh.update()
        return f"Graded {count:,} of {whole:,} splats."


class SeparateSplats(Editing, bpy.types.Operator):
    """Move the selected splats with all their attributes into a new object"""

    bl_idname = "gscore.separate_splats"
    bl_label = "Separate Splats"

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Separate."""
        made = yield from separate_join.separated(guard, attributes.selected(guard.there().data))
        return f"Moved {len(made.data.vertices):,} splats to {made.name}."


def _others(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The selected splat objects other than the active one."""
    own = objects.active_splats(context)
    return [o for o in context.selected_objects if objects.is_splats(o) and o != own]


class JoinSplats(Editing, bpy.types.Operator):
    """Join the other selected splat objects into the active one, with their transforms applied to
    positions, orientations, sizes and colors"""

    bl_idname = "gscore.join_splats"
    bl_label = "Join Splats"

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The points of the active object, the removed other objects, and their children."""
        others = _others(context)
        children = [child for other in others for child in other.children]
        return (*super().changes(context), *others, *children)

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Join."""
        ob, others = guard.there(), _others(context)
        separate_join.check_joinable(ob, others)  # before the selection changes
        make_active(context, ob)  # now, because 4.2 crashes after selected objects are removed
        guards = [EditGuard(other) for other in others]
        try:
            ob = yield from separate_join.joined(guard, guards)
        finally:
            for other in guards:
                other.close()
                left = other.found()
                if left is not None and left.name in context.view_layer.objects:
                    left.select_set(True)  # it was not joined
        return f"{ob.name} has {len(ob.data.vertices):,} splats."


class _EditingObject(Editing):
    """Base of edits, in Object Mode, that also change the object's settings or transform."""

    leaves_edit_mode = False

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The points, and the object."""
        ob = objects.active_splats(context)
        return ob.data, ob


class ApplyFilters(_EditingObject, bpy.types.Operator):
    """Delete the splats that the display filters hide, then reset the filters"""

    bl_idname = "gscore.apply_filters"
    bl_label = "Delete Hidden Splats"

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Delete."""
        count = yield from edit.apply_filters(guard)
        return f"Deleted {count:,} splats, {len(guard.found().data.vertices):,} left."


class ApplySplatTransform(_EditingObject, bpy.types.Operator):
    """Apply location, rotation and even scale to the splats, with their orientations and colors"""

    bl_idname = "gscore.apply_splat_transform"
    bl_label = "Apply Splat Transform"

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Apply."""
        yield from edit.apply_transform(guard)
        return ""
