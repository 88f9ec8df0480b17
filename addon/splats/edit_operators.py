"""Operators that select, grade, separate and join splats, in Object and in Edit Mode, with undo."""

from collections.abc import Callable, Iterable
from typing import ClassVar

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, FloatVectorProperty, IntProperty

from .. import attributes
from ..core import in_unit_shape
from ..interface.operators import make_active
from ..interface.stepping import Stepping
from ..process.pieces import Check, Pieces, aside
from . import choose, edit, filters, grading, objects, parts
from .held import Held
from .leaving import leaving
from .operators import OnSplats, check_shown, edit_vertices

_MODES = [
    (choose.SET, "New", "Select what is found, and nothing else"),
    (choose.ADD, "Add", "Add what is found to the selection"),
    (choose.TAKE, "Subtract", "Deselect what is found"),
    (choose.COMMON, "Intersect", "Keep selected what is found"),
]


class Editing(Stepping, OnSplats):
    """Works on the mesh outside of Edit Mode, and goes back to it."""

    leaves_edit_mode: ClassVar = True
    """Whether it does; else it is refused there."""

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The points."""
        return (objects.meant(context).data,)

    def pieces(self, context: bpy.types.Context) -> Pieces[str]:
        """Leave Edit Mode, edit, and enter it again."""
        ob = objects.meant(context)
        objects.catch_up(ob)
        if not self.leaves_edit_mode:
            objects.check_writable(ob)
        uid, edited = ob.session_uid, ob.mode == "EDIT"
        if edited:
            bpy.ops.object.mode_set(mode="OBJECT")
        held = None
        try:
            objects.check_writable(ob)
            context.view_layer.update()  # what was done until now is no change
            held = Held(ob)
            return (yield from self.edit(context, held))
        finally:
            if held is not None:
                held.close()
            if edited:
                _edit_again(context, uid)

    def edit(self, context: bpy.types.Context, held: Held) -> Pieces[str]:
        """Do it; ValueError where it cannot be done."""
        raise NotImplementedError


def _edit_again(context: bpy.types.Context, uid: int) -> None:
    """Enter Edit Mode of an object, where it is still there and nothing else was begun."""
    ob = next((one for one in bpy.data.objects if one.session_uid == uid), None)
    if ob is None or context.mode != "OBJECT" or ob.name not in context.view_layer.objects:
        return
    if ob.visible_get():
        edit_vertices(context, ob)


Find = Callable[[dict[str, np.ndarray]], np.ndarray]
"""[N] bool, which splats are meant, of copies of attributes; in a thread."""


class _Choosing(Editing):
    """Selects vertices and enters Edit Mode, where they are seen."""

    reads: ClassVar[tuple[str, ...]]
    """Attributes that tell which."""

    @property
    def how(self) -> str:
        """What becomes of the selection, as `choose.combined` takes it."""
        return choose.SET

    def edit(self, context: bpy.types.Context, held: Held) -> Pieces[str]:
        """Select."""
        ob = held.there()
        check_shown(ob)  # before the selection changes
        before = attributes.selected(ob.data)
        find, how = self.find(ob, before), self.how
        columns = yield from leaving(ob, self.reads)
        chosen = yield from aside(
            lambda check: choose.combined(before, find(columns), how), self.bl_label
        )
        ob = held.to_change()
        check_shown(ob)
        attributes.select(ob.data, chosen)
        ob.data.update()
        edit_vertices(context, ob)
        return f"{int(chosen.sum()):,} splats are selected."

    def find(self, ob: bpy.types.Object, before: np.ndarray) -> Find:
        """What tells which are meant; `before` [N] are selected. ValueError as `edit`."""
        raise NotImplementedError


class _Selecting(_Choosing):
    """Adds to the selection, or takes away from it."""

    mode: EnumProperty(name="Mode", description="What becomes of the selection", items=_MODES)

    @property
    def how(self) -> str:
        """As the property says."""
        return self.mode


class SelectSplats(_Choosing, bpy.types.Operator):
    """Select splats by what the display filters hide, in Edit Mode"""

    bl_idname = "gscore.select_splats"
    bl_label = "Select Splats"
    reads = filters.LOOKED_AT

    which: EnumProperty(
        name="Which",
        description="Splats to select; all others are deselected",
        items=[
            ("HIDDEN", "Hidden", "Splats that the filters hide"),
            ("VISIBLE", "Visible", "Splats that the filters show"),
        ],
    )

    def find(self, ob: bpy.types.Object, before: np.ndarray) -> Find:
        """As the filters say."""
        limits, hidden = filters.filters_of(ob), self.which == "HIDDEN"
        return lambda columns: filters.passing(columns, limits) != hidden


def _need_seeds(before: np.ndarray) -> None:
    if not before.any():
        raise ValueError("Select a splat to begin with, in Edit Mode.")


class SelectByColor(_Selecting, bpy.types.Operator):
    """Select splats that have the color of the selected ones, or one that is chosen"""

    bl_idname = "gscore.select_by_color"
    bl_label = "Select by Color"
    reads = (attributes.BASE,)

    picked: BoolProperty(
        name="Chosen Color",
        description="Compare with the color below, not with the mean of the selected splats",
    )
    color: FloatVectorProperty(
        name="Color",
        description="What to compare with",
        subtype="COLOR_GAMMA",
        min=0.0,
        max=1.0,
        default=(0.5, 0.5, 0.5),
    )
    tolerance: FloatProperty(
        name="Tolerance",
        description="Largest distance of colors; black and white are 1.73 apart",
        default=0.15,
        min=0.0,
        max=1.74,
    )

    def find(self, ob: bpy.types.Object, before: np.ndarray) -> Find:
        """By distance in sRGB values."""
        color, tolerance = np.array(self.color) if self.picked else None, self.tolerance
        if color is None:
            _need_seeds(before)

        def alike(columns: dict[str, np.ndarray]) -> np.ndarray:
            base = columns[attributes.BASE]
            wanted = choose.colors(base[before]).mean(axis=0) if color is None else color
            return choose.alike(base, wanted, tolerance)

        return alike


class SelectByOpacity(_Selecting, bpy.types.Operator):
    """Select splats by their opacity"""

    bl_idname = "gscore.select_by_opacity"
    bl_label = "Select by Opacity"
    reads = (attributes.BASE,)

    low: FloatProperty(name="From", description="Smallest opacity", min=0.0, max=1.0)
    high: FloatProperty(name="To", description="Largest opacity", min=0.0, max=1.0, default=0.1)

    def find(self, ob: bpy.types.Object, before: np.ndarray) -> Find:
        """Both ends belong to it."""
        low, high = np.float32(self.low), np.float32(self.high)

        def between(columns: dict[str, np.ndarray]) -> np.ndarray:
            opacities = columns[attributes.BASE][:, 3]
            return (opacities >= low) & (opacities <= high)

        return between


class SelectBySize(_Selecting, bpy.types.Operator):
    """Select splats by their largest standard deviation"""

    bl_idname = "gscore.select_by_size"
    bl_label = "Select by Size"
    reads = (attributes.SCALE,)

    low: FloatProperty(
        name="From", description="Smallest size, before the object's scale", min=0.0, precision=5
    )
    high: FloatProperty(name="To", description="Largest size; 0 for no limit", min=0.0, precision=5)

    def find(self, ob: bpy.types.Object, before: np.ndarray) -> Find:
        """Both ends belong to it."""
        low, high = self.low, self.high

        def between(columns: dict[str, np.ndarray]) -> np.ndarray:
            return choose.between(columns[attributes.SCALE].max(axis=1, initial=0.0), low, high)

        return between


class SelectInCrop(_Selecting, bpy.types.Operator):
    """Select splats whose center lies in the crop object: its box, or the ellipsoid in it"""

    bl_idname = "gscore.select_in_crop"
    bl_label = "Select in Crop"
    reads = (attributes.POSITION,)

    def find(self, ob: bpy.types.Object, before: np.ndarray) -> Find:
        """As the filters, without their other limits."""
        if not filters.is_cropped(ob):
            raise ValueError(f"{ob.name} has no crop object: use Add Crop Box under Filters.")
        matrix = filters.crop_matrix(ob, ob.gscore.crop_object)
        sphere = ob.gscore.crop_shape == filters.SPHERE
        return lambda columns: in_unit_shape(columns[attributes.POSITION], matrix, sphere=sphere)


class SelectFlood(_Selecting, bpy.types.Operator):
    """Select what hangs together with the selected splats, without a gap"""

    bl_idname = "gscore.select_flood"
    bl_label = "Flood Select"
    reads = (attributes.POSITION, attributes.BASE)

    gap: FloatProperty(
        name="Gap",
        description="Side of the cells that space is cut into, before the object's scale; splats "
        "in cells that touch hang together",
        default=0.05,
        min=1e-6,
        precision=4,
    )
    tolerance: FloatProperty(
        name="Color Tolerance",
        description="Largest distance from the mean color of the selected splats; 0 for any color",
        min=0.0,
        max=1.74,
    )

    def find(self, ob: bpy.types.Object, before: np.ndarray) -> Find:
        """From the selected ones on."""
        _need_seeds(before)
        gap, tolerance = self.gap, self.tolerance

        def flooded(columns: dict[str, np.ndarray]) -> np.ndarray:
            means, base = columns[attributes.POSITION], columns[attributes.BASE]
            return choose.flooded(means, base, before, gap, tolerance)

        return flooded


class SelectFloaters(_Selecting, bpy.types.Operator):
    """Select splats that hang together with few others: floaters, and small clusters"""

    bl_idname = "gscore.select_floaters"
    bl_label = "Select Floaters"
    reads = (attributes.BASE, attributes.SCALE, attributes.ROTATION, attributes.POSITION)

    few: IntProperty(
        name="Fewer Than", description="Splats of a cluster that stays", default=100, min=2
    )
    gap: FloatProperty(
        name="Gap",
        description="Side of the cells whose touching makes a cluster, as a share of the size of "
        "the whole",
        default=0.05,
        min=1e-4,
        max=10.0,
    )

    def find(self, ob: bpy.types.Object, before: np.ndarray) -> Find:
        """As `gscore convert --min-cluster`."""
        gap, few = self.gap, self.few
        return lambda columns: choose.floaters(attributes.as_splats(columns), gap, few)


class GradeSplats(Editing, bpy.types.Operator):
    """Change the colors of the selected splats, or of all; how they depend on the view stays"""

    bl_idname = "gscore.grade_splats"
    bl_label = "Grade Splats"

    lift: FloatVectorProperty(
        name="Lift", description="Where black goes", min=-1.0, max=0.99, default=(0, 0, 0)
    )
    gamma: FloatVectorProperty(
        name="Gamma",
        description="Above 1 brightens the middle",
        min=0.05,
        max=20.0,
        default=(1, 1, 1),
    )
    gain: FloatVectorProperty(
        name="Gain", description="Where white goes", min=0.0, max=20.0, default=(1, 1, 1)
    )
    saturation: FloatProperty(
        name="Saturation", description="0 for grey", min=0.0, max=10.0, default=1.0
    )
    only_selected: BoolProperty(
        name="Only Selected", description="Leave out what is not selected in Edit Mode"
    )

    def edit(self, context: bpy.types.Context, held: Held) -> Pieces[str]:
        """Grade."""
        ob = held.there()
        some = attributes.selected(ob.data) if self.only_selected else slice(None)
        grade = grading.Grade(
            lift=tuple(self.lift),
            gamma=tuple(self.gamma),
            gain=tuple(self.gain),
            saturation=self.saturation,
        )
        columns = yield from leaving(ob, [attributes.BASE])
        base = columns[attributes.BASE]

        def change(check: Check) -> int:
            graded = grading.graded(base[some], grade)
            base[some] = graded
            return len(graded)

        count = yield from aside(change, self.bl_label)
        mesh = held.to_change().data
        kind = mesh.attributes[attributes.BASE].data_type
        attributes.fill(mesh, attributes.BASE, kind, base.ravel())
        mesh.update()
        return f"{count:,} splats graded."


class SeparateSplats(Editing, bpy.types.Operator):
    """Move the selected splats into an object of their own, with all that they carry"""

    bl_idname = "gscore.separate_splats"
    bl_label = "Separate Splats"

    def edit(self, context: bpy.types.Context, held: Held) -> Pieces[str]:
        """Separate."""
        made = yield from parts.separated(held, attributes.selected(held.there().data))
        return f"{len(made.data.vertices):,} splats are {made.name}."


def _others(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The selected splat objects besides the one that is worked on."""
    own = objects.meant(context)
    return [o for o in context.selected_objects if objects.is_splats(o) and o != own]


