"""Selection operators of splats: by similarity, opacity, size, location and connectivity."""

from collections.abc import Callable
from typing import ClassVar

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, FloatVectorProperty, IntProperty

from .. import attributes
from ..core import Splats, cluster_sizes, in_unit_shape, reached_from, sh0_to_rgb
from ..process.incremental_tasks import Steps, run_in_thread
from . import filters
from .edit_guard import EditGuard
from .edit_operators import Editing
from .operators import check_shown, edit_vertices
from .read_chunked import read_chunked

_BLOCK = 1 << 14
"""Splats per block, so that intermediate results stay in the cache."""
SET, ADD, TAKE, COMMON = "SET", "ADD", "TAKE", "COMMON"


def combined(before: np.ndarray, mask: np.ndarray, mode: str) -> np.ndarray:
    """[N] bool: a selection [N] combined with a new mask [N].

    Args:
        before: Previous selection.
        mask: New mask.
        mode: SET: the mask alone; ADD: union; TAKE: difference; COMMON: intersection.
    """
    if mode == ADD:
        return before | mask
    if mode == TAKE:
        return before & ~mask
    return before & mask if mode == COMMON else mask


def between(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """[N] bool: values [N] between two inclusive limits; `high` 0: no limit."""
    keep = values >= np.float32(low)
    return keep & (values <= np.float32(high)) if high > 0 else keep


def similar_color(base: np.ndarray, color: np.ndarray, tolerance: float) -> np.ndarray:
    """[N] bool: splats with a colour near the given one.

    Args:
        base: [N, 4] of `radiance:base`.
        color: [3] sRGB values.
        tolerance: Largest distance in sRGB values; black and white are sqrt(3) apart.
    """
    similar, color = np.empty(len(base), bool), np.asarray(color, np.float32)
    for at in range(0, len(base), _BLOCK):
        part = slice(at, at + _BLOCK)
        x, y, z = (colors(base[part]) - color).T
        similar[part] = x * x + y * y + z * z <= np.float32(tolerance) ** 2
    return similar


def colors(base: np.ndarray) -> np.ndarray:
    """[N, 3] float32 sRGB values of `radiance:base` [N, 4], without the view-dependent part."""
    return np.maximum(sh0_to_rgb(base[:, :3]), 0).astype(np.float32)


def flooded(
    means: np.ndarray, base: np.ndarray, seeds: np.ndarray, gap: float, tolerance: float
) -> np.ndarray:
    """[N] bool: splats connected to the seeds, with similar colours.

    Args:
        means: [N, 3].
        base: [N, 4] of `radiance:base`.
        seeds: [N] bool, included in the result.
        gap: Side of the cells of `gscore.edit.reached_from`, units of `means`.
        tolerance: As `similar_color`, from the seeds' mean colour; 0: any colour.
    """
    if tolerance <= 0 or not seeds.any():
        return reached_from(means, seeds, gap)
    allowed = similar_color(base, colors(base[seeds]).mean(axis=0), tolerance) | seeds
    reached = np.zeros(len(means), bool)
    reached[allowed] = reached_from(means[allowed], seeds[allowed], gap)
    return reached


def floaters(splats: Splats, gap: float, few: int) -> np.ndarray:
    """[N] bool: splats in clusters of fewer than `few` splats; `gap` as a share of the model's size
    (`gscore.edit.cluster_sizes`)."""
    return cluster_sizes(splats, gap) < few


_MODES = [
    (SET, "Set", "Select only the matching splats"),
    (ADD, "Extend", "Add the matching splats to the selection"),
    (TAKE, "Subtract", "Deselect the matching splats"),
    (COMMON, "Intersect", "Keep only matching splats selected"),
]


Find = Callable[[dict[str, np.ndarray]], np.ndarray]
"""Selection mask [N] bool from copies of attributes; runs in a thread."""


class _Choosing(Editing):
    """Base of operators that select vertices and enter Edit Mode to show them."""

    reads: ClassVar[tuple[str, ...]]
    """Attributes that the mask needs."""

    @property
    def how(self) -> str:
        """Mode of `combined`."""
        return SET

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Select."""
        ob = guard.there()
        check_shown(ob)  # before the selection changes
        before = attributes.selected(ob.data)
        find, how = self.find(ob, before), self.how
        columns = yield from read_chunked(ob, self.reads)
        chosen = yield from run_in_thread(
            lambda check: combined(before, find(columns), how), self.bl_label
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
            target = colors(base[before]).mean(axis=0) if color is None else color
            return similar_color(base, target, tolerance)

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

        def passes(columns: dict[str, np.ndarray]) -> np.ndarray:
            opacities = columns[attributes.BASE][:, 3]
            return (opacities >= low) & (opacities <= high)

        return passes


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

        return lambda columns: between(
            columns[attributes.SCALE].max(axis=1, initial=0.0), low, high
        )


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

        def connected(columns: dict[str, np.ndarray]) -> np.ndarray:
            means, base = columns[attributes.POSITION], columns[attributes.BASE]
            return flooded(means, base, before, gap, tolerance)

        return connected


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
        return lambda columns: floaters(attributes.as_splats(columns), gap, few)
