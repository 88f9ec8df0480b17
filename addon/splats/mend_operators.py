"""Operator that transforms shapes and colors after Blender's Apply; see `lag`."""

from collections.abc import Iterable
from functools import partial

import bpy
import numpy as np

from .. import attributes
from ..interface.base_operator import Condition
from ..interface.incremental_operator import IncrementalOperator
from ..process.incremental_tasks import Check, Steps, run_in_thread
from . import lag, objects, point_attributes
from .edit_guard import EditGuard, all_to_change
from .mesh_buffers import Points, points_of
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
