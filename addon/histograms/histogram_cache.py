"""Cached histograms of objects' splats, counted again when their meshes change, and their icons."""

import time
from dataclasses import dataclass, field
from functools import partial

import bpy
import numpy as np
from bpy.app.handlers import persistent

from .. import attributes
from ..interface.blocks import with_uid
from ..interface.images import PictureIcons
from ..interface.windows import redraw_views
from ..process import poll_timer
from ..process.incremental_tasks import Check, Steps, TaskRunner, run_blocking, run_in_thread
from ..splats import point_attributes
from .counting import OPACITY, SIZE, Histogram, of_opacities, of_sizes
from .limits import limits_of

MOST = 200_000
"""Limit of counted splats; of larger meshes every n-th splat is counted. Smaller ones are counted
synchronously the first time."""
QUIET = 0.3
"""Seconds without a change after which a mesh is counted again. Changes of filter limits count as
changes of the mesh, too."""
_KEPT = 4
"""Number of objects whose counts are kept, for several windows."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Count:
    """Counts of a mesh."""

    counted: tuple[np.ndarray, ...] = ()
    """Counted opacities and sizes, to detect changes."""
    found: dict[str, Histogram] = field(default_factory=dict)


_NOTHING = _Count()


@dataclass
class _Entry:
    """State of an object."""

    mesh: int = 0
    """Session uid of the counted mesh."""
    count: _Count = _NOTHING
    stale: bool = True
    requested: bool = False
    """True if requested since it became stale."""
    changed: float = float("-inf")
    """Monotonic seconds."""
    task: TaskRunner | None = None


class HistogramCache:
    """Histograms of the most recently requested objects."""

    def __init__(self) -> None:
        self._entries: dict[int, _Entry] = {}
        """Entries by session uid of the object, most recently requested last."""

    def of(self, ob: bpy.types.Object) -> dict[str, Histogram]:
        """Histograms of an object's own mesh by kind; empty without splats, or if attributes are
        missing or not finite.

        After a change, and in Edit Mode, where splats cannot be read, the previous ones are
        returned until a thread has counted; of many splats none at first.
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
            entry.mesh, entry.stale, entry.requested = mesh.session_uid, True, True
            if entry.count is _NOTHING and len(mesh.vertices) <= MOST:
                _give_up(entry)
                entry.count = run_blocking(_counting(entry.mesh, _NOTHING))
                entry.stale = entry.requested = False
            else:
                poll_timer.ensure()
        return entry.count.found

    def forget(self, uids: set[int]) -> None:
        """Count these meshes again at the next request, once they are unchanged for a while."""
        for entry in self._entries.values():
            if entry.mesh in uids:
                entry.stale, entry.changed = True, time.monotonic()

    def clear(self) -> None:
        """Drop all counts."""
        for entry in self._entries.values():
            _give_up(entry)
        self._entries.clear()

    def collect(self) -> bool:
        """Start and continue counts; true if there are new results."""
        new = [_step(entry) for entry in self._entries.values()]
        if any(new):
            redraw_views()
        return any(new)

    def waits(self) -> bool:
        """True if a count runs, or is due when its mesh stops changing."""
        return any(entry.requested or entry.task for entry in self._entries.values())


def _give_up(entry: _Entry) -> None:
    if entry.task is not None:
        entry.task.cancel()
    entry.task, entry.requested = None, False


def _step(entry: _Entry) -> bool:
    """Start or continue a count; true if there are new results."""
    if entry.task is None:
        if entry.requested and time.monotonic() - entry.changed >= QUIET:
            entry.stale = entry.requested = False
            entry.task = TaskRunner(_counting(entry.mesh, entry.count))
        return False
    task, entry.task = entry.task, None
    if not task.step():  # may raise MemoryError
        entry.task = task
        return False
    before, entry.count = entry.count, task.result
    return entry.count is not before


def _counting(uid: int, before: _Count) -> Steps[_Count]:
    """Count a mesh, one attribute per step; returns `before` if it is still right, or if the mesh
    cannot be read."""
    columns: dict[str, np.ndarray] = {}
    for name, kind in ((attributes.BASE, "FLOAT_COLOR"), (attributes.SCALE, "FLOAT_VECTOR")):
        mesh = with_uid(bpy.data.meshes, uid)
        count = 0 if mesh is None else len(mesh.vertices)
        make = partial(point_attributes.zeroed, {name: kind}, count)
        [(_, _, values)] = yield from run_in_thread(make, "")
        mesh = with_uid(bpy.data.meshes, uid)
        if mesh is None or mesh.is_editmode or len(mesh.vertices) != count:
            return before  # another count follows, or none is requested
        try:
            attribute = attributes.check_vectors(mesh, name)
        except ValueError:  # the panel shows the reason
            return _NOTHING
        if attributes.FORMATS[attribute.data_type][1] != values.shape[1]:
            return _NOTHING
        point_attributes.copy_values(mesh, name, values)
        columns[name] = values
    return (yield from run_in_thread(partial(_count, columns, before), ""))


def _count(columns: dict[str, np.ndarray], before: _Count, check: Check) -> _Count:
    every = slice(None, None, max(1, -(-len(columns[attributes.BASE]) // MOST)))
    x, y, z = columns[attributes.SCALE][every].T
    counted = columns[attributes.BASE][every, 3].copy(), np.maximum(np.maximum(x, y), z)
    if not all(np.isfinite(values).all() for values in counted):
        return _NOTHING
    if before.counted and all(map(np.array_equal, counted, before.counted)):
        return before
    opacities, sizes = counted
    found = {OPACITY: of_opacities(opacities), SIZE: of_sizes(sizes)}
    return _Count(counted=counted, found=found)


HISTOGRAMS = HistogramCache()
_POLLER = poll_timer.Poller(HISTOGRAMS.collect, HISTOGRAMS.waits)


@persistent
def _changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Mark changed meshes as stale."""
    meshes = {
        u.id.original.session_uid for u in depsgraph.updates if isinstance(u.id, bpy.types.Mesh)
    }
    HISTOGRAMS.forget(meshes)


HANDLERS = {"depsgraph_update_post": _changed}
APPENDED = ((poll_timer.POLLERS, _POLLER),)


_SIZE = 192


class HistogramIcons(PictureIcons):
    """One icon per kind, of the last shown object."""

    def update(self, ob: bpy.types.Object, kind: str) -> int:
        """Icon id of a histogram, hidden splats in grey; 0 if there is none."""
        if (found := HISTOGRAMS.of(ob).get(kind)) is None:
            return 0
        limits = limits_of(ob, kind)
        return self.show(kind, (found, *limits), lambda: found.picture(_SIZE, _SIZE, *limits))


ICONS = HistogramIcons()
on_register = ICONS.open


def on_unregister() -> None:
    """Stop counting, and remove the icons."""
    HISTOGRAMS.clear()
    ICONS.close()
