"""Splat edits: count, select, delete hidden splats, crop, apply the transform."""

from dataclasses import dataclass
from functools import partial

import bpy
import numpy as np
from mathutils import Matrix

from .. import attributes, compat
from ..cameras.objects import local_matrix
from ..interface import editable_check
from ..nodes import display
from ..process.incremental_tasks import Steps, run_in_thread
from . import filters, lag, objects, separate_join, splat_framing
from . import settings as splat_settings
from .edit_guard import EditGuard
from .mesh_buffers import points_of
from .read_chunked import ChunkedRead
from .rotation import moved
from .write_chunked import ChunkedWrite, filled, swap

_QUICK = 200_000
"""Largest number of splats filtered within a few milliseconds."""
_CROP_QUANTILE = 0.005
"""Share of the splats beyond each side of a new crop box."""


@dataclass(frozen=True, kw_only=True)
class Stats:
    """Counts of a splat object."""

    total: int
    """Splats in the mesh."""
    visible: int | None
    """Splats that pass the display filters; None if counting them would take long."""
    sh_degree: int
    """0 to 4."""


def stats(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None = None) -> Stats:
    """Counts of a splat object, cheap enough for a panel.

    Args:
        ob: A splat object.
        depsgraph: Evaluated depsgraph, from which Blender since 4.5 returns the number of displayed
            splats. Otherwise the filters are evaluated for up to `_QUICK` splats; without a
            depsgraph for any number.

    Raises:
        ValueError: SH attributes are missing.
    """
    total = len(ob.data.vertices)
    degree = attributes.SH_COUNTS.index(attributes.sh_count(ob.data))
    visible = _shown(ob, depsgraph) if depsgraph else None
    affordable = depsgraph is None or total <= _QUICK
    if visible is None and affordable and ob.mode != "EDIT":
        visible = int(filters.visible_mask(ob).sum())
    return Stats(total=total, visible=visible, sh_degree=degree)


def _shown(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> int | None:
    """Points or instances of the evaluated display, without visiting them; None if unknown."""
    own = ob.gscore
    limits = (own.opacity_min, own.size_min, own.size_max, own.crop_object)
    if not any(limits):
        return len(ob.data.vertices)
    evaluated = ob.evaluated_get(depsgraph)
    modifier = display.modifier_of(ob)
    counts = modifier is not None and modifier.show_viewport and own.display != "SPLATS"
    geometry = compat.evaluated_geometry(evaluated) if counts else None
    if geometry is None:
        return None
    points = geometry.pointcloud or geometry.instances_pointcloud()
    return 0 if points is None else len(points.points)


def apply_filters(guard: EditGuard) -> Steps[int]:
    """Delete splats that the filters hide, and reset the filters.

    Returns:
        Number of deleted splats.

    Raises:
        ValueError: attributes are missing, no splats would be left, or as `EditGuard.to_change`;
            nothing is changed then.
    """
    ob = guard.there()
    guard.check_only_points()
    limits = filters.filters_of(ob)
    table = yield from ChunkedRead(ob).table()
    columns = {column.name: column.values for column in table}
    keep = yield from run_in_thread(
        lambda check: filters.passing(columns, limits), f"Filtering {guard.name}"
    )
    if len(keep) and not keep.any():
        raise ValueError(f"{guard.name}: the filters hide every splat; relax them before applying.")
    if keep.all():
        ob = guard.to_change()
    else:
        ob = yield from separate_join.kept(guard, table, np.flatnonzero(keep))
    splat_settings.reset_filters(ob)
    return int((~keep).sum())


def add_crop_box(context: bpy.types.Context, ob: bpy.types.Object) -> bpy.types.Object:
    """Create a wire box around the bulk of the splats, and use it as the crop object.

    The box is aligned with Blender's world, whatever the splats' rotation, and is their child;
    users can move, rotate and scale it.

    Raises:
        ValueError: Edit Mode, missing attributes or no splats.
    """
    if ob.mode == "EDIT":
        raise ValueError(f"{ob.name} is in Edit Mode: leave it before adding a crop box.")
    placed = splat_framing.in_world(ob)
    if not len(placed):
        raise ValueError(f"{ob.name} has no splats to put a box around.")
    low, high = np.quantile(placed, [_CROP_QUANTILE, 1 - _CROP_QUANTILE], axis=0)
    mesh = bpy.data.meshes.new("Crop")
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    mesh.from_pydata(corners, [], faces)
    box = bpy.data.objects.new("Crop", mesh)
    box.display_type, box.hide_render = "WIRE", True
    box.parent = ob
    box.matrix_parent_inverse = ob.matrix_world.inverted_safe()
    box.location = (low + high) / 2
    box.scale = np.maximum((high - low) / 2, 1e-6)
    editable_check.link_like(box, ob)
    context.view_layer.update()
    ob.gscore.crop_object = box
    return box


def apply_transform(guard: EditGuard) -> Steps[None]:
    """Apply the object's own location, rotation and scale to its splats, exactly; its children,
    such as a crop box, stay in place.

    Blender's own Apply transforms only the positions, not the ellipsoids and colours.

    Raises:
        ValueError: the scale is uneven, other objects share the splats, the object was moved
            meanwhile, or as `EditGuard.to_change`; nothing is changed then.
    """
    ob = guard.there()
    _check_unshared(ob)
    guard.check_movable()
    matrix = local_matrix(ob)
    objects.moved(attributes.NO_SPLATS, matrix, guard.name)  # raises unless it is a similarity
    before = lag.of(ob.data)
    table = yield from ChunkedRead(ob).table(whole=False)
    changed = yield from run_in_thread(
        partial(moved, table, matrix, guard.name), f"Transforming splats of {guard.name}"
    )

    def applicable() -> None:
        _check_unshared(guard.to_change())
        guard.check_unmoved()

    [mesh] = yield from filled([ChunkedWrite(points_of(changed), guard.copied_mesh)], applicable)
    ob = guard.there()
    lag.forget(mesh)
    attributes.leave_points_unselected(mesh)
    swap(ob, mesh)
    if before is not None:  # express it in the new axes
        before = matrix[:3, :3] @ before @ np.linalg.inv(matrix[:3, :3])
    lag.note(mesh, before)
    ob.matrix_parent_inverse = Matrix.Identity(4)
    ob.matrix_basis = Matrix.Identity(4)
    objects.keep_children(ob, Matrix(np.linalg.inv(matrix).tolist()))


def _check_unshared(ob: bpy.types.Object) -> None:
    others = [one.name for one in bpy.data.objects if one.data == ob.data and one != ob]
    if others:
        raise ValueError(
            f"{ob.name} shares its splats with {', '.join(others)}, which would move too: Object > "
            "Relations > Make Single User > Object & Data first."
        )
