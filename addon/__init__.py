"""The Blender add-on: what is registered, and in which order.

Importing this package needs no bpy, so that its modules of plain formulas serve scripts as well.
"""

from importlib import import_module

MODULES: tuple[str, ...] = (
    "preferences",
    "outcomes",
    "job.properties",
    "stored_paths",
    "cameras.operators",
    "cameras.alignment_operators",
    "splats.settings",
    "splats.operators",
    "job.operators",
    "depth.operators",
    "depth.colors",
    "depth.overlay",
    "panels",
    "render.settings",
    "render.engine",
    "render.compositor",
    "render.operators",
    "render.panels",
)
"""Modules with a register() and an unregister(), in the order in which they need each other."""


def register() -> None:
    """Register every module of MODULES; after a failure nothing stays registered."""
    done = []
    try:
        for name in MODULES:
            module = import_module(f".{name}", __package__)
            module.register()
            done.append(module)
    except BaseException:
        for module in reversed(done):
            module.unregister()
        raise


def unregister() -> None:
    """Take everything back in reverse order."""
    for name in reversed(MODULES):
        import_module(f".{name}", __package__).unregister()
