"""Separate and join of splat objects, with all point attributes."""

from functools import partial

import bpy
import numpy as np
from mathutils import Matrix

from .. import attributes, compat
from ..interface import editable_check
from ..process.incremental_tasks import Check, Steps, run_in_thread
from . import lag, objects, point_attributes, settings, vertex_groups
from .edit_guard import EditGuard, all_to_change
from .mesh_buffers import Points, points_of
from .point_attributes import Column
from .read_chunked import ChunkedRead
from .rotation import moved
from .write_chunked import ChunkedWrite, filled, swap


def separated(guard: EditGuard, chosen: np.ndarray) -> Steps[bpy.types.Object]:
    """Move splats with all attributes into a new object with the same transform, display and
    filters; deselects all.

    Args:
        guard: A splat object.
        chosen: [N] bool.

    Raises:
        ValueError: none or all are chosen, or as `EditGuard.to_change`; nothing is changed then.
    """
    if chosen.all() or not chosen.any():
        many = "all" if len(chosen) and chosen.all() else "none"
        raise ValueError(f"{guard.name}: select some splats to separate; {many} of them are.")
    guard.check_only_points()
    table = yield from ChunkedRead(guard.there()).table()
    split = yield from run_in_thread(
        partial(_split, table, chosen), f"Separating splats of {guard.name}"
    )
    fillings = [ChunkedWrite(one, guard.emptied_mesh) for one in split]
    own, other = yield from filled(fillings, guard.to_change)
    ob = guard.there()
    swap(ob, own)
    return split_off(ob, other)


def _split(table: list[Column], chosen: np.ndarray, check: Check) -> list[Points]:
    kept = point_attributes.without_selection(table)
    parts = [
        points_of(point_attributes.picked(kept, np.flatnonzero(mask))) for mask in (~chosen, chosen)
    ]
    kept.clear()
    _free(table)
    return parts


def _free(table: list[Column]) -> None:
    """Free a table in the thread, one attribute at a time: freeing takes long and holds Python's
    lock."""
    while table:
        table.pop()


def split_off(ob: bpy.types.Object, mesh: bpy.types.Mesh) -> bpy.types.Object:
    """A copy of an object with another mesh, which has some of its splats."""
    other = ob.copy()
    attributes.copy_active(mesh, ob.data)
    with vertex_groups.settings_kept(other):
        other.data = mesh
    other.name = mesh.name = f"{ob.name} part"
    editable_check.link_like(other, ob)
    settings.apply(other)
    return other


def kept(guard: EditGuard, table: list[Column], rows: np.ndarray) -> Steps[bpy.types.Object]:
    """Delete all splats of an object except some, whose attributes stay bit-identical, or add some.

    Args:
        guard: The object.
        table: Table of its mesh, from `ChunkedRead.table`, possibly with more splats; emptied.
        rows: [K], indices of the splats to keep.

    Raises:
        ValueError: as `EditGuard.to_change`; nothing is changed then.
    """
    adds = len(rows) > len(guard.there().data.vertices)
    name = "Adding splats" if adds else "Deleting splats"
    points = yield from run_in_thread(partial(_picked, table, rows), name)
    [mesh] = yield from filled([ChunkedWrite(points, guard.emptied_mesh)], guard.to_change)
    ob = guard.there()
    if adds and not lag.problem(mesh):
        lag.forget(mesh)  # else it would be taken for a Join
    swap(ob, mesh)
    return ob


def _picked(table: list[Column], rows: np.ndarray, check: Check) -> Points:
    points = points_of(point_attributes.picked(table, rows))
    _free(table)
    return points


def check_follow(obs: list[bpy.types.Object]) -> None:
    """Raise ValueError if the shapes of the splats of any object lag behind their positions."""
    behind = ", ".join(ob.name for ob in obs if lag.problem(ob.data))
    if behind:
        raise ValueError(
            f"Shapes and colors of {behind} do not match the positions: press Update Shapes and "
            "Colors under Result first."
        )


