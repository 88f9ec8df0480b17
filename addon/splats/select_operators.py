"""Selection operators of splats: by similarity, opacity, size, location and connectivity."""

from collections.abc import Callable
from typing import ClassVar

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, FloatVectorProperty, IntProperty

from .. import attributes
from ..core import in_unit_shape
from ..process.incremental_tasks import Pieces, run_in_thread
from . import filters, selection_masks
from .edit_guard import EditGuard
from .edit_operators import Editing
from .operators import check_shown, edit_vertices
from .read_chunked import read_chunked

_MODES = [
    (selection_masks.SET, "Set", "Select only the matching splats"),
    (selection_masks.ADD, "Extend", "Add the matching splats to the selection"),
    (selection_masks.TAKE, "Subtract", "Deselect the matching splats"),
    (selection_masks.COMMON, "Intersect", "Keep only matching splats selected"),
]


Find = Callable[[dict[str, np.ndarray]], np.ndarray]
"""Selection mask [N] bool from copies of attributes; runs in a thread."""


class _Choosing(Editing):
    """Base of operators that select vertices and enter Edit Mode to show them."""

    reads: ClassVar[tuple[str, ...]]
    """Attributes that the mask needs."""

    @property
    def how(self) -> str:
        """Mode of `selection_masks.combined`."""
        return selection_masks.SET

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Pieces[str]:
        """Select."""
        ob = guard.there()
        check_shown(ob)  # before the selection changes
        before = attributes.selected(ob.data)
        find, how = self.find(ob, before), self.how
        columns = yield from read_chunked(ob, self.reads)
        chosen = yield from run_in_thread(
            lambda check: selection_masks.combined(before, find(columns), how), self.bl_label
        )
        ob = guard.to_change()
        check_shown(ob)
        attributes.select(ob.data, chosen)
        ob.data.update()
        edit_vertices(context, ob)
        return f"Selected splats: {int(chosen.sum()):,}."

    def find(self, ob: bpy.types.Object, before: np.ndarray) -> Find:
        """The mask function; `before` [N] are selected. ValueError as `edit`."""
        raise NotImplementedError


class _Selecting(_Choosing):
    """Base of operators that extend or subtract from the selection."""

    mode: EnumProperty(name="Mode", description="Change of the selection", items=_MODES)

    @property
    def how(self) -> str:
        """Mode of the property."""
        return self.mode


class SelectSplats(_Choosing, bpy.types.Operator):
    """Select splats that the display filters hide or show, in Edit Mode"""

    bl_idname = "gscore.select_splats"
    bl_label = "Select Splats"
    reads = filters.ATTRIBUTES

    which: EnumProperty(
        name="Which",
        description="Splats to select; all others are deselected",
        items=[
            ("HIDDEN", "Hidden", "Splats that the filters hide"),
            ("VISIBLE", "Visible", "Splats that the filters show"),
        ],
    )

    def find(self, ob: bpy.types.Object, before: np.ndarray) -> Find:
        """Mask of the filters."""
        limits, hidden = filters.filters_of(ob), self.which == "HIDDEN"
        return lambda columns: filters.passing(columns, limits) != hidden


def _need_seeds(before: np.ndarray) -> None:
    if not before.any():
        raise ValueError("Select one or more splats in Edit Mode first.")


class SelectByColor(_Selecting, bpy.types.Operator):
    """Select splats with the color of the selected ones, or with a chosen color"""

    bl_idname = "gscore.select_by_color"
    bl_label = "Select by Color"
    reads = (attributes.BASE,)

    picked: BoolProperty(
        name="Chosen Color",
        description="Compare with the color below instead of the mean of the selected splats",
    )
    color: FloatVectorProperty(
        name="Color",
        description="Color to compare with",
        subtype="COLOR_GAMMA",
        min=0.0,
        max=1.0,
        default=(0.5, 0.5, 0.5),
    )
    tolerance: FloatProperty(
        name="Tolerance",
        description="Largest distance between colors; black and white are 1.73 apart",
        default=0.15,
        min=0.0,
        max=1.74,
    )

    def find(self, ob: bpy.types.Object, before: np.ndarray) -> Find:
        """Mask by distance in sRGB values."""
        color, tolerance = np.array(self.color) if self.picked else None, self.tolerance
        if color is None:
            _need_seeds(before)

        def similar(columns: dict[str, np.ndarray]) -> np.ndarray:
            base = columns[attributes.BASE]
            target = selection_masks.colors(base[before]).mean(axis=0) if color is None else color
            return selection_masks.similar_color(base, target, tolerance)

        return similar


