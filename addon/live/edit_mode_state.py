"""Edit Mode state: selected and hidden vertices of large meshes, read in chunks.

Blender's API reads the state of one vertex at a time. The first access builds a table of all
vertices, which takes 0.2 s for a million, and frees it when no reference to the BMesh is left. So
the BMesh is requested when Edit Mode begins, which takes longer anyway, and kept until it ends.
"""

import time
from dataclasses import dataclass, field

import bmesh
import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..interface.windows import redraw_views
from ..render import viewport_copies
from ..render.mesh_copies import HIDDEN, SELECTED
from ..splats.live_display import SESSION

REST = 0.2
"""Seconds without a change after which reading begins."""
INTERVAL = 0.01
"""Seconds between two chunks."""
PIECE = 20_000
"""Vertices per chunk, which takes 4 to 8 ms."""


@dataclass
class _Reading:
    """Progress of reading one mesh."""

    editor: bmesh.types.BMesh
    changed: float
    """Time of the last change, monotonic seconds."""
    marks: list[np.ndarray] = field(default_factory=list)
    """Chunks, as `FrozenMesh.marks`."""
    done: int = 0
    """Number of vertices read."""
    complete: bool = False


class Reader:
    """Reads meshes that are too large to be copied in Edit Mode; main thread only."""

    def __init__(self, known: viewport_copies.Copies) -> None:
        """Prepare; marks are written to `known`."""
        self._known = known
        self._readings: dict[int, _Reading] = {}

    def clear(self) -> None:
        """Release all BMeshes."""
        self._readings.clear()

    @property
    def waits(self) -> bool:
        """Whether meshes remain to be read."""
        return any(not one.complete for one in self._readings.values())

    def notice(self, depsgraph: bpy.types.Depsgraph, now: float) -> None:
        """Schedule edited meshes of a depsgraph update to be read again once they rest.

        Args:
            depsgraph: Depsgraph with the update.
            now: Monotonic seconds.
        """
        for update in depsgraph.updates:
            block = update.id.original
            begins = isinstance(block, bpy.types.Object)  # edits do not update objects
            mesh = block.data if begins else block
            if not isinstance(mesh, bpy.types.Mesh) or not mesh.is_editmode:
                continue
            uid = mesh.session_uid
            if self._known.too_many(uid) and not (begins and uid in self._readings):
                self._readings[uid] = _Reading(_editor(mesh), now)

    def step(self, now: float) -> bool:
        """Read a chunk of a mesh that rests; return whether views must be redrawn.

        Args:
            now: Monotonic seconds.
        """
        edited = {mesh.session_uid: mesh for mesh in bpy.data.meshes if mesh.is_editmode}
        for uid in self._readings.keys() - edited.keys():
            del self._readings[uid]
        for uid, reading in self._readings.items():
            if reading.complete or now - reading.changed < REST:
                continue
            if not reading.editor.is_valid:  # undo replaces it
                self._readings[uid] = _Reading(_editor(edited[uid]), now)
                return False
            if _read_piece(reading):
                marks = np.concatenate(reading.marks or [np.zeros(0, np.uint8)])
                reading.complete, reading.marks = True, []
                self._known.remark(uid, marks if marks.any() else None)
            return reading.complete
        return False


def _editor(mesh: bpy.types.Mesh) -> bmesh.types.BMesh:
    """The BMesh of a mesh, with its vertex table built."""
    editor = bmesh.from_edit_mesh(mesh)
    next(iter(editor.verts), None)
    return editor


def _read_piece(reading: _Reading) -> bool:
    """Read the next chunk; return whether it was the last."""
    verts = reading.editor.verts
    found = verts[reading.done : reading.done + PIECE]
    selected = np.fromiter((vertex.select for vertex in found), bool, len(found))
    hidden = np.fromiter((vertex.hide for vertex in found), bool, len(found))
    reading.marks.append(np.uint8(SELECTED) * selected | np.uint8(HIDDEN) * hidden)
    reading.done += len(found)
    return reading.done >= len(verts)


_READER = Reader(viewport_copies.SHARED)


@persistent
def _changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if SESSION.there:  # splats are drawn live
        _READER.notice(depsgraph, time.monotonic())
    if _READER.waits and not bpy.app.timers.is_registered(_poll):
        bpy.app.timers.register(_poll, first_interval=REST)


@persistent
def _file_loaded(*_: object) -> None:
    _READER.clear()


def _poll() -> float | None:
    if _READER.step(time.monotonic()):
        redraw_views()
    return INTERVAL if _READER.waits else None


HANDLERS = {"depsgraph_update_post": _changed, "load_post": _file_loaded}


def on_unregister() -> None:
    """Stop following edits."""
    if bpy.app.timers.is_registered(_poll):
        bpy.app.timers.unregister(_poll)
    _READER.clear()
