"""A capture as Blender objects: cameras with their photos, SfM points, one empty that aligns them.

Everything below the empty is in the capture's own world; axes, ground and scale are the empty's
matrix alone.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from .. import stored_paths
from ..core import (
    NO_PINHOLE,
    Capture,
    ColmapCamera,
    DataConfig,
    Folder,
    GsError,
    Undistortion,
    View,
    find_capture,
    plan_undistortion,
    read_capture,
)
from ..interface import writable
from ..interface.flags import error_words, panel_words
from . import alignment, sfm_points, straightening
from . import formulas as cm
from . import objects as co
from .backgrounds import known_images, photo_of, set_photo
from .objects import cameras_of, is_camera
from .placing import UP, centers_of, set_root_matrix, size_drawings

FAR = 1e4
"""Distance of a capture from its origin, in extents, at which single precision shows."""


@dataclass(frozen=True, kw_only=True)
class ImportedCapture:
    """What `import_capture` made."""

    root: bpy.types.Object
    """The empty that carries the alignment."""
    collection: bpy.types.Collection
    """Holds everything."""
    cameras: list[bpy.types.Object]
    """By image name."""
    points: bpy.types.Object | None
    """The SfM points."""
    warnings: tuple[str, ...] = ()
    """Sentences for the user."""


def import_capture(
    scene: bpy.types.Scene,
    path: str | Path,
    *,
    images: str = "images",
    photos: bool = True,
    points: bool = True,
    align: bool = True,
    progress: Callable[[float], None] | None = None,
) -> ImportedCapture:
    """Bring a capture into the scene; nothing is made before everything has been read.

    Args:
        scene: Gets everything.
        path: A capture's folder, or a folder or file inside it.
        images: Folder of the photos in a COLMAP capture.
        photos: Put the photos into the cameras' backgrounds; Blender decodes them when drawn. Those
            of lenses that bend lines are straightened in the background, in a window.
        points: Make an object of the SfM points.
        align: Put z up and the ground at z = 0; else the empty keeps COLMAP's axes.
        progress: Told how much is done, 0 to 1.

    Raises:
        GsError: the capture cannot be read.
        ValueError: no view of it can be a Blender camera.
    """
    source = find_capture(Path(bpy.path.abspath(str(path)))).absolute()
    capture = read_capture(DataConfig(source=source, images=images), photos_required=False)
    views = sorted(capture.views, key=lambda view: view.name)
    usable = [view for view in views if view.camera.model not in NO_PINHOLE]
    if not usable:
        raise ValueError(f"{source} has only panoramas. Cut them into pinhole views with COLMAP.")
    viewmats = np.stack([view.viewmat for view in usable])
    finite = np.isfinite(capture.points.points).all(axis=1)
    cloud, colors = capture.points.points[finite], capture.points.colors[finite]
    matrix = alignment.align(viewmats, cloud, capture.up).matrix if align else np.eye(4)

    name = (source.parent if source.is_file() else source).name or "Capture"
    collection = bpy.data.collections.new(name)
    scene.collection.children.link(collection)
    root = _make_root(name, collection, source, images)
    if capture.up is not None:
        root[UP] = capture.up.tolist()
    set_root_matrix(root, matrix)
    inner = bpy.data.collections.new(f"{name} cameras")
    collection.children.link(inner)
    known, lenses = known_images(), _Lenses()
    cameras = []
    for i, view in enumerate(usable):
        stated = _stated(view, lenses.undistortion(view.camera))
        cameras.append(co.make(stated, Path(view.name).stem, root, inner))
        if photos:
            set_photo(cameras[-1], view.image, known)
        if progress is not None and i % 50 == 0:
            progress(i / len(usable))
    if photos and not bpy.app.background:
        straightening.ask(cameras)
    size_drawings(root, cameras)
    made = None
    if points and len(cloud):
        indices = np.flatnonzero(finite)
        radius = sfm_points.point_radius(cloud, centers_of(viewmats))
        made = sfm_points.create(cloud, colors, f"{name} points", collection, root, indices, radius)
        made[co.KIND] = "points"
    said = map(panel_words, capture.warnings)
    warnings = (*said, *lenses.problems, *_warnings(views, viewmats, capture))
    return ImportedCapture(
        root=root, collection=collection, cameras=cameras, points=made, warnings=warnings
    )


def use_camera(scene: bpy.types.Scene, ob: bpy.types.Object) -> list[str]:
    """Make a photo's camera the scene's, with the photo's resolution and pixel aspect.

    The resolution percentage stays. The photo of the camera used before is dropped from memory.

    Returns:
        Sentences about what Blender keeps per scene, and about a photo that is not there.

    Raises:
        ValueError: the camera is none of a photo.
    """
    if not is_camera(ob):
        raise ValueError(f"{ob.name} is no camera of a photo. Import a capture's cameras first.")
    own = co.stated(ob)
    _, frame = cm.lens_from_intrinsics(own.K, own.width, own.height)
    before = scene.camera
    scene.camera = ob
    render = scene.render
    render.resolution_x, render.resolution_y = own.width, own.height
    render.pixel_aspect_x, render.pixel_aspect_y = frame.pixel_aspect_x, frame.pixel_aspect_y
    notes = []
    aspect = frame.pixel_aspect_x / frame.pixel_aspect_y
    if abs(aspect - 1) > 1e-3:
        notes.append(
            f"fx and fy of {own.image} differ; the scene's pixel aspect is now {aspect:.4f} for it."
        )
    if not bpy.app.background:
        straightening.ask([ob])
    photo = photo_of(ob)
    if writable.keeps(ob.data):
        ob.data.show_background_images = True
    elif not ob.data.show_background_images:
        notes.append(f"The photo stays hidden. {writable.problem(ob.data)}")
    if photo is None or not Path(own.photo).is_file():
        notes.append(f"The photo {own.photo} is not there. Find the capture's folder again.")
    if before is not None and before != ob and is_camera(before):
        old = photo_of(before)
        if old is not None and old != photo and not old.is_dirty and not old.packed_file:
            old.buffers_free()
    return notes


def step_camera(scene: bpy.types.Scene, root: bpy.types.Object, step: int) -> bpy.types.Object:
    """The camera `step` photos after the scene's, around the end; without one, the first or last.

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
    """Point a capture at the folder where it is now; how many photos were found, and of how many.

    Args:
        root: The capture's empty.
        path: The capture's folder, or that of its photos.
        images: Folder of the photos in it.

    Raises:
        ValueError: none of the photos is there; nothing is changed.
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
    known = known_images()
    for ob in cameras:
        if found[ob.name] is not None:
            set_photo(ob, found[ob.name], known)
    if not bpy.app.background:
        straightening.ask(cameras)
    return sum(1 for file in found.values() if file), len(cameras)


class _Lenses:
    """The lenses of a capture, each looked at once."""

    def __init__(self) -> None:
        self.problems: list[str] = []
        """Of lenses that cannot be straightened, sentences."""
        self._known: dict[tuple, Undistortion | None] = {}

    def undistortion(self, camera: ColmapCamera) -> Undistortion | None:
        """How to straighten a camera's photos; None: they are straight, or cannot be."""
        key = (camera.model, camera.width, camera.height, *camera.params.tolist())
        if key not in self._known:
            try:
                self._known[key] = plan_undistortion(camera)
            except GsError as error:
                self._known[key] = None
                self.problems.append(
                    f"{error_words(error)} Until then its photos do not fit their cameras."
                )
        return self._known[key]


