"""Lookup of the capture and the camera of an operator, and the base of operators on a capture."""

from pathlib import Path

import bpy
from bpy.props import StringProperty

from .. import stored_paths
from ..capture.folders import means_capture
from ..core import read_run
from ..interface.base_operator import Undoable
from ..paths import absolute
from . import objects as co


class OnCapture(Undoable):
    """Base of operators on a capture's empty."""

    capture: StringProperty(
        name="Capture",
        description="Name of the capture's empty; empty: the capture of the active object, of the "
        "scene camera, or the only one",
        options={"SKIP_SAVE"},
    )


def find_root(context: bpy.types.Context, name: str = "") -> bpy.types.Object:
    """The capture by name, else the active or chosen one, else the only one.

    Raises:
        ValueError: there is none, or several are possible.
    """
    if name:
        root = co.root_of(bpy.data.objects.get(name))
        if root is None:
            raise ValueError(f"There is no capture called {name}. Import one with Import Cameras.")
        return root
    active = getattr(context, "active_object", None)
    for ob in (active, chosen_root(context.scene), context.scene.camera):
        if (root := co.root_of(ob)) is not None:
            return root
    roots = roots_of(context.scene)
    if len(roots) != 1:
        few = "No capture is imported. Use Import Cameras first."
        many = "There are several captures. Select an object of one of them."
        raise ValueError(many if roots else few)
    return roots[0]


def chosen_root(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The empty of the capture that is chosen in the panel, if it was imported.

    Without an exact match, a capture imported from a folder of the same name that no longer exists
    counts as moved to the chosen one.
    """
    try:
        chosen = absolute(scene.gscore.capture_path, "Capture")
    except ValueError:
        return None
    exact = root_from(scene, chosen)
    if exact is not None:
        return exact
    for root in roots_of(scene):
        source = Path(stored_paths.read(root, stored_paths.SOURCE))
        if source.name and source.name in chosen.parts[-3:] and not source.exists():
            return root
    return None


def root_from(scene: bpy.types.Scene, chosen: Path) -> bpy.types.Object | None:
    """The empty of the capture in a folder or one of its parents, if it was imported."""
    for root in roots_of(scene):
        if means_capture(chosen, Path(stored_paths.read(root, stored_paths.SOURCE))):
            return root
    return None


def root_of_run(scene: bpy.types.Scene, splats: Path) -> bpy.types.Object | None:
    """The empty of the capture that a splat file in a run's folder was trained on, if it was
    imported."""
    run = read_run(absolute(str(splats), "File").parent) if roots_of(scene) else None
    return None if run is None or run.data is None else root_from(scene, run.data.source)


def panel_root(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The empty of the sidebar's capture: the chosen one, else the first."""
    if scene.gscore.capture_path.strip():
        return chosen_root(scene)
    return next(iter(roots_of(scene)), None)


def roots_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The empties of all captures in a scene."""
    # With 30,000 other objects this takes 6 ms; with `is_kind`, or the type first, 24 ms.
    return [ob for ob in scene.objects if ob.get(co.KIND) == "capture" and ob.type == "EMPTY"]


def find_camera(
    context: bpy.types.Context, root: bpy.types.Object, name: str = "", index: int = -1
) -> bpy.types.Object:
    """A photo's camera by object or image name, else by index, else the active one.

    Raises:
        ValueError: there is no such camera.
    """
    listed = co.cameras_of(root)
    if name:
        hits = [ob for ob in listed if name in (ob.name, ob.get("gs_image"))]
        hits += [ob for ob in listed if Path(str(ob.get("gs_image"))).stem == name]
        if not hits:
            raise ValueError(f"The capture has no camera or photo called {name}.")
        return hits[0]
    if index >= 0:
        if index >= len(listed):
            raise ValueError(f"There is no camera {index}; they go from 0 to {len(listed) - 1}.")
        return listed[index]
    for ob in (getattr(context, "active_object", None), context.scene.camera, *listed[:1]):
        if co.is_camera(ob) and co.root_of(ob) == root:
            return ob
    raise ValueError(f"{root.name} has no cameras left. Import the capture again.")
