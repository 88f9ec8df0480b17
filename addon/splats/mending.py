"""Correction of lags: transforms shapes and colors of splats, or undoes stretching; see `lag`."""

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
    "The positions of the splats of {} were rotated or scaled without their shapes and colors, as "
    "by Blender's Apply."
)
JOINED = (
    "Blender's Join rotated or scaled the positions of splats joined into {}, but not their shapes "
    "and colors."
)
STRETCHED = (
    "The positions of splats of {} were stretched by Blender's Apply or Join, but their shapes "
    "cannot be stretched."
)


def problem(ob: bpy.types.Object) -> str:
    """Sentence about the lags of a splat object, with `{}` for its name; empty without lags. Fast
    enough for drawing a panel."""
    if not lag.is_behind(ob.data):
        return ""
    lags = lag.of(ob.data)
    if not all(map(is_similarity, lags)):
        return STRETCHED
    return JOINED if len(lags) > 1 else APPLIED


def behind(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The splat objects with lags: the one that the user works on, and the selected ones."""
    obs = dict.fromkeys([objects.meant(context), *context.selected_objects])
    return [ob for ob in obs if objects.is_splats(ob) and lag.is_behind(ob.data)]


class Mend:
    """Correction of one object: prepared in steps, then applied in one change."""

    def __init__(self, guard: EditGuard) -> None:
        """Determine the changes.

        Raises:
            ValueError: the lags cannot be corrected.
        """
        ob = guard.there()
        self._guard, self._lags, self._numbers = guard, lag.of(ob.data), lag.parts(ob.data)
        self._there = np.flatnonzero(np.bincount(self._numbers, minlength=1))
        self._odd = [int(k) for k in self._there if not is_similarity(self._lags[k])]
        for k in self._odd:
            for user in _users(ob):
                editable_check.check(user)
                _with_lag(user, self._lags[k])
        # One stretched part may stay in this object; others become new objects.
        every = self._odd and len(self._odd) == len(self._there)
        self._own = self._odd[0] if every else None
        self._apart = [k for k in self._odd if k != self._own]
        if self._apart:
            guard.check_points_alone()
        else:
            guard.check_movable()

    def filling(self) -> "Pieces[list[ChunkedWrite[Points]]]":
        """Compute its meshes: its own, then those of parts that become new objects.

        Raises:
            ValueError: attributes are missing or not finite.
        """
        table = yield from ChunkedRead(self._guard.there()).table(whole=bool(self._apart))
        own, *others = yield from run_in_thread(
            partial(self._mended, table), f"Transforming splats of {self._guard.name}"
        )
        make = self._guard.emptied_mesh if self._apart else self._guard.copied_mesh
        emptied = self._guard.emptied_mesh
        return [ChunkedWrite(own, make), *(ChunkedWrite(other, emptied) for other in others)]

    def _mended(self, table: list[Column], check: Check) -> list[Points]:
        for name, values in point_attributes.of_splats(table).items():
            attributes.check_finite(values, name, self._guard.name)
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
        """Assign the filled meshes of `filling`; returns the objects with a restored scale."""
        ob, (own, *others) = self._guard.there(), meshes
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


def mended(guards: list[EditGuard]) -> Pieces[list[bpy.types.Object]]:
    """Rotate and scale shapes and colors of objects to match their current positions.

    Stretched parts get their earlier positions back, and their object the matrix; a joined part
    becomes a new object for that.

    Returns:
        The objects with an uneven scale, as before Apply or Join.

    Raises:
        ValueError: a mesh cannot be written, or the lags cannot be corrected; nothing is changed
            then.
    """
    mends = [Mend(guard) for guard in guards]
    fillings = []
    for mend in mends:
        fillings.append((yield from mend.filling()))
    meshes = yield from filled(
        [one for some in fillings for one in some], partial(all_to_change, guards)
    )
    taken, left = [], iter(meshes)
    for mend, some in zip(mends, fillings, strict=True):
        taken += mend.finish([next(left) for _ in some])
    return taken


def _users(ob: bpy.types.Object) -> list[bpy.types.Object]:
    """All objects with an object's mesh."""
    return [one for one in bpy.data.objects if one.data == ob.data]


def _with_lag(ob: bpy.types.Object, turn: np.ndarray) -> Matrix:
    """The matrix of an object after a lag moves from its splats to it.

    Raises:
        ValueError: the matrix would be singular or sheared.
    """
    if abs(np.linalg.det(turn)) > 1e-12:
        exact = ob.matrix_basis @ _matrix(turn)
        made = Matrix.LocRotScale(*exact.decompose())
        if np.allclose(made, exact, rtol=0, atol=1e-5 * np.abs(np.array(exact)[:3, :3]).max()):
            return made
    raise ValueError(
        f"{ob.name} was sheared or scaled to 0, which its object cannot represent: undo the Apply "
        "or Join (Ctrl Z)."
    )


def _take_back(ob: bpy.types.Object, turn: np.ndarray) -> None:
    """Apply a lag to the matrix of an object whose splats have their earlier positions again; its
    children stay in place."""
    back = np.linalg.inv(turn)
    for child in ob.children:
        child.matrix_parent_inverse = _matrix(back) @ child.matrix_parent_inverse
    ob.matrix_basis = _with_lag(ob, turn)


def _matrix(turn: np.ndarray) -> Matrix:
    return Matrix(turn.tolist()).to_4x4()
