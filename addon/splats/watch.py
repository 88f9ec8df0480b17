"""Has meshes of splats looked at where Blender may have moved their places: see `lag`.

Reading even one place has Blender copy all of them, since the display shares them: 10 ms of a
million splats. So a mesh is looked at only when it has changed together with the turn or scale of
its object, which is what Apply does, or right after Apply; when it has got another number of
splats, as by Join; and when Edit Mode is left.
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
    """What is remembered: it decides when to look, never what is found."""

    all_seen: bool = False
    """Whether every mesh of the file was looked at."""
    turns: dict[int, Turn] = field(default_factory=dict)
    """Rotation and scale of the matrix of each splat object, by its session number."""
    edited: set[int] = field(default_factory=set)
    """Objects that were in Edit Mode."""
    unseen: set[int] = field(default_factory=set)
    """Meshes that have changed since they were looked at: they are looked at once more when their
    object is turned, so that what Apply does then is seen alone."""
    noted: set[int] = field(default_factory=set)
    """Meshes of which something was noted, which is after the undo step that it belongs to."""


_state = _Session()


def look_at_all() -> None:
    """Look at the splats of all objects of the file."""
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
    """Take in how an object is turned and whether it is edited; whether its mesh is to be looked at
    if it has changed."""
    uid = ob.session_uid
    turn = tuple(value for row in ob.matrix_basis.to_3x3() for value in row)
    turned = _state.turns.get(uid, turn) != turn  # a new one was looked at when it was made
    _state.turns[uid] = turn
    if ob.mode == "EDIT":
        _state.edited.add(uid)
        return False
    left = uid in _state.edited
    _state.edited.discard(uid)
    return turned or left or lag.is_miscounted(ob.data)


@persistent
def _changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if not _state.all_seen:  # an add-on sees no file while it is registered
        look_at_all()
        return
    obs, changed = [], set()
    for update in depsgraph.updates:
        if isinstance(update.id, bpy.types.Object):
            obs.append(update.id.original)
        elif update.is_updated_geometry and isinstance(update.id, bpy.types.Mesh):
            changed.add(update.id.original)
    # An object's own geometry is of no use here: with the display's nodes it follows every turn.
    for ob in filter(is_splats, obs):
        wanted, uid = _remember(ob) or _applied(), ob.data.session_uid
        if ob.data in changed and not wanted:
            _state.unseen.add(uid)
        elif ob.data in changed or (wanted and uid in _state.unseen):
            _look(ob.data)


def _applied() -> bool:
    """Whether Apply was the last operator: its settings may be changed then, which does it anew."""
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
    """Look at all once more."""
    _state.all_seen = False
