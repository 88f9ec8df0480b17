"""Repair of shapes and colors after Blender's Apply: the operator, and handlers that sample meshes
of splats after Blender may have transformed their positions; see `lag`.

Reading even one position makes Blender copy all of them, because the display shares them: 10 ms for
a million splats. So a mesh is sampled only if it changed together with the rotation or scale of its
object, as by Apply, or right after Apply; if its number of splats changed, as by Join; and when
Edit Mode is left.
"""

from collections.abc import Iterable
from functools import partial

import bpy
import numpy as np
from bpy.app.handlers import persistent

from .. import attributes
from ..interface import editable_check
from ..interface.base_operator import Condition
from ..interface.incremental_operator import IncrementalOperator
from ..process.incremental_tasks import Check, Steps, run_in_thread
from . import lag, objects, point_attributes
from .edit_guard import EditGuard, all_to_change
from .mesh_buffers import Points, points_of
from .objects import is_splats
from .point_attributes import Column
from .read_chunked import ChunkedRead
from .rotation import turned
from .write_chunked import ChunkedWrite, filled, swap


def outdated(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The splat objects with a problem: the one that the user works on, and the selected ones."""
    obs = dict.fromkeys([objects.active_splats(context), *context.selected_objects])
    return [ob for ob in obs if objects.is_splats(ob) and lag.problem(ob.data)]


class MendSplats(IncrementalOperator, bpy.types.Operator):
    """Rotate and scale shapes and colors of splats whose positions alone were changed by Blender's
    Apply; stretched positions get a uniform scale. Splats that Blender's Join added are kept as
    they are"""

    bl_idname = "gscore.mend_splats"
    bl_label = "Update Shapes and Colors"
    needs = Condition(
        lambda context: bool(outdated(context)),
        "Shapes and colors of the selected splats match their positions",
    )

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """Their points."""
        return [ob.data for ob in outdated(context)]

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Correct each mesh once."""
        obs = {ob.data: ob for ob in reversed(outdated(context))}.values()
        names = ", ".join(ob.name for ob in obs)
        context.view_layer.update()  # else the guards would detect earlier changes
        guards: list[EditGuard] = []
        try:
            for ob in obs:
                objects.catch_up(ob)
                guards.append(EditGuard(ob))
            yield from _mended(guards)
        finally:
            for guard in guards:
                guard.close()
        return f"Updated shapes and colors of {names}."


def _mended(guards: list[EditGuard]) -> Steps[None]:
    """Rotate and scale shapes and colors of objects to match their current positions.

    Raises:
        ValueError: a mesh cannot be written, or a lag has no inverse; nothing is changed then.
    """
    writes = []
    for guard in guards:
        ob = guard.there()
        guard.check_movable()
        turn = lag.of(ob.data)
        if turn is None:  # joined: kept
            turn = np.eye(3)
        if lag.even(turn) is None:
            raise ValueError(f"{ob.name} was scaled to 0: undo the Apply (Ctrl Z).")
        table = yield from ChunkedRead(ob).table(whole=False)
        points = yield from run_in_thread(
            partial(_turned, table, turn, guard.name), f"Transforming splats of {guard.name}"
        )
        writes.append(ChunkedWrite(points, guard.copied_mesh))
    meshes = yield from filled(writes, partial(all_to_change, guards))
    for guard, mesh in zip(guards, meshes, strict=True):
        lag.forget(mesh)
        swap(guard.there(), mesh)
        lag.follow(mesh)


def _turned(table: list[Column], turn: np.ndarray, name: str, check: Check) -> Points:
    """The changed attributes of a table. Shapes follow the similarity next to a lag, and positions
    too if they were stretched, around their center."""
    columns = point_attributes.of_splats(table)
    for one, values in columns.items():
        attributes.check_finite(values, one, name)
    check()
    even = lag.even(turn)
    places = next(column for column in table if column.name == attributes.POSITION)
    changed = turned(table, even[None], np.zeros(len(places.values), np.int32))
    if not np.allclose(even, turn, rtol=0, atol=1e-4 * np.abs(turn).max()):
        exact = places.values.astype(np.float64)
        center = exact.mean(axis=0)
        places.values[:] = center + (exact - center) @ (even @ np.linalg.inv(turn)).T
        changed.append(places)
    return points_of(changed)


_STATES: dict[int, tuple[float | bool, ...]] = {}
"""Rotation and scale of the matrix of each splat object, and whether it is in Edit Mode, by session
uid."""
_UNSEEN: set[int] = set()
"""Meshes changed since their last sample: sampled again when their object is rotated, so that a
following Apply is detected separately."""
_NOTED: set[int] = set()
"""Meshes whose stored state was updated, which happens after the undo step of the change."""


def _look(mesh: bpy.types.Mesh, *, edited: bool = False) -> None:
    _UNSEEN.discard(mesh.session_uid)
    if editable_check.keeps(mesh) and lag.follow(mesh, edited=edited):
        _NOTED.add(mesh.session_uid)


def _remember(ob: bpy.types.Object) -> tuple[float | bool, ...]:
    """Store the rotation and mode of an object; returns the earlier ones, for a new object its
    own."""
    state = (*(value for row in ob.matrix_basis.to_3x3() for value in row), ob.mode == "EDIT")
    before = _STATES.get(ob.session_uid, state)
    _STATES[ob.session_uid] = state
    return before


@persistent
def _changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    obs = []
    for update in depsgraph.updates:
        if isinstance(update.id, bpy.types.Object):
            obs.append(update.id.original)
        elif update.is_updated_geometry and isinstance(update.id, bpy.types.Mesh):
            _UNSEEN.add(update.id.original.session_uid)
    # Not the objects' geometry updates: the display's nodes cause one at each rotation.
    for ob in filter(is_splats, obs):
        before, mesh = _remember(ob), ob.data
        edited = bool(before[-1])
        done = bpy.context.window_manager.operators
        # As the last operator, because changing its settings runs it again.
        applied = len(done) > 0 and done[-1].bl_idname == "OBJECT_OT_transform_apply"
        due = before != _STATES[ob.session_uid] or lag.is_miscounted(mesh) or applied
        if due and ob.mode != "EDIT" and mesh.session_uid in _UNSEEN:
            _look(mesh, edited=edited)


@persistent
def _undone(*_: object) -> None:
    for ob in filter(is_splats, bpy.data.objects):
        _remember(ob)
        if ob.data.session_uid in _NOTED or lag.is_miscounted(ob.data):
            _look(ob.data)


@persistent
def _file_loaded(*_: object) -> None:
    for state in (_STATES, _UNSEEN, _NOTED):
        state.clear()
    _undone()


HANDLERS = {
    "depsgraph_update_post": _changed,
    "undo_post": _undone,
    "redo_post": _undone,
    "load_post": _file_loaded,
}
