"""Registration of a module: its CLASSES, its HANDLERS, then `on_register`; undone in reverse."""

from collections.abc import Callable, Mapping
from types import ModuleType

import bpy

Handler = Callable[..., None]
"""Handler of Blender, called with a scene and a depsgraph, or other arguments of its list."""


def register(module: ModuleType) -> None:
    """Register a module's classes, append its handlers, then call its hook.

    Args:
        module: May have CLASSES, HANDLERS (functions by the name of a list in `bpy.app.handlers`),
            `on_register()` and `on_unregister()`. After a failure nothing of it stays registered.
    """
    done: list[type] = []
    appended: dict[str, Handler] = {}
    try:
        for cls in getattr(module, "CLASSES", ()):
            bpy.utils.register_class(cls)
            done.append(cls)
        for name, function in getattr(module, "HANDLERS", {}).items():
            getattr(bpy.app.handlers, name).append(function)
            appended[name] = function
        getattr(module, "on_register", _nothing)()
    except BaseException:
        _remove_handlers(appended)
        _unregister_classes(done)
        raise


def unregister(module: ModuleType) -> None:
    """Undo `register`."""
    getattr(module, "on_unregister", _nothing)()
    _remove_handlers(getattr(module, "HANDLERS", {}))
    _unregister_classes(getattr(module, "CLASSES", ()))


def _remove_handlers(handlers: Mapping[str, Handler]) -> None:
    for name, function in handlers.items():
        getattr(bpy.app.handlers, name).remove(function)


def _unregister_classes(classes: tuple[type, ...] | list[type]) -> None:
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)


def _nothing() -> None:
    pass
