"""Registration of a module: what it declares, then `on_register`; undone in reverse."""

from collections.abc import Callable, Iterator
from functools import partial
from types import ModuleType

import bpy

Step = tuple[Callable[[], object], Callable[[], object]]
"""A change of Blender's or the add-on's lists, and its undoing."""
_KINDS = (
    *("AddonPreferences", "FileHandler", "Gizmo", "GizmoGroup", "Menu", "Operator", "Panel"),
    *("PropertyGroup", "RenderEngine", "UIList"),
)
"""Names of the base classes in `bpy.types` whose subclasses Blender has to register."""
_drawing: dict[Callable[..., object], object] = {}
"""Handles of Blender by the function that draws in 3D views."""


def register(module: ModuleType) -> None:
    """Register the classes of Blender that a module defines and what it declares, then call its
    hook.

    Args:
        module: May have, registered in this order after its classes:
            PROPERTIES: Owners, names and properties of `bpy.props`.
            HANDLERS: Functions by the name of a list in `bpy.app.handlers`.
            APPENDED: Lists or menus, and what is appended to them.
            DRAWING: Functions that draw in all 3D views, and when: PRE_VIEW, POST_VIEW or
                POST_PIXEL. Blender has no views in the background.
            `on_register()` and `on_unregister()`.
            After a failure nothing of it stays registered.
    """
    undone: list[Callable[[], object]] = []
    try:
        for change, undo in _steps(module):
            change()
            undone.append(undo)
        getattr(module, "on_register", _nothing)()
    except BaseException:
        for undo in reversed(undone):
            undo()
        raise


def unregister(module: ModuleType) -> None:
    """Undo `register`."""
    getattr(module, "on_unregister", _nothing)()
    for _, undo in reversed(list(_steps(module))):
        undo()


def _steps(module: ModuleType) -> Iterator[Step]:
    for cls in classes_of(module):
        yield partial(bpy.utils.register_class, cls), partial(bpy.utils.unregister_class, cls)
    for owner, name, prop in getattr(module, "PROPERTIES", ()):
        yield partial(setattr, owner, name, prop), partial(delattr, owner, name)
    handlers = getattr(module, "HANDLERS", {}).items()
    lists = [(getattr(bpy.app.handlers, name), function) for name, function in handlers]
    for entries, entry in (*lists, *getattr(module, "APPENDED", ())):
        yield partial(entries.append, entry), partial(entries.remove, entry)
    if not bpy.app.background:
        for function, when in getattr(module, "DRAWING", ()):
            yield partial(_draw, function, when), partial(_end_drawing, function)


def classes_of(module: ModuleType) -> list[type]:
    """The classes of Blender that a module defines, in their order."""
    kinds = tuple(getattr(bpy.types, name) for name in _KINDS)
    own = (
        one for one in vars(module).values() if getattr(one, "__module__", "") == module.__name__
    )
    return [one for one in own if isinstance(one, type) and issubclass(one, kinds)]


def _draw(function: Callable[..., object], when: str) -> None:
    add = bpy.types.SpaceView3D.draw_handler_add
    _drawing[function] = add(function, (), "WINDOW", when)


def _end_drawing(function: Callable[..., object]) -> None:
    bpy.types.SpaceView3D.draw_handler_remove(_drawing.pop(function), "WINDOW")


def _nothing() -> None:
    pass
