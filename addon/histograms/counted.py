"""Counted histograms of objects' splats, counted again when their meshes change."""

import time
from dataclasses import dataclass, field
from functools import partial

import bpy
import numpy as np
from bpy.app.handlers import persistent

from .. import attributes
from ..interface.blocks import with_uid
from ..interface.views import redraw_views
from ..process import poll_timer
from ..process.incremental_tasks import Check, Pieces, TaskRunner, run_blocking, run_in_thread
from ..process.reserved_memory import written
from .counting import OPACITY, SIZE, Histogram, of_opacities, of_sizes

MOST = 200_000
"""Splats that are counted; of more, every so many-th. Up to so many are counted at once, at
first."""
QUIET = 0.3
"""Seconds without a change after which a mesh is counted anew. Blender calls it changed with each
limit of its filters, too."""
_KEPT = 4
"""Objects, one for each window that shows another, and some more."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Count:
    """What was made of a mesh."""

    looked_at: tuple[np.ndarray, ...] = ()
    """Opacities and sizes that were counted, by which it is told that nothing has changed."""
    found: dict[str, Histogram] = field(default_factory=dict)


_NOTHING = _Count()


@dataclass
class _Entry:
    """What is known of an object."""

    mesh: int = 0
    """Session number of what was counted, or is."""
    count: _Count = _NOTHING
    stale: bool = True
    wanted: bool = False
    """Whether somebody has asked since it was stale."""
    changed: float = float("-inf")
    """Monotonic seconds."""
    going: TaskRunner | None = None


class Counted:
    """Those of the objects that were asked for last."""

    def __init__(self) -> None:
        self._entries: dict[int, _Entry] = {}
        """By the object's session number, the one that was asked for last at the end."""

    def of(self, ob: bpy.types.Object) -> dict[str, Histogram]:
        """Of an object's own mesh, by kind; nothing where there are no splats, or attributes are
        missing or not finite.

        After a change, and in Edit Mode, where splats are out of reach, they are those of before
        until a thread has counted; of many splats there is nothing until then at first.
        """
        mesh, entry = ob.data, self._entries.pop(ob.session_uid, None) or _Entry()
        self._entries[ob.session_uid] = entry
        while len(self._entries) > _KEPT:
            _give_up(self._entries.pop(next(iter(self._entries))))
        if mesh.is_editmode:
            return entry.count.found
        if not len(mesh.vertices):
            _give_up(entry)
            entry.count, entry.stale = _NOTHING, True
        elif entry.stale or entry.mesh != mesh.session_uid:
            entry.mesh, entry.stale, entry.wanted = mesh.session_uid, True, True
            if entry.count is _NOTHING and len(mesh.vertices) <= MOST:
                _give_up(entry)
                entry.count = run_blocking(_counting(entry.mesh, _NOTHING))
                entry.stale = entry.wanted = False
            else:
                poll_timer.ensure()
        return entry.count.found

    def forget(self, uids: set[int]) -> None:
        """Count these meshes anew when they are asked for next, and have been quiet for a while."""
        for entry in self._entries.values():
            if entry.mesh in uids:
                entry.stale, entry.changed = True, time.monotonic()

    def clear(self) -> None:
        """Forget all."""
        for entry in self._entries.values():
            _give_up(entry)
        self._entries.clear()

    def collect(self) -> bool:
        """Begin and go on counting; whether there is something new to show."""
        new = [_step(entry) for entry in self._entries.values()]
        if any(new):
            redraw_views()
        return any(new)

    def waits(self) -> bool:
        """Whether a count is under way, or waits for a mesh to be quiet."""
        return any(entry.wanted or entry.going for entry in self._entries.values())


def _give_up(entry: _Entry) -> None:
    if entry.going is not None:
        entry.going.cancel()
    entry.going, entry.wanted = None, False


def _step(entry: _Entry) -> bool:
    """Begin or go on; whether there is something else to show."""
    if entry.going is None:
        if entry.wanted and time.monotonic() - entry.changed >= QUIET:
            entry.stale = entry.wanted = False
            entry.going = TaskRunner(_counting(entry.mesh, entry.count))
        return False
    going, entry.going = entry.going, None
    if not going.step():  # which raises where there is no memory
        entry.going = going
        return False
    before, entry.count = entry.count, going.result
    return entry.count is not before


def _counting(uid: int, before: _Count) -> Pieces[_Count]:
    """Count a mesh, read an attribute a piece; what was there before where it is still right, or
    the mesh is out of reach."""
    columns: dict[str, np.ndarray] = {}
    for name, width in ((attributes.BASE, 4), (attributes.SCALE, 3)):
        mesh = with_uid(bpy.data.meshes, uid)
        count = 0 if mesh is None else len(mesh.vertices)
        values = yield from run_in_thread(lambda check, size=count * width: written(size), "")
        mesh = with_uid(bpy.data.meshes, uid)
        if mesh is None or mesh.is_editmode or len(mesh.vertices) != count:
            return before  # another count follows, or nobody asks any more
        try:
            attribute = attributes.check_vectors(mesh, name)
        except ValueError:  # the panel says what is the matter
            return _NOTHING
        key, found = attributes.FORMATS[attribute.data_type]
        if found != width:
            return _NOTHING
        attribute.data.foreach_get(key, values)
        columns[name] = values.reshape(count, width)
    return (yield from run_in_thread(partial(_count, columns, before), ""))


def _count(columns: dict[str, np.ndarray], before: _Count, check: Check) -> _Count:
    every = slice(None, None, max(1, -(-len(columns[attributes.BASE]) // MOST)))
    x, y, z = columns[attributes.SCALE][every].T
    seen = columns[attributes.BASE][every, 3].copy(), np.maximum(np.maximum(x, y), z)
    if not all(np.isfinite(values).all() for values in seen):
        return _NOTHING
    if before.looked_at and all(map(np.array_equal, seen, before.looked_at)):
        return before
    opacities, sizes = seen
    found = {OPACITY: of_opacities(opacities), SIZE: of_sizes(sizes)}
    return _Count(looked_at=seen, found=found)


COUNTED = Counted()
_FOLLOWER = poll_timer.Poller(COUNTED.collect, COUNTED.waits)


@persistent
def _changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Meshes were changed, by whomever."""
    meshes = {
        u.id.original.session_uid for u in depsgraph.updates if isinstance(u.id, bpy.types.Mesh)
    }
    COUNTED.forget(meshes)


HANDLERS = {"depsgraph_update_post": _changed}


def on_register() -> None:
    """Count in Blender's beat."""
    poll_timer.FOLLOWERS.append(_FOLLOWER)


def on_unregister() -> None:
    """Count no more."""
    poll_timer.FOLLOWERS.remove(_FOLLOWER)
    COUNTED.clear()