def check_joinable(ob: bpy.types.Object, others: list[bpy.types.Object]) -> None:
    """Raise ValueError if splats cannot be joined: no others, Edit Mode, a read-only mesh,
    different anti-aliasing, or shapes that lag behind positions."""
    if not others:
        raise ValueError("Select two or more splat objects; the active one receives the others.")
    parts = [ob, *others]
    for one in parts:
        objects.check_writable(one)
    if len({bool(one.get(objects.ANTIALIAS)) for one in parts}) > 1:
        raise ValueError("Splats trained with and without anti-aliasing cannot be joined.")
    check_follow(parts)


def joined(guard: EditGuard, others: list[EditGuard]) -> Steps[bpy.types.Object]:
    """Join the splats of other objects into one, as displayed; the others are removed.

    Lower SH degrees are padded with 0, as are other attributes that an object lacks. Vertex groups
    of the same name are merged. Hidden splats stay hidden; the first object's splats stay
    bit-identical with their selection. Children of the others are parented to it and stay in
    place.

    Raises:
        ValueError: as `check_joinable` or `EditGuard.to_change`, a matrix is no similarity, or an
            object was moved meanwhile; nothing is changed then.
    """
    ob, obs = guard.there(), [other.there() for other in others]
    check_joinable(ob, obs)
    for one in (guard, *others):
        one.check_only_points()
    world = compat.matrix_to_numpy(ob.matrix_world)
    if not abs(np.linalg.det(world[:3, :3])) > 1e-30:
        raise ValueError(f"{ob.name} has a scale of 0: set its scale to 1 first.")
    to_own = np.linalg.inv(world)
    places = [compat.matrix_to_numpy(one.matrix_world) for one in obs]
    # Exact for splats in one space.
    matrices = [np.eye(4) if np.array_equal(m, world) else to_own @ m for m in places]
    for one, matrix in zip(obs, matrices, strict=True):
        objects.moved(attributes.NO_SPLATS, matrix, one.name)  # raises unless it is a similarity
    tables = []
    for one in (guard, *others):
        tables.append((yield from ChunkedRead(one.there()).table()))
    names = [other.name for other in others]
    points = yield from run_in_thread(
        partial(_joined_columns, tables, matrices, names), f"Joining splats with {guard.name}"
    )

    def check() -> None:
        for one in (guard, *others):
            one.check_unmoved()
        all_to_change([guard, *others])

    [mesh] = yield from filled([ChunkedWrite(points, guard.emptied_mesh)], check)
    lag.forget(mesh)
    ob, *gone = (one.there() for one in (guard, *others))
    swap(ob, mesh)  # also for other users of the old mesh
    for one in gone:
        _take_children(ob, one)
        data = one.data
        bpy.data.objects.remove(one)
        if not data.users:
            bpy.data.meshes.remove(data)
    return ob


def _joined_columns(
    tables: list[list[Column]], matrices: list[np.ndarray], names: list[str], check: Check
) -> Points:
    """Points of all objects, transformed in place except those of the first."""
    first, *others = tables
    for table, matrix, name in zip(others, matrices, names, strict=True):
        check()
        moved(table, matrix, name, check)
    points = points_of(
        point_attributes.joined([first, *map(point_attributes.without_selection, others)])
    )
    for table in tables:
        _free(table)
    return points


def _take_children(ob: bpy.types.Object, one: bpy.types.Object) -> None:
    """Parent the children of a removed object to another one, or to the removed one's parent if the
    other is below that child; all stay in place."""
    above = objects.chain(ob)
    for child in one.children:
        if child.parent_type == "OBJECT":
            parent = one.parent if child in above else ob
            inverse = child.matrix_parent_inverse.copy()
            child.parent = parent
            back = Matrix() if parent is None else parent.matrix_world.inverted_safe()
            child.matrix_parent_inverse = back @ one.matrix_world @ inverse
