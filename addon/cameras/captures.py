"""Captures of a scene: choice of cameras, and folders of photos."""

from pathlib import Path

import bpy

from .. import stored_paths
from ..core import Folder, find_capture
from ..interface import editable_check
from . import objects as co
from . import scene_camera, undistort_jobs
from .backgrounds import KnownImages, photo_of, photo_on_disk, set_photo
from .objects import cameras_of, is_camera


def use_camera(scene: bpy.types.Scene, ob: bpy.types.Object) -> list[str]:
    """Make a photo's camera the scene camera (`scene_camera.use_photo`), and show its photo.

    The photo of the previous camera is freed from memory.

    Returns:
        Sentences about changed scene settings, and about a missing photo.

    Raises:
        ValueError: the object is not a camera of a photo.
    """
    if not is_camera(ob):
        raise ValueError(f"{ob.name} is not a camera of a photo. Import a capture's cameras first.")
    before, own = scene.camera, co.photo_camera_of(ob)
    notes = scene_camera.use_photo(scene, ob)
    if not bpy.app.background:
        undistort_jobs.queue_copies([ob])
    photo = photo_of(ob)
    if editable_check.keeps(ob.data):
        ob.data.show_background_images = True
    elif not ob.data.show_background_images:
        notes.append(f"The photo stays hidden. {editable_check.problem(ob.data)}")
    if photo is None or not Path(own.photo).is_file():
        notes.append(f"The photo {own.photo} is missing. Choose its folder with Find Photos.")
    if before is not None and before != ob and is_camera(before):
        old = photo_of(before)
        if old is not None and old != photo and not old.is_dirty and not old.packed_file:
            old.buffers_free()
    return notes


def step_camera(scene: bpy.types.Scene, root: bpy.types.Object, step: int) -> bpy.types.Object:
    """The camera `step` photos after the scene's, wrapping around; without one, the first or last.

    Raises:
        ValueError: the capture has no cameras.
    """
    cameras = cameras_of(root)
    if not cameras:
        raise ValueError(f"{root.name} has no cameras left. Import the capture again.")
    if scene.camera in cameras:
        return cameras[(cameras.index(scene.camera) + step) % len(cameras)]
    return cameras[0 if step > 0 else -1]


def relink(root: bpy.types.Object, path: str | Path, images: str = "images") -> tuple[int, int]:
    """Set the current folder of a capture; returns the numbers of found and of all photos.

    Args:
        root: The capture's empty.
        path: The capture's folder, or that of its photos.
        images: Folder of the photos in it.

    Raises:
        ValueError: the folder has none of the photos; nothing is changed.
    """
    picked = Path(bpy.path.abspath(str(path))).absolute()
    source = find_capture(picked)
    places = [Folder(place) for place in (source / images, picked, source) if place.is_dir()]
    cameras = cameras_of(root)
    found = {}
    for ob in cameras:
        name = str(ob.get("gs_image", ""))
        hits = (folder.find_image(name) for folder in places)
        found[ob.name] = next((file for file in hits if file is not None), None)
    if not any(found.values()):
        raise ValueError(
            f"{picked} has none of the {len(cameras)} photos of {root.name}. Choose another folder."
        )
    stored_paths.write(root, stored_paths.SOURCE, source)
    root["gs_images"] = images
    known = KnownImages()
    for ob in cameras:
        if found[ob.name] is not None:
            set_photo(ob, photo_on_disk(co.photo_camera_of(ob), found[ob.name]), known)
    if not bpy.app.background:
        undistort_jobs.queue_copies(cameras)
    return sum(1 for file in found.values() if file), len(cameras)