class JoinSplats(Editing, bpy.types.Operator):
    """Take the other selected splat objects into the active one, as they are seen: places, turns,
    sizes and colors"""

    bl_idname = "gscore.join_splats"
    bl_label = "Join Splats"

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The points of the active object, and the others, which go."""
        return (*super().changes(context), *_others(context))

    def edit(self, context: bpy.types.Context, held: Held) -> Pieces[str]:
        """Join."""
        ob, others = held.there(), _others(context)
        parts.check_joinable(ob, others)  # before the selection changes
        make_active(context, ob)  # before: 4.2 crashes where selected objects have just gone
        helds = [Held(other) for other in others]
        try:
            ob = yield from parts.joined(held, helds)
        finally:
            for other in helds:
                other.close()
        return f"{ob.name} has {len(ob.data.vertices):,} splats."


class ApplyFilters(Editing, bpy.types.Operator):
    """Delete the splats that the display filters hide, then reset the filters"""

    bl_idname = "gscore.apply_filters"
    bl_label = "Delete Hidden Splats"
    leaves_edit_mode = False

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """Its points, and its filters."""
        ob = objects.meant(context)
        return ob.data, ob

    def edit(self, context: bpy.types.Context, held: Held) -> Pieces[str]:
        """Delete."""
        count = yield from edit.apply_filters(held)
        return f"Deleted {count:,} splats, {len(held.found().data.vertices):,} left."


class ApplySplatTransform(Editing, bpy.types.Operator):
    """Apply location, rotation and even scale to the splats, with their orientations and colors"""

    bl_idname = "gscore.apply_splat_transform"
    bl_label = "Apply Splat Transform"
    leaves_edit_mode = False

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """Its points, and where it stands."""
        ob = objects.meant(context)
        return ob.data, ob

    def edit(self, context: bpy.types.Context, held: Held) -> Pieces[str]:
        """Apply."""
        yield from edit.apply_transform(held)
        return ""


CLASSES = (
    SelectSplats,
    SelectByColor,
    SelectByOpacity,
    SelectBySize,
    SelectInCrop,
    SelectFlood,
    SelectFloaters,
    GradeSplats,
    SeparateSplats,
    JoinSplats,
    ApplyFilters,
    ApplySplatTransform,
)