def _stated(view: View, plan: Undistortion | None) -> co.PhotoCamera:
    camera = view.camera
    seen = camera if plan is None else plan
    return co.PhotoCamera(
        image=view.name,
        photo=str(view.image),
        viewmat=view.viewmat,
        K=seen.K,
        width=seen.width,
        height=seen.height,
        model=camera.model,
        params=tuple(camera.params.tolist()),
        photo_size=None if plan is None else (camera.width, camera.height),
    )


def _make_root(
    name: str, collection: bpy.types.Collection, source: Path, images: str
) -> bpy.types.Object:
    root = bpy.data.objects.new(name, None)
    root[co.KIND], root["gs_images"] = "capture", images
    stored_paths.write(root, stored_paths.SOURCE, source)
    collection.objects.link(root)
    return root


def _warnings(views: list[View], viewmats: np.ndarray, capture: Capture) -> list[str]:
    out = []
    usable = [view for view in views if view.camera.model not in NO_PINHOLE]
    if len(usable) < len(views):
        out.append(
            f"{len(views) - len(usable)} panoramas were left out: Blender has no K for them."
        )
    Ks = np.stack([view.camera.K for view in usable])
    if np.abs(Ks[:, 1, 1] / Ks[:, 0, 0] - 1).max() > 1e-3:
        out.append(
            "fx and fy differ. Blender keeps pixel aspect per scene: choose cameras with Use "
            "Camera, which sets it."
        )
    if len({(view.camera.width, view.camera.height) for view in usable}) > 1:
        out.append(
            "The photos differ in size. Blender keeps resolution per scene: choose cameras with "
            "Use Camera, which sets it."
        )
    centers = centers_of(viewmats)
    extent = alignment.camera_extent(centers)
    if extent > 0 and np.linalg.norm(centers, axis=1).max() > FAR * extent:
        out.append(
            "The capture lies far from its origin, where Blender's single precision moves cameras "
            "visibly. Recentre the model with COLMAP's model_transformer."
        )
    return out
