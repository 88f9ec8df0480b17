"""The tab "Train Splats" of the 3D view's sidebar, in the order of the work."""

import bpy

from . import cameras, capture, curve_icon, depth, depth_table, progress, render, result, train

CLASSES = (
    *capture.CLASSES,
    *cameras.CLASSES,
    *depth.CLASSES,
    *train.CLASSES,
    *progress.CLASSES,
    *result.CLASSES,
    *render.CLASSES,
)


def register() -> None:
    """Register the panels."""
    curve_icon.register()
    depth_table.register()
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Take them back."""
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
    depth_table.unregister()
    curve_icon.unregister()
