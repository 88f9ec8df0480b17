"""Registers a module: its CLASSES, then its `on_register`; taken back in reverse order."""

from types import ModuleType

import bpy


def register(module: ModuleType) -> None:
    """Make a module's classes known to Blender, then call its hook.

    Args:
        module: May have CLASSES, `on_register()` and `on_unregister()`. After a failure nothing of
            it stays registered.
    """
    done: list[type] = []
    try:
        for cls in getattr(module, "CLASSES", ()):
            bpy.utils.register_class(cls)
            done.append(cls)
        getattr(module, "on_register", _nothing)()
    except BaseException:
        _forget(done)
        raise


def unregister(module: ModuleType) -> None:
    """Take back what `register` did."""
    getattr(module, "on_unregister", _nothing)()
    _forget(getattr(module, "CLASSES", ()))


def _forget(classes: tuple[type, ...] | list[type]) -> None:
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)


def _nothing() -> None:
    pass
