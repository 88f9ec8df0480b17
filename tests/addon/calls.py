"""Imports and exports of the add-on in one call instead of steps."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy

from addon.cameras.camera_path import CAMERAS, exporting_path
from addon.cameras.camera_path_import import ImportedPath, importing_path
from addon.cameras.export_colmap import exporting_colmap
from addon.cameras.export_transforms import exporting_transforms
from addon.cameras.export_views import Exported, Tracked
from addon.cameras.importing import ImportedCapture, importing
from addon.compat import matrix_to_numpy
from addon.core import Splats
from addon.interface.incremental_removal import finish
from addon.process.incremental_tasks import run_blocking
from addon.splats import objects
from addon.splats.exporting import SOURCE, Written, exporting
from addon.splats.importing import importing_splats
from addon.splats.splat_files import import_request
from addon.timeline.frames import Series
from addon.timeline.operators import importing_sequence


def import_capture(scene: bpy.types.Scene, path: str | Path, **options: Any) -> ImportedCapture:
    """Import a capture; arguments as `importing`."""
    try:
        return run_blocking(importing(scene, path, **options))
    finally:
        finish()


def import_path(path: str | Path, scene: bpy.types.Scene, **options: Any) -> ImportedPath:
    """Import a camera path; arguments as `importing_path`."""
    return run_blocking(importing_path(path, scene, **options))


def import_splats(context: bpy.types.Context, path: str | Path, **options: Any) -> bpy.types.Object:
    """Import a splat file; options as `import_request`."""
    return run_blocking(importing_splats(context, [import_request(path, **options)])).objects[0]


def import_sequence(
    context: bpy.types.Context, folder: Path, **options: Any
) -> tuple[bpy.types.Object, Series]:
    """Import a folder of frames; options as `importing_sequence`."""
    ob, series, _ = run_blocking(importing_sequence(context, folder, **options))
    return ob, series


def export_splats(
    obs: Sequence[bpy.types.Object],
    path: str | Path,
    *,
    world: str = SOURCE,
    filtered: bool = False,
) -> Written:
    """Export splats; arguments as `exporting`."""
    return run_blocking(exporting(obs, path, world=world, filtered=filtered))


def export_path(
    path: str | Path,
    camera: bpy.types.Object,
    scene: bpy.types.Scene,
    *,
    root: bpy.types.Object | None = None,
    kind: str = CAMERAS,
) -> int:
    """Export a camera path; arguments as `exporting_path`."""
    return run_blocking(exporting_path(path, camera, scene, root=root, kind=kind))


def export_colmap(
    path: str | Path,
    cameras: Sequence[bpy.types.Object],
    scene: bpy.types.Scene,
    *,
    root: bpy.types.Object | None = None,
    depsgraph: bpy.types.Depsgraph | None = None,
    binary: bool = True,
) -> Exported:
    """Export a COLMAP model; arguments as `exporting_colmap` and `Tracked`."""
    tracked = Tracked(cameras, scene, root, lambda: depsgraph)
    return run_blocking(exporting_colmap(path, tracked, binary=binary))


def export_transforms(
    path: str | Path,
    cameras: Sequence[bpy.types.Object],
    scene: bpy.types.Scene,
    *,
    root: bpy.types.Object | None = None,
    depsgraph: bpy.types.Depsgraph | None = None,
) -> Exported:
    """Export a transforms.json; arguments as `exporting_transforms` and `Tracked`."""
    tracked = Tracked(cameras, scene, root, lambda: depsgraph)
    return run_blocking(exporting_transforms(path, tracked))


def read_world(ob: bpy.types.Object) -> Splats:
    """The splats of an object in Blender's world."""
    matrix = matrix_to_numpy(ob.matrix_world)
    return objects.moved(objects.read(ob), matrix, ob.name)
