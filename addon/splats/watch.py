"""Has meshes of splats looked at when they have changed: see `lag`."""

import bpy
from bpy.app.handlers import persistent

from ..interface import writable
from . import lag
from .objects import is_splats


class _Watch:
    """Of the session."""

    all_seen = False
    """Whether every mesh of the file was looked at."""


def look_at_all() -> None:
    """Look at the splats of all objects of the file."""
    for mesh in {ob.data for ob in bpy.data.objects if is_splats(ob)}:
        _look(mesh)
    _Watch.all_seen = True


def _look(mesh: bpy.types.Mesh) -> None:
    if writable.keeps(mesh):
        lag.follow(mesh)


@persistent
def _changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if not _Watch.all_seen:  # an add-on sees no file while it is registered
        look_at_all()
        return
    for update in depsgraph.updates:
        if update.is_updated_geometry and isinstance(update.id, bpy.types.Mesh):
            _look(update.id.original)


@persistent
def _other_state(*_: object) -> None:
    look_at_all()


_HANDLERS = {
    "depsgraph_update_post": _changed,
    "undo_post": _other_state,
    "redo_post": _other_state,
    "load_post": _other_state,
}


def on_register() -> None:
    """Follow changes."""
    _Watch.all_seen = False
    for name, function in _HANDLERS.items():
        getattr(bpy.app.handlers, name).append(function)


def on_unregister() -> None:
    """Follow no more."""
    for name, function in _HANDLERS.items():
        getattr(bpy.app.handlers, name).remove(function)
