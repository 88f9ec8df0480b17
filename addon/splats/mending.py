"""Shapes and colors of splats brought after their places, and stretching taken back: see `lag`."""

from functools import partial

import bpy
import numpy as np
from mathutils import Matrix

from .. import attributes
from ..interface import editable_check
from ..process.incremental_tasks import Check, Pieces, run_in_thread
from . import lag, objects, point_attributes, separate_join
from .edit_guard import EditGuard, all_to_change
from .fitted import is_similarity
from .mesh_buffers import Points, points_of
from .point_attributes import Column
from .read_chunked import ChunkedRead
from .rotation import turned
from .write_chunked import ChunkedWrite, filled, swap

APPLIED = (
    "The places of the splats of {} were turned or scaled alone, as Apply of Blender does: their "
    "shapes and colors are as before."
)
JOINED = (
    "Join of Blender turned or scaled the places of what {} took in, but not its shapes and colors."
)
STRETCHED = (
    "The places of splats of {} were stretched by Apply or Join of Blender, and splats cannot be: "
    "their shapes are as before."
)


def problem(ob: bpy.types.Object) -> str:
    """What lags behind in a splat object, a sentence with `{}` for its name; empty where nothing
    does. Quick enough for drawing a panel."""
    if not lag.is_behind(ob.data):
        return ""
    lags = lag.of(ob.data)
    if not all(map(is_similarity, lags)):
        return STRETCHED
    return JOINED if len(lags) > 1 else APPLIED


def behind(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The splat objects in which something lags: the one that is worked on, and those selected."""
    obs = dict.fromkeys([objects.meant(context), *context.selected_objects])
    return [ob for ob in obs if objects.is_splats(ob) and lag.is_behind(ob.data)]


class Mend:
    """What lags in one object, put right: prepared bit by bit, then done at once."""

    def __init__(self, held: EditGuard) -> None:
        """Find out what there is to do.

        Raises:
            ValueError: what happened cannot be undone so.
        """
        ob = held.there()
        self._held, self._lags, self._numbers = held, lag.of(ob.data), lag.parts(ob.data)
        self._there = np.flatnonzero(np.bincount(self._numbers, minlength=1))
        self._odd = [int(k) for k in self._there if not is_similarity(self._lags[k])]
        for k in self._odd:
            for user in _users(ob):
                editable_check.check(user)
                _with_lag(user, self._lags[k])
        # One part stays where it is; others become objects of their own.
        every = self._odd and len(self._odd) == len(self._there)
        self._own = self._odd[0] if every else None
        self._apart = [k for k in self._odd if k != self._own]
        if self._apart:
            held.check_points_alone()
        else:
            held.check_movable()

    def filling(self) -> "Pieces[list[ChunkedWrite[Points]]]":
        """Look what its meshes will be: its own, then those of parts that leave it.

        Raises:
            ValueError: attributes are missing or not finite.
        """
        table = yield from ChunkedRead(self._held.there()).table(whole=bool(self._apart))
        own, *others = yield from run_in_thread(
            partial(self._mended, table), f"Turning splats of {self._held.name}"
        )
        make = self._held.emptied_mesh if self._apart else self._held.copied_mesh
        emptied = self._held.emptied_mesh
        return [ChunkedWrite(own, make), *(ChunkedWrite(other, emptied) for other in others)]

    def _mended(self, table: list[Column], check: Check) -> list[Points]:
        for name, values in point_attributes.of_splats(table).items():
            attributes.check_finite(values, name, self._held.name)
        check()
        numbers, changed = self._numbers, []
        if len(self._odd) < len(self._there):
            turning = np.where(np.isin(numbers, self._odd), -1, numbers)
            changed = turned(table, self._lags, turning)
        places = next(c for c in table if c.name == attributes.POSITION)
        for k in self._odd:
            check()
            rows = np.flatnonzero(numbers == k)
            back = np.linalg.inv(self._lags[k])
            places.values[rows] = (places.values[rows].astype(np.float64) @ back.T).astype(
                np.float32
            )
        if self._odd:
            changed.append(places)
        if not self._apart:
            return [points_of(changed)]
        stays = np.flatnonzero(~np.isin(numbers, self._apart))
        rows = [stays, *(np.flatnonzero(numbers == k) for k in self._apart)]
        return [points_of(point_attributes.picked(table, some)) for some in rows]

    def finish(self, meshes: list[bpy.types.Mesh]) -> list[bpy.types.Object]:
        """Put what `filling` made, filled, in its place; the objects that are stretched now."""
        ob, (own, *others) = self._held.there(), meshes
        for mesh in meshes:
            lag.forget(mesh)
        swap(ob, own)
        taken = [] if self._own is None else [ob]
        for user in _users(ob) if taken else ():
            _take_back(user, self._lags[self._own])
        for k, mesh in zip(self._apart, others, strict=True):
            taken.append(separate_join.split_off(ob, mesh))
            _take_back(taken[-1], self._lags[k])
        for mesh in meshes:
            lag.follow(mesh)
        return taken


def mended(helds: list[EditGuard]) -> Pieces[list[bpy.types.Object]]:
    """Turn and scale shapes and colors of objects along with the places that are there.

    What was stretched gets the places of before instead, and its object that matrix; a part that
    was joined becomes an object of its own for that.

    Returns:
        The objects that are stretched now, as before Apply or Join.

    Raises:
        ValueError: a mesh cannot be written, or what happened cannot be undone so; nothing is
            changed then.
    """
    mends = [Mend(held) for held in helds]
    fillings = []
    for mend in mends:
        fillings.append((yield from mend.filling()))
    meshes = yield from filled(
        [one for some in fillings for one in some], partial(all_to_change, helds)
    )
    taken, left = [], iter(meshes)
    for mend, some in zip(mends, fillings, strict=True):
        taken += mend.finish([next(left) for _ in some])
    return taken


def _users(ob: bpy.types.Object) -> list[bpy.types.Object]:
    """All objects that show an object's mesh."""
    return [one for one in bpy.data.objects if one.data == ob.data]


def _with_lag(ob: bpy.types.Object, turn: np.ndarray) -> Matrix:
    """The matrix that an object gets when its splats give a lag back to it.

    Raises:
        ValueError: there is none: something was scaled to nothing, or sheared.
    """
    if abs(np.linalg.det(turn)) > 1e-12:
        wanted = ob.matrix_basis @ _matrix(turn)
        made = Matrix.LocRotScale(*wanted.decompose())
        if np.allclose(made, wanted, rtol=0, atol=1e-5 * np.abs(np.array(wanted)[:3, :3]).max()):
            return made
    raise ValueError(
        f"{ob.name} was stretched in a way that no object can be: undo the Apply or Join (Ctrl Z)."
    )


def _take_back(ob: bpy.types.Object, turn: np.ndarray) -> None:
    """Give an object, whose splats have the places of before again, the lag as its own; what hangs
    from it stays."""
    back = np.linalg.inv(turn)
    for child in ob.children:
        child.matrix_parent_inverse = _matrix(back) @ child.matrix_parent_inverse
    ob.matrix_basis = _with_lag(ob, turn)


def _matrix(turn: np.ndarray) -> Matrix:
    return Matrix(turn.tolist()).to_4x4()
