"""Separate and join of splat objects, with all point attributes."""

from functools import partial

import bpy
import numpy as np
from mathutils import Matrix

from .. import attributes, compat
from ..interface import editable_check
from ..process.incremental_tasks import Check, Pieces, run_in_thread
from . import lag, objects, point_attributes, settings, vertex_groups
from .edit_guard import EditGuard, all_to_change
from .mesh_buffers import Points, points_of
from .point_attributes import Column
from .read_chunked import ChunkedRead
from .rotation import moved
from .write_chunked import ChunkedWrite, filled, swap


def separated(held: EditGuard, chosen: np.ndarray) -> Pieces[bpy.types.Object]:
    """Move splats into an object of their own, with the same place, display and filters, and all
    that they carry, hidden or not; none is selected then.

    Args:
        held: A splat object.
        chosen: [N] bool.

    Raises:
        ValueError: none or all are chosen, or as `EditGuard.to_change`; nothing is changed then.
    """
    if chosen.all() or not chosen.any():
        many = "all" if len(chosen) and chosen.all() else "none"
        raise ValueError(f"{held.name}: select some splats to separate; {many} of them are.")
    held.check_points_alone()
    table = yield from ChunkedRead(held.there()).table()
    split = yield from run_in_thread(
        partial(_split, table, chosen), f"Separating splats of {held.name}"
    )
    fillings = [ChunkedWrite(one, held.emptied_mesh) for one in split]
    own, other = yield from filled(fillings, held.to_change)
    ob = held.there()
    swap(ob, own)
    return split_off(ob, other)


def _split(table: list[Column], chosen: np.ndarray, check: Check) -> list[Points]:
    kept = point_attributes.without_selection(table)
    found = [
        points_of(point_attributes.picked(kept, np.flatnonzero(mask))) for mask in (~chosen, chosen)
    ]
    kept.clear()
    _let_go(table)
    return found


def _let_go(table: list[Column]) -> None:
    """Free a table in the thread, an attribute at a time: to give so much memory back takes long,
    and Python's lock is kept meanwhile."""
    while table:
        table.pop()


def split_off(ob: bpy.types.Object, mesh: bpy.types.Mesh) -> bpy.types.Object:
    """A copy of an object, for a mesh with some of its splats."""
    other = ob.copy()
    attributes.copy_active(mesh, ob.data)
    with vertex_groups.settings_kept(other):
        other.data = mesh
    other.name = mesh.name = f"{ob.name} part"
    editable_check.link_like(other, ob)
    settings.apply(other)
    return other


def kept(held: EditGuard, table: list[Column], rows: np.ndarray) -> Pieces[bpy.types.Object]:
    """Delete all splats of an object except some, whose attributes stay bit-identical.

    Args:
        held: It.
        table: Of its mesh, as `ChunkedRead.table`; emptied.
        rows: [K], numbers of those that stay.

    Raises:
        ValueError: as `EditGuard.to_change`; nothing is changed then.
    """
    wanted = yield from run_in_thread(partial(_picked, table, rows), "Deleting splats")
    [mesh] = yield from filled([ChunkedWrite(wanted, held.emptied_mesh)], held.to_change)
    ob = held.there()
    swap(ob, mesh)
    return ob


def _picked(table: list[Column], rows: np.ndarray, check: Check) -> Points:
    found = points_of(point_attributes.picked(table, rows))
    _let_go(table)
    return found


def check_joinable(ob: bpy.types.Object, others: list[bpy.types.Object]) -> None:
    """Raise ValueError where some splats cannot be joined: there are no others, Edit Mode, a mesh
    that cannot be written, anti-aliasing of some, or shapes that lag behind places."""
    if not others:
        raise ValueError("Select two or more splat objects; the active one receives the others.")
    parts = [ob, *others]
    for one in parts:
        objects.check_writable(one)
    if len({bool(one.get(objects.ANTIALIAS)) for one in parts}) > 1:
        raise ValueError("Some were trained with anti-aliasing and some without: they stay apart.")
    behind = ", ".join(one.name for one in parts if lag.is_behind(one.data))
    if behind:
        raise ValueError(
            f"Shapes and colors of {behind} lag behind the places: press Turn Shapes and Colors "
            "Along first, under Result."
        )


def joined(held: EditGuard, others: list[EditGuard]) -> Pieces[bpy.types.Object]:
    """Join the splats of other objects into one, as displayed; the others are removed.

    SH degrees are filled up. Attributes that are no splat's follow; where an object has none of
    that name, they are 0. Vertex groups of one name become one. What is hidden stays so; what the
    first has stays to the bit, selected or not. What hangs from the others hangs from it then, and
    stays where it is.

    Raises:
        ValueError: as `check_joinable` or `EditGuard.to_change`, a matrix is no similarity, or one
            is moved meanwhile; nothing is changed then.
    """
    ob, obs = held.there(), [other.there() for other in others]
    check_joinable(ob, obs)
    for one in (held, *others):
        one.check_points_alone()
    world = compat.matrix_to_numpy(ob.matrix_world)
    if not abs(np.linalg.det(world[:3, :3])) > 1e-30:
        raise ValueError(f"{ob.name} is scaled to nothing: set its scale to 1 first.")
    to_own = np.linalg.inv(world)
    matrices = [to_own @ compat.matrix_to_numpy(one.matrix_world) for one in obs]
    for one, matrix in zip(obs, matrices, strict=True):
        objects.moved(attributes.NO_SPLATS, matrix, one.name)  # refuses what cannot be
    tables = []
    for one in (held, *others):
        tables.append((yield from ChunkedRead(one.there()).table()))
    names = [other.name for other in others]
    points = yield from run_in_thread(
        partial(_together, tables, matrices, names), f"Joining splats with {held.name}"
    )

    def check() -> None:
        for one in (held, *others):
            one.check_unmoved()
        all_to_change([held, *others])

    [mesh] = yield from filled([ChunkedWrite(points, held.emptied_mesh)], check)
    lag.forget(mesh)
    ob, *gone = (one.there() for one in (held, *others))
    swap(ob, mesh)  # which is that of those who shared it too
    for one in gone:
        _take_children(ob, one)
        data = one.data
        bpy.data.objects.remove(one)
        if not data.users:
            bpy.data.meshes.remove(data)
    return ob


def _together(
    tables: list[list[Column]], matrices: list[np.ndarray], names: list[str], check: Check
) -> Points:
    """Points of all objects, transformed in place except those of the first."""
    first, *others = tables
    for table, matrix, name in zip(others, matrices, names, strict=True):
        check()
        moved(table, matrix, name, check)
    found = points_of(
        point_attributes.joined([first, *map(point_attributes.without_selection, others)])
    )
    for table in tables:
        _let_go(table)
    return found


def _take_children(ob: bpy.types.Object, one: bpy.types.Object) -> None:
    """Have what hangs from an object that goes hang from another one, or, where that hangs from it
    itself, from what the object hangs from; all stays where it is."""
    above = objects.chain(ob)
    for child in one.children:
        if child.parent_type == "OBJECT":
            parent = one.parent if child in above else ob
            inverse = child.matrix_parent_inverse.copy()
            child.parent = parent
            back = Matrix() if parent is None else parent.matrix_world.inverted_safe()
            child.matrix_parent_inverse = back @ one.matrix_world @ inverse
