"""The Blender add-on: what is registered, and in which order.

Importing this package needs no bpy, so that its modules of plain formulas serve scripts as well.
"""

from importlib import import_module

MODULES: tuple[str, ...] = (
    "preferences",
    "outcomes",
    "stored_paths",
    "process.beat",
    "python.setup",
    "python.section",
    "python.operators",
    "cameras.photos",
    "cameras.straightening",
    "cameras.straight_operators",
    "cameras.operators",
    "cameras.view_operators",
    "cameras.path_operators",
    "cameras.alignment_operators",
    "cameras.overlay",
    "splats.settings",
    "splats.file_operators",
    "splats.operators",
    "splats.edit_operators",
    "splats.select_operators",
    "splats.mend_operators",
    "splats.watch",
    "splats.held",
    "interface.temporary",
    "interface.clearing",
    "job.properties",
    "job.follow",
    "job.operators",
    "job.bring",
    "job.captures",
    "job.guide_operators",
    "search.follow",
    "search.operators",
    "depth.follow",
    "depth.operators",
    "depth.colors",
    "timeline.settings",
    "timeline.follow",
    "timeline.operators",
    "sequence.settings",
    "sequence.follow",
    "sequence.operators",
    "render.settings",
    "render.engine",
    "render.compositor",
    "live.handler",
    "live.notice",
    "live.edited",
    "render.operators",
    "render.show",
    "render.see_through",
    "render.decimate",
    "render.panels",
    "paint.settings",
    "paint.operators",
    "paint.modal",
    "judge.follow",
    "judge.operators",
    "steer.settings",
    "steer.follow",
    "steer.operators",
    "steer.masks",
    "steer.mask_operators",
    "histograms.counted",
    "histograms.icons",
    "histograms.gizmos",
    "panels.curve_icon",
    "panels.depth_table",
    "panels.manual",
    "panels",
    "panels.paint_tool",
    "interface.stepping",
)
"""Modules that `registration` registers, in the order in which they need each other."""


def register() -> None:
    """Register every module of MODULES; after a failure nothing stays registered."""
    registration = import_module(".registration", __package__)
    done = []
    try:
        for name in MODULES:
            module = import_module(f".{name}", __package__)
            registration.register(module)
            done.append(module)
    except BaseException:
        for module in reversed(done):
            registration.unregister(module)
        raise


def unregister() -> None:
    """Take everything back in reverse order."""
    registration = import_module(".registration", __package__)
    for name in reversed(MODULES):
        registration.unregister(import_module(f".{name}", __package__))
