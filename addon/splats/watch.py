"""Handlers that sample meshes of splats after Blender may have transformed their positions; see
`lag`.

Reading even one position makes Blender copy all of them, because the display shares them: 10 ms for
a million splats. So a mesh is sampled only if it changed together with the rotation or scale of its
object, as by Apply, or right after Apply; if its number of splats changed, as by Join; and when
Edit Mode is left.
"""

import bpy
from bpy.app.handlers import persistent

from ..interface import editable_check
from . import lag
from .objects import is_splats

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
        due = before != _STATES[ob.session_uid] or lag.is_miscounted(mesh) or _applied()
        if due and ob.mode != "EDIT" and mesh.session_uid in _UNSEEN:
            _look(mesh, edited=edited)


def _applied() -> bool:
    """True if Apply was the last operator, because changing its settings runs it again."""
    done = bpy.context.window_manager.operators
    return len(done) > 0 and done[-1].bl_idname == "OBJECT_OT_transform_apply"


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
