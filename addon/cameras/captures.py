"""Captures of a scene: choice of cameras, folders of photos, and their display; selection of
imported objects.
"""

from pathlib import Path

import bpy

from .. import stored_paths
from ..core import Folder, find_capture
from ..interface import editable_check, framing
from ..interface.base_operator import make_active_in
from . import objects as co
from . import scene_camera, undistort_jobs
from .backgrounds import KnownImages, photo_of, photo_on_disk, set_photo
from .capture_transform import frame_capture
from .importing import ImportedCapture
from .lookup import panel_root
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


def choose(scene: bpy.types.Scene, made: ImportedCapture, *, set_up_views: bool = True) -> None:
    """Select and frame an imported capture; the scene need not be shown in a window.

    Args:
        scene: The scene.
        made: The imported capture.
        set_up_views: Show the points' colors in the 3D views of the scene's windows, and frame a
            new capture there.
    """
    activate(scene, made.root)
    if set_up_views:
        for space in framing.views_of(scene) if made.renewed else frame_capture(scene, made.root):
            space.shading.color_type = "VERTEX"
            space.shading.show_object_outline = False  # it would cover the small points
            space.overlay.show_relationship_lines = False
    settings = scene.gscore
    if not settings.capture_path.strip():
        settings.capture_path = made.root[stored_paths.SOURCE]
        settings.images = made.root["gs_images"]


def activate(scene: bpy.types.Scene, ob: bpy.types.Object) -> None:
    """Select only one object and make it active, in a scene that need not be shown in a window.

    Does nothing if the view layer excludes it, or while the user edits or paints another object,
    because Blender could then not leave that mode.
    """
    if bpy.context.scene == scene:
        layers = [bpy.context.view_layer]
    else:
        windows = bpy.context.window_manager.windows
        layers = [w.view_layer for w in windows if w.scene == scene] or [scene.view_layers[0]]
    layer, active = layers[0], layers[0].objects.active
    if layer.objects.get(ob.name) == ob and (active is None or active.mode == "OBJECT"):
        make_active_in(layer, ob)


def _cameras(scene: bpy.types.Scene) -> list[bpy.types.Camera]:
    """Camera data of the sidebar's capture, of cameras with a photo."""
    root = panel_root(scene)
    obs = [] if root is None else cameras_of(root)
    return [ob.data for ob in obs if ob.data.background_images]


def changeable(scene: bpy.types.Scene) -> list[bpy.types.Camera]:
    """Cameras whose photos can be shown, hidden and faded: linked ones are left out."""
    return list(filter(editable_check.keeps, _cameras(scene)))


def show_photos(scene: bpy.types.Scene, shown: bool) -> None:
    """Show or hide the photos of the sidebar's capture; other captures stay unchanged."""
    for camera in changeable(scene):
        camera.show_background_images = shown


def _get_opacity(self: "PhotoSettings") -> float:
    camera = next(iter(_cameras(self.id_data)), None)
    return 1.0 if camera is None else camera.background_images[0].alpha


def _set_opacity(self: "PhotoSettings", opacity: float) -> None:
    for camera in changeable(self.id_data):
        camera.background_images[0].alpha = opacity


class PhotoSettings(bpy.types.PropertyGroup):
    """`Scene.gscore_photos`; the cameras store the values, so that they cannot disagree."""

    shown: bpy.props.BoolProperty(
        name="Show Photos",
        description="Show the capture's photos behind their cameras",
        get=lambda self: any(one.show_background_images for one in _cameras(self.id_data)),
        set=lambda self, shown: show_photos(self.id_data, shown),
    )
    opacity: bpy.props.FloatProperty(
        name="Opacity",
        description="Opacity of the photos; below 1 the scene behind them shows through",
        subtype="FACTOR",
        min=0.0,
        max=1.0,
        get=_get_opacity,
        set=_set_opacity,
    )


PROPERTIES = ((bpy.types.Scene, "gscore_photos", bpy.props.PointerProperty(type=PhotoSettings)),)
