"""Error maps as objects next to a run's splats: detection, display, removal."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy

from .. import stored_paths
from .objects import hide, is_splats

MAP = "gs_error_map"
"""Custom property of an error map object."""


def run_of(ob: bpy.types.Object) -> Path:
    """Folder of the training run that an object or an error map belongs to.

    Raises:
        ValueError: it belongs to none.
    """
    text = stored_paths.read(ob, stored_paths.RUN)
    if not text:
        raise ValueError(f"{ob.name} is not from a training, so its photos are unknown.")
    return Path(text)


def finished_run_of(ob: bpy.types.Object) -> Path:
    """`run_of`, if its training has a result.

    Raises:
        ValueError: as `run_of`, or the training is not complete.
    """
    run = run_of(ob)
    if not (run / "point_cloud.ply").is_file():
        raise ValueError(f"{run} has no finished training; complete the training first.")
    return run


def is_map(ob: bpy.types.Object) -> bool:
    """True if an object is an error map."""
    return bool(ob.get(MAP))


def siblings(ob: bpy.types.Object) -> tuple[list[bpy.types.Object], list[bpy.types.Object]]:
    """The splat objects and the error map objects of an object's run.

    Raises:
        ValueError: it belongs to no run.
    """
    run = run_of(ob)
    there = [
        other
        for other in bpy.context.scene.objects
        if is_splats(other) and stored_paths.read(other, stored_paths.RUN) == str(run)
    ]
    return [o for o in there if not is_map(o)], [o for o in there if is_map(o)]


def refits_of(scene: bpy.types.Scene, run: Path) -> list[bpy.types.Object]:
    """The splats of a run that were fitted to an engine of Blender, see `viewers.refit`."""
    paths = {ob: stored_paths.read(ob, stored_paths.REFIT) for ob in scene.objects}
    return [ob for ob, path in paths.items() if path and Path(path).parent == run]


def hide_refits(ob: bpy.types.Object) -> None:
    """Hide the refitted splats of an object's run: they would be drawn over it."""
    for other in refits_of(bpy.context.scene, run_of(ob)):
        hide(other, bpy.context.scene)
        other.hide_render = True


def show_map(ob: bpy.types.Object, show: bool) -> None:
    """Show the error map of an object's run in place of its splats, or the splats again; refitted
    splats are hidden.

    Raises:
        ValueError: there is no map.
    """
    splats, maps = siblings(ob)
    if not maps:
        raise ValueError(f"There is no error map of {ob.name}; press Measure Errors.")
    hide_refits(ob)
    layer = bpy.context.view_layer
    for other, visible in [*((o, not show) for o in splats), *((o, show) for o in maps)]:
        other.hide_render = not visible
        if other.name in layer.objects:  # not in a collection that the layer excludes
            other.hide_set(not visible)
    layer.objects.active = next(
        (other for other in (maps if show else splats) if other.name in layer.objects), None
    )


@contextmanager
def splats_in_view() -> Iterator[None]:
    """Context in which the view layer shows splats in place of their error maps.

    Comparisons with photos need the splats' own colors.
    """
    layer = bpy.context.view_layer
    visible = [ob for ob in layer.objects if is_map(ob) and ob.visible_get()]
    both = {ob for shown in visible for side in siblings(shown) for ob in side}
    changed = {ob: ob.hide_get() for ob in both if ob.name in layer.objects}
    try:
        for ob in changed:
            ob.hide_set(is_map(ob))
        yield
    finally:
        for ob, hidden in changed.items():
            ob.hide_set(hidden)


def drop_maps(ob: bpy.types.Object) -> None:
    """Remove the error maps of an object's run, and show its splats again."""
    maps = siblings(ob)[1] if stored_paths.read(ob, stored_paths.RUN) else []
    if maps:
        show_map(ob, False)
    for other in maps:
        mesh = other.data
        bpy.data.objects.remove(other)
        if not mesh.users:
            bpy.data.meshes.remove(mesh)