class SelectByOpacity(_Selecting, bpy.types.Operator):
    """Select splats by their opacity"""

    bl_idname = "gscore.select_by_opacity"
    bl_label = "Select by Opacity"
    reads = (attributes.BASE,)

    low: FloatProperty(name="From", description="Smallest opacity", min=0.0, max=1.0)
    high: FloatProperty(name="To", description="Largest opacity", min=0.0, max=1.0, default=0.1)

    def find(self, ob: bpy.types.Object, before: np.ndarray) -> Find:
        """Mask by inclusive limits."""
        low, high = np.float32(self.low), np.float32(self.high)

        def between(columns: dict[str, np.ndarray]) -> np.ndarray:
            opacities = columns[attributes.BASE][:, 3]
            return (opacities >= low) & (opacities <= high)

        return between


class SelectBySize(_Selecting, bpy.types.Operator):
    """Select splats by their size, the largest standard deviation"""

    bl_idname = "gscore.select_by_size"
    bl_label = "Select by Size"
    reads = (attributes.SCALE,)

    low: FloatProperty(
        name="From", description="Smallest size, before the object's scale", min=0.0, precision=5
    )
    high: FloatProperty(name="To", description="Largest size; 0 for no limit", min=0.0, precision=5)

    def find(self, ob: bpy.types.Object, before: np.ndarray) -> Find:
        """Mask by inclusive limits."""
        low, high = self.low, self.high

        def between(columns: dict[str, np.ndarray]) -> np.ndarray:
            return selection_masks.between(
                columns[attributes.SCALE].max(axis=1, initial=0.0), low, high
            )

        return between


class SelectInCrop(_Selecting, bpy.types.Operator):
    """Select splats whose center is inside the crop object: its box, or the ellipsoid in it"""

    bl_idname = "gscore.select_in_crop"
    bl_label = "Select in Crop"
    reads = (attributes.POSITION,)

    def find(self, ob: bpy.types.Object, before: np.ndarray) -> Find:
        """Mask of the crop, without the other filters."""
        if not filters.is_cropped(ob):
            raise ValueError(f"{ob.name} has no crop object: use Add Crop Box under Filters.")
        matrix = filters.crop_matrix(ob, ob.gscore.crop_object)
        sphere = ob.gscore.crop_shape == filters.SPHERE
        return lambda columns: in_unit_shape(columns[attributes.POSITION], matrix, sphere=sphere)


class SelectFlood(_Selecting, bpy.types.Operator):
    """Select splats connected to the selected ones without a gap"""

    bl_idname = "gscore.select_flood"
    bl_label = "Flood Select"
    reads = (attributes.POSITION, attributes.BASE)

    gap: FloatProperty(
        name="Gap",
        description="Cell size, before the object's scale; splats in touching cells are connected",
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
        """Mask of splats connected to the selected ones."""
        _need_seeds(before)
        gap, tolerance = self.gap, self.tolerance

        def flooded(columns: dict[str, np.ndarray]) -> np.ndarray:
            means, base = columns[attributes.POSITION], columns[attributes.BASE]
            return selection_masks.flooded(means, base, before, gap, tolerance)

        return flooded


class SelectFloaters(_Selecting, bpy.types.Operator):
    """Select splats in small, isolated clusters"""

    bl_idname = "gscore.select_floaters"
    bl_label = "Select Floaters"
    reads = (attributes.BASE, attributes.SCALE, attributes.ROTATION, attributes.POSITION)

    few: IntProperty(
        name="Fewer Than",
        description="Select clusters with fewer splats than this",
        default=100,
        min=2,
    )
    gap: FloatProperty(
        name="Gap",
        description="Cell size as a share of the model's size; splats in touching cells form a "
        "cluster",
        default=0.05,
        min=1e-4,
        max=10.0,
    )

    def find(self, ob: bpy.types.Object, before: np.ndarray) -> Find:
        """Mask as in `gscore convert --min-cluster`."""
        gap, few = self.gap, self.few
        return lambda columns: selection_masks.floaters(attributes.as_splats(columns), gap, few)


CLASSES = (
    SelectSplats,
    SelectByColor,
    SelectByOpacity,
    SelectBySize,
    SelectInCrop,
    SelectFlood,
    SelectFloaters,
)
