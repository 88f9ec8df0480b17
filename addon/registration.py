"""Registration of a module: its CLASSES, its HANDLERS, then `on_register`; undone in reverse."""

from collections.abc import Callable, Mapping
from types import ModuleType

import bpy

Handler = Callable[..., None]
"""As Blender calls it, with a scene and a depsgraph, or what it has instead."""


def register(module: ModuleType) -> None:
    """Make a module's classes known to Blender, have its handlers called, then call its hook.

    Args:
        module: May have CLASSES, HANDLERS, which are functions by the names of the lists of
            `bpy.app.handlers`, `on_register()` and `on_unregister()`. After a failure nothing of it
            stays registered.
    """
    done: list[type] = []
    followed: dict[str, Handler] = {}
    try:
        for cls in getattr(module, "CLASSES", ()):
            bpy.utils.register_class(cls)
            done.append(cls)
        for name, function in getattr(module, "HANDLERS", {}).items():
            getattr(bpy.app.handlers, name).append(function)
            followed[name] = function
        getattr(module, "on_register", _nothing)()
    except BaseException:
        _unfollow(followed)
        _forget(done)
        raise


def unregister(module: ModuleType) -> None:
    """Take back what `register` did."""
    getattr(module, "on_unregister", _nothing)()
    _unfollow(getattr(module, "HANDLERS", {}))
    _forget(getattr(module, "CLASSES", ()))


def _unfollow(handlers: Mapping[str, Handler]) -> None:
    for name, function in handlers.items():
        getattr(bpy.app.handlers, name).remove(function)


def _forget(classes: tuple[type, ...] | list[type]) -> None:
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)


def _nothing() -> None:
    pass
