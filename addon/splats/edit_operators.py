"""Operators that select, grade, separate and join splats, in Object and in Edit Mode, with undo."""

from collections.abc import Iterable

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, FloatVectorProperty, IntProperty

from .. import attributes
from ..core import in_unit_shape
from ..interface.operators import make_active
from . import choose, filters, grading, objects, parts
from .operators import OnSplats, check_shown, edit_vertices

_MODES = [
    (choose.SET, "New", "Select what is found, and nothing else"),
    (choose.ADD, "Add", "Add what is found to the selection"),
    (choose.TAKE, "Subtract", "Deselect what is found"),
    (choose.COMMON, "Intersect", "Keep selected what is found"),
]


class Editing(OnSplats):
    """Works on the mesh outside of Edit Mode, and goes back to it."""

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The points."""
        return (objects.meant(context).data,)

    def act(self, context: bpy.types.Context) -> str:
        """Leave Edit Mode, edit, and enter it again."""
        ob = objects.meant(context)
        objects.catch_up(ob)
        edited = ob.mode == "EDIT"
        if edited:
            bpy.ops.object.mode_set(mode="OBJECT")
        try:
            objects.check_writable(ob)
            return self.edit(context, ob)
        finally:
            if edited and ob.mode != "EDIT":
                edit_vertices(context, ob)

    def edit(self, context: bpy.types.Context, ob: bpy.types.Object) -> str:
        """Do it; ValueError where it cannot be done."""
        raise NotImplementedError


class _Selecting(Editing):
    """Selects vertices and enters Edit Mode, where they are seen."""

    mode: EnumProperty(name="Mode", description="What becomes of the selection", items=_MODES)

    def edit(self, context: bpy.types.Context, ob: bpy.types.Object) -> str:
        """Select."""
        check_shown(ob)  # before the selection changes
        before = attributes.selected(ob.data)
        chosen = choose.combined(before, self.found(ob, before), self.mode)
        attributes.select(ob.data, chosen)
        ob.data.update()
        edit_vertices(context, ob)
        return f"{int(chosen.sum()):,} splats are selected."

    def found(self, ob: bpy.types.Object, before: np.ndarray) -> np.ndarray:
        """[N] bool: which are meant; `before` [N] are selected."""
        raise NotImplementedError


def _base(ob: bpy.types.Object) -> np.ndarray:
    return attributes.column(ob.data, attributes.BASE)


def _means(ob: bpy.types.Object) -> np.ndarray:
    return attributes.column(ob.data, attributes.POSITION)


def _need_seeds(before: np.ndarray) -> None:
    if not before.any():
        raise ValueError("Select a splat to begin with, in Edit Mode.")


class SelectByColor(_Selecting, bpy.types.Operator):
    """Select splats that have the color of the selected ones, or one that is chosen"""

    bl_idname = "gscore.select_by_color"
    bl_label = "Select by Color"

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

    def found(self, ob: bpy.types.Object, before: np.ndarray) -> np.ndarray:
        """By distance in sRGB values."""
        base = _base(ob)
        if not self.picked:
            _need_seeds(before)
            return choose.alike(base, choose.colors(base[before]).mean(axis=0), self.tolerance)
        return choose.alike(base, np.array(self.color), self.tolerance)


class SelectByOpacity(_Selecting, bpy.types.Operator):
    """Select splats by their opacity"""

    bl_idname = "gscore.select_by_opacity"
    bl_label = "Select by Opacity"

    low: FloatProperty(name="From", description="Smallest opacity", min=0.0, max=1.0)
    high: FloatProperty(name="To", description="Largest opacity", min=0.0, max=1.0, default=0.1)

    def found(self, ob: bpy.types.Object, before: np.ndarray) -> np.ndarray:
        """Both ends belong to it."""
        opacities = _base(ob)[:, 3]
        return (opacities >= np.float32(self.low)) & (opacities <= np.float32(self.high))


class SelectBySize(_Selecting, bpy.types.Operator):
    """Select splats by their largest standard deviation"""

    bl_idname = "gscore.select_by_size"
    bl_label = "Select by Size"

    low: FloatProperty(
        name="From", description="Smallest size, before the object's scale", min=0.0, precision=5
    )
    high: FloatProperty(name="To", description="Largest size; 0 for no limit", min=0.0, precision=5)

    def found(self, ob: bpy.types.Object, before: np.ndarray) -> np.ndarray:
        """Both ends belong to it."""
        sizes = attributes.column(ob.data, attributes.SCALE).max(axis=1, initial=0.0)
        return choose.between(sizes, self.low, self.high)


class SelectInCrop(_Selecting, bpy.types.Operator):
    """Select splats whose center lies in the crop object: its box, or the ellipsoid in it"""

    bl_idname = "gscore.select_in_crop"
    bl_label = "Select in Crop"

    def found(self, ob: bpy.types.Object, before: np.ndarray) -> np.ndarray:
        """As the filters, without their other limits."""
        if not filters.is_cropped(ob):
            raise ValueError(f"{ob.name} has no crop object: use Add Crop Box under Filters.")
        matrix = filters.crop_matrix(ob, ob.gscore.crop_object)
        sphere = ob.gscore.crop_shape == filters.SPHERE
        return in_unit_shape(_means(ob), matrix, sphere=sphere)


class SelectFlood(_Selecting, bpy.types.Operator):
    """Select what hangs together with the selected splats, without a gap"""

    bl_idname = "gscore.select_flood"
    bl_label = "Flood Select"

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

    def found(self, ob: bpy.types.Object, before: np.ndarray) -> np.ndarray:
        """From the selected ones on."""
        _need_seeds(before)
        return choose.flooded(_means(ob), _base(ob), before, self.gap, self.tolerance)


class SelectFloaters(_Selecting, bpy.types.Operator):
    """Select splats that hang together with few others: floaters, and small clusters"""

    bl_idname = "gscore.select_floaters"
    bl_label = "Select Floaters"

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

    def found(self, ob: bpy.types.Object, before: np.ndarray) -> np.ndarray:
        """As `gscore convert --min-cluster`."""
        return choose.floaters(attributes.read(ob.data, rest=False), self.gap, self.few)


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

    def edit(self, context: bpy.types.Context, ob: bpy.types.Object) -> str:
        """Grade."""
        base = _base(ob)
        chosen = attributes.selected(ob.data) if self.only_selected else slice(None)
        grade = grading.Grade(
            lift=tuple(self.lift),
            gamma=tuple(self.gamma),
            gain=tuple(self.gain),
            saturation=self.saturation,
        )
        graded = grading.graded(base[chosen], grade)
        base[chosen] = graded
        kind = ob.data.attributes[attributes.BASE].data_type
        attributes.fill(ob.data, attributes.BASE, kind, base.ravel())
        ob.data.update()
        return f"{len(graded):,} splats graded."


class SeparateSplats(Editing, bpy.types.Operator):
    """Move the selected splats into an object of their own, with all that they carry"""

    bl_idname = "gscore.separate_splats"
    bl_label = "Separate Splats"

    def edit(self, context: bpy.types.Context, ob: bpy.types.Object) -> str:
        """Separate."""
        made = parts.separate(ob, attributes.selected(ob.data))
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

    def edit(self, context: bpy.types.Context, ob: bpy.types.Object) -> str:
        """Join."""
        others = _others(context)
        context.view_layer.update()
        parts.check_joinable(ob, others)  # before the selection changes
        make_active(context, ob)  # before: 4.2 crashes where selected objects have just gone
        parts.join(ob, others)
        return f"{ob.name} has {len(ob.data.vertices):,} splats."


CLASSES = (
    SelectByColor,
    SelectByOpacity,
    SelectBySize,
    SelectInCrop,
    SelectFlood,
    SelectFloaters,
    GradeSplats,
    SeparateSplats,
    JoinSplats,
)
