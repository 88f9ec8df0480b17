"""Operators on splats: filters, crop, scale, display, and native splats of Blender (5.3),
converted to splat objects.
"""

from collections.abc import Iterable
from functools import partial

import bpy
import numpy as np
from mathutils import Vector

from .. import attributes, compat
from ..core import transform_splats
from ..interface import editable_check
from ..interface.base_operator import Condition, Undoable, make_active
from ..interface.blocks import block_of
from ..interface.incremental_operator import IncrementalOperator
from ..process.incremental_tasks import Check, Steps, run_in_thread
from . import edit, objects, settings
from .mesh_buffers import Points
from .objects import active_splats, has_splats, is_native
from .read_chunked import read_chunked
from .write_chunked import ChunkedWrite, filled


class OnSplats(Undoable):
    """Base of operators on the active splat object, or on the one that the active object crops; by
    default they change its settings."""

    needs = Condition(has_splats, "Select a splat object: import a splat PLY or train one")

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The object."""
        return (active_splats(context),)


class ResetFilters(OnSplats, bpy.types.Operator):
    """Show all splats again"""

    bl_idname = "gscore.reset_filters"
    bl_label = "Reset Filters"

    def run(self, context: bpy.types.Context) -> None:
        """Reset."""
        settings.reset_filters(active_splats(context))


class AddCropBox(OnSplats, bpy.types.Operator):
    """Add a wire box around most splats and show only splats inside; move or scale the box"""

    bl_idname = "gscore.add_crop_box"
    bl_label = "Add Crop Box"

    def run(self, context: bpy.types.Context) -> None:
        """Add."""
        make_active(context, edit.add_crop_box(context, active_splats(context)))


class MakeScaleEven(OnSplats, bpy.types.Operator):
    """Make the scale of the object and its parents uniform, keeping the volume, because splats
    cannot be stretched"""

    bl_idname = "gscore.make_scale_even"
    bl_label = "Make Scale Even"

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The objects with a changed scale."""
        return uneven(active_splats(context))

    def run(self, context: bpy.types.Context) -> str:
        """Change the scales."""
        changed = make_even(context, active_splats(context))
        if changed:
            return f"Made the scale uniform: {', '.join(changed)}."
        return "The scale is uniform already."


class ResetDisplay(IncrementalOperator, OnSplats, bpy.types.Operator):
    """Add the display modifier again after it was removed, or update it"""

    bl_idname = "gscore.reset_display"
    bl_label = "Restore Display"

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Build the display if the file has none, then attach it."""
        ob = active_splats(context)
        name, uid = ob.name, ob.session_uid
        yield from settings.building()
        gone = f"{name} was removed; its display was not restored."
        settings.attach(block_of(bpy.data.objects, uid, gone))
        return ""


class TakeNativeSplats(IncrementalOperator, bpy.types.Operator):
    """Convert a copy of Blender's own Gaussian splats to a splat object for filters, tools and
    training; the original is hidden"""

    bl_idname = "gscore.take_native_splats"
    bl_label = "Make Splat Object"
    needs = Condition(
        lambda context: is_native(context.object),
        "Select Gaussian splats that Blender imported (5.3 or later)",
    )

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The scene, and the cloud, which gets hidden."""
        return (context.scene, context.object)

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Convert the splats."""
        made = yield from taking(context.object)
        if context.mode == "OBJECT" and made.name in context.view_layer.objects:
            make_active(context, made)
        return f"{made.name} has {len(made.data.vertices):,} splats."


def taking(cloud: bpy.types.Object) -> Steps[bpy.types.Object]:
    """Create a splat object at a point cloud's location; the cloud is kept and hidden.

    Raises:
        ValueError: attributes are missing, the cloud was removed meanwhile, or values are not
            finite; nothing is left then.
    """
    name, uid = cloud.name, cloud.session_uid
    columns = yield from read_chunked(cloud)
    size = yield from run_in_thread(partial(_size, columns), f"Measuring {name}")
    yield from settings.building()
    gone = f"{name} was removed; its splats were not converted."
    found = partial(block_of, bpy.data.objects, uid, gone)
    [mesh] = yield from filled([ChunkedWrite(_points(columns))], found)
    return _place(mesh, size, found())


def _size(columns: dict[str, np.ndarray], check: Check) -> float:
    """`attributes.typical_size` of attributes."""
    sizes = columns[attributes.SCALE].max(axis=1, initial=0.0)
    return float(np.median(sizes)) if len(sizes) else 0.0


def _place(mesh: bpy.types.Mesh, size: float, cloud: bpy.types.Object) -> bpy.types.Object:
    mesh.name = f"{cloud.name} splats"
    collection = editable_check.taking(cloud.users_collection)[0]
    made = objects.around(mesh, size, collection=collection, parent=cloud.parent)
    made.matrix_parent_inverse = cloud.matrix_parent_inverse
    made.matrix_basis = cloud.matrix_basis
    cloud.hide_render = True
    for scene in bpy.data.scenes:
        objects.hide(cloud, scene)
    return made


def _points(columns: dict[str, np.ndarray]) -> Points:
    flat = tuple((n, attributes.kind_of(n), values.ravel()) for n, values in columns.items())
    return Points(count=len(columns[attributes.BASE]), columns=flat)


def is_even(ob: bpy.types.Object) -> bool:
    """True if an object's matrix is a similarity, which splats can represent."""
    try:
        transform_splats(attributes.NO_SPLATS, compat.matrix_to_numpy(ob.matrix_world))
    except ValueError:
        return False
    return True


def make_even(context: bpy.types.Context, ob: bpy.types.Object) -> list[str]:
    """Make the scales of an object and its parents uniform.

    The volume stays, a volume of 0 becomes 1, and reflections stay.

    Returns:
        The names of the changed objects.

    Raises:
        ValueError: the object would still be uneven; nothing is changed then.
    """
    before = {one: _scales(one) for one in uneven(ob)}
    for one in before:
        one.scale, one.delta_scale = _even(one.scale), _even(one.delta_scale)
    context.view_layer.update()
    if not is_even(ob):
        for one, (scale, delta) in before.items():
            one.scale, one.delta_scale = scale, delta
        context.view_layer.update()
        raise ValueError(
            f"{ob.name} is not stretched by its scale or its parents' alone: clear its parent "
            "(Alt P, Clear Parent Inverse), its constraints or its drivers."
        )
    return [one.name for one in before]


def uneven(ob: bpy.types.Object) -> list[bpy.types.Object]:
    """The object and its parents whose scale is not uniform; empty if the object's matrix is a
    similarity."""
    if is_even(ob):
        return []
    chain = objects.chain(ob)
    return [one for one in chain if _scales(one) != (_even(one.scale), _even(one.delta_scale))]


def _scales(ob: bpy.types.Object) -> tuple[tuple[float, ...], tuple[float, ...]]:
    return ob.scale[:], ob.delta_scale[:]


def _even(scale: Vector) -> tuple[float, float, float]:
    sides = np.array(scale, np.float64)
    if np.ptp(np.abs(sides)) <= 1e-6 * np.abs(sides).max():
        return tuple(scale)
    side = np.cbrt(np.abs(sides).prod()) or 1.0
    return tuple(np.where(sides < 0, -side, side))


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
