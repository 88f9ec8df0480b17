"""Handlers that sample meshes of splats after Blender may have transformed their positions; see
`lag`.

Reading even one position makes Blender copy all of them, because the display shares them: 10 ms for
a million splats. So a mesh is sampled only if it changed together with the rotation or scale of its
object, as by Apply, or right after Apply; if its number of splats changed, as by Join; and when
Edit Mode is left.
"""

from dataclasses import dataclass, field

import bpy
from bpy.app.handlers import persistent

from ..interface import editable_check
from . import lag
from .objects import is_splats

Turn = tuple[float, ...]


@dataclass
class _Session:
    """State that decides when to sample, never the result."""

    all_seen: bool = False
    """True if every mesh of the file was sampled."""
    turns: dict[int, Turn] = field(default_factory=dict)
    """Rotation and scale of the matrix of each splat object, by session uid."""
    edited: set[int] = field(default_factory=set)
    """Objects that were in Edit Mode."""
    unseen: set[int] = field(default_factory=set)
    """Meshes changed since their last sample: sampled again when their object is rotated, so that a
    following Apply is detected separately."""
    noted: set[int] = field(default_factory=set)
    """Meshes whose stored state was updated, which happens after the undo step of the change."""


_state = _Session()


def look_at_all() -> None:
    """Sample the splats of all objects of the file."""
    _state.turns.clear()
    _state.edited.clear()
    for ob in bpy.data.objects:
        if is_splats(ob):
            _remember(ob)
            _look(ob.data)
    _state.all_seen = True


def _look(mesh: bpy.types.Mesh) -> None:
    _state.unseen.discard(mesh.session_uid)
    if editable_check.keeps(mesh) and lag.follow(mesh):
        _state.noted.add(mesh.session_uid)


def _remember(ob: bpy.types.Object) -> bool:
    """Store the rotation and mode of an object; True if its mesh must be sampled if changed."""
    uid = ob.session_uid
    turn = tuple(value for row in ob.matrix_basis.to_3x3() for value in row)
    turned = _state.turns.get(uid, turn) != turn  # new objects were sampled at creation
    _state.turns[uid] = turn
    if ob.mode == "EDIT":
        _state.edited.add(uid)
        return False
    left = uid in _state.edited
    _state.edited.discard(uid)
    return turned or left or lag.is_miscounted(ob.data)


@persistent
def _changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if not _state.all_seen:  # the file is not accessible during registration
        look_at_all()
        return
    obs, changed = [], set()
    for update in depsgraph.updates:
        if isinstance(update.id, bpy.types.Object):
            obs.append(update.id.original)
        elif update.is_updated_geometry and isinstance(update.id, bpy.types.Mesh):
            changed.add(update.id.original)
    # Not the objects' geometry updates: the display's nodes cause one at each rotation.
    for ob in filter(is_splats, obs):
        due, uid = _remember(ob) or _applied(), ob.data.session_uid
        if ob.data in changed and not due:
            _state.unseen.add(uid)
        elif ob.data in changed or (due and uid in _state.unseen):
            _look(ob.data)


def _applied() -> bool:
    """True if Apply was the last operator, because changing its settings runs it again."""
    done = bpy.context.window_manager.operators
    return len(done) > 0 and done[-1].bl_idname == "OBJECT_OT_transform_apply"


@persistent
def _undone(*_: object) -> None:
    for ob in bpy.data.objects:
        if is_splats(ob):
            _remember(ob)
            if ob.data.session_uid in _state.noted or lag.is_miscounted(ob.data):
                _look(ob.data)


@persistent
def _file_loaded(*_: object) -> None:
    _state.noted.clear()
    look_at_all()


HANDLERS = {
    "depsgraph_update_post": _changed,
    "undo_post": _undone,
    "redo_post": _undone,
    "load_post": _file_loaded,
}


def on_register() -> None:
    """Sample all meshes at the next update."""
    _state.all_seen = False
