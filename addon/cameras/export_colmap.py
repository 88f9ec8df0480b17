"""Blender cameras back into a COLMAP model.

What nobody touched is written as the capture states it, in float64 and with its observations; a
camera that was moved has Blender's single precision and no observations, because they no longer
hold.
"""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import bpy
import numpy as np

from .. import outcomes, stored_paths
from ..core import (
    Capture,
    ColmapCamera,
    ColmapImage,
    ColmapModel,
    ColmapPoints,
    DataConfig,
    GsError,
    find_capture,
    find_colmap,
    read_capture,
    read_colmap,
    rotmat_to_quat,
    write_colmap,
)
from ..paths import absolute
from . import formulas as cm
from . import objects as co
from . import sfm_points
from .straight import lens_of

UNKNOWN_ERROR = -1.0
"""Reprojection error of a point that COLMAP did not make, pixels."""


@dataclass(frozen=True, kw_only=True)
class ExportView:
    """A camera to write."""

    name: str
    """Image name, sub-folders with '/'."""
    photo: Path | None
    """File of the photo; None for cameras that are of none."""
    viewmat: np.ndarray
    """[4, 4] float64, world to camera, OpenCV axes."""
    camera: ColmapCamera
    """Intrinsics."""
    is_moved: bool
    """Pose or lens are Blender's, not the capture's."""
    is_lens_kept: bool = False
    """The lens is the capture's though Blender's is another, which a bent photo would not fit."""


@dataclass(frozen=True, kw_only=True)
class Exported:
    """What was written."""

    path: Path
    """Folder of the model, or the transforms file."""
    views: int
    """Cameras."""
    moved: int
    """Of these, written as they stand in Blender instead of as the capture states them."""
    points: int
    """SfM points."""
    warnings: tuple[str, ...] = ()
    """Sentences for the user."""


def export_colmap(
    path: str | Path,
    cameras: Sequence[bpy.types.Object],
    scene: bpy.types.Scene,
    *,
    root: bpy.types.Object | None = None,
    binary: bool = True,
    depsgraph: bpy.types.Depsgraph | None = None,
) -> Exported:
    """Write cameras and points into `path`/sparse/0; photos are not copied.

    Args:
        path: Folder of the new capture.
        cameras: Cameras of photos, or any perspective ones.
        scene: Gives resolution and pixel aspect of cameras that are of no photo.
        root: A capture's empty: its world is written, with its points; None: Blender's world.
        binary: `.bin` rather than `.txt` files.
        depsgraph: Gives the animated poses.

    Raises:
        GsError: a file cannot be written.
        ValueError: a camera cannot be written, or the folder is that of a capture of this file.
    """
    folder = Path(path) / "sparse" / "0"
    source = source_of(root)
    for known in known_captures():
        if _same(folder, _model_folder(known)):
            raise ValueError(f"{folder} is the own model of {known}. Choose another folder.")
    if not binary and (folder / "cameras.bin").exists():
        raise ValueError(
            f"{folder} holds a binary model, which readers prefer to text. Choose another folder."
        )
    views = collect(cameras, scene, root, depsgraph)
    model, warnings = _source_model(source)
    warnings += kept_lenses(views)
    cloud, more = points_to_export(root, source, model)
    ids, table = _camera_table(views, model)
    images = _images(views, ids, model)
    other = _restated(views, model)
    if other:
        warnings.append(
            f"{other} cameras stand elsewhere in {source} by now; they are written as "
            f"they were imported, without observations."
        )
    written = ColmapModel(cameras=table, images=images, points=cloud)
    write_colmap(written, folder, binary=binary)
    return Exported(
        path=folder,
        views=len(views),
        moved=sum(view.is_moved for view in views),
        points=len(cloud),
        warnings=(*warnings, *more),
    )


def collect(
    cameras: Sequence[bpy.types.Object],
    scene: bpy.types.Scene,
    root: bpy.types.Object | None,
    depsgraph: bpy.types.Depsgraph | None = None,
    *,
    photos: bool = True,
) -> list[ExportView]:
    """The cameras as they are to be written, with names that differ.

    Args:
        cameras: As for `export_colmap`; so are the others.
        scene: Gives resolution and pixel aspect of cameras that are of no photo.
        root: A capture's empty; None: Blender's world.
        depsgraph: Gives the animated poses.
        photos: Photos belong to them, as they were taken; else a camera whose photo is straightened
            is the pinhole camera that it is in Blender.

    Raises:
        ValueError: there are none, or one is orthographic, panoramic or sheared.
    """
    if not cameras:
        raise ValueError("There are no cameras to export. Select some, or import a capture.")
    views: list[ExportView] = []
    taken: set[str] = set()
    for ob in cameras:
        if co.is_camera(ob):
            view = _photo_view(ob, root, depsgraph, photos=photos)
        else:
            view = _plain_view(ob, scene, root, depsgraph)
        name, count = view.name, 1
        while name in taken:
            path = PurePosixPath(view.name)
            name, count = str(path.with_name(f"{path.stem}_{count}{path.suffix}")), count + 1
        taken.add(name)
        views.append(replace(view, name=name))
    return views


def points_to_export(
    root: bpy.types.Object | None, source: Path | None, model: ColmapModel | None = None
) -> tuple[ColmapPoints, list[str]]:
    """The points as they are in Blender: deleted ones left out, untouched ones exact.

    Args:
        root: The capture's empty; without one there are no points.
        source: The capture's files, if they are there.
        model: Their COLMAP model, if that has been read already.

    Returns:
        Points, with the ids of the model where they come from it, and sentences for the user.
    """
    exact = model.points if model is not None else _points_without_tracks(source)
    ob = co.points_of(root) if root is not None else None
    if ob is None:
        return (ColmapPoints.none() if exact is None else exact), []
    now = sfm_points.positions_of(ob)
    places = sfm_points.indices_of(ob)
    if exact is None:
        note = "The capture's own files are not there; points are written in single precision."
        return _new_points(now, sfm_points.colors_of(ob)), [note]
    own = (places >= 0) & (places < len(exact))
    rows = places[own]
    then = exact.xyz[rows]
    still = (now[own] == then.astype(np.float32)).all(axis=1, keepdims=True)
    kept = ColmapPoints(
        ids=exact.ids[rows],
        xyz=np.where(still, then, now[own].astype(np.float64)),
        rgb=exact.rgb[rows],
        error=exact.error[rows],
        track_lengths=exact.track_lengths[rows],
    )
    if own.all():
        return kept, []
    first = int(exact.ids.max(initial=0)) + 1
    added = _new_points(now[~own], sfm_points.colors_of(ob)[~own], first)
    return _joined(kept, added), []


def kept_lenses(views: Sequence[ExportView]) -> list[str]:
    """What to tell of lenses that are not written as they are in Blender, a sentence at most."""
    names = [view.name for view in views if view.is_lens_kept]
    if not names:
        return []
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return [
        f"The lens of {', '.join(names[:3])}{more} was changed in Blender; it is written as the "
        f"capture states it, for such photos are bent by that lens."
    ]


def _photo_view(
    ob: bpy.types.Object,
    root: bpy.types.Object | None,
    depsgraph: bpy.types.Depsgraph | None,
    *,
    photos: bool,
) -> ExportView:
    own = co.stated(ob)
    camera = lens_of(own)
    moved = root is None or co.root_of(ob) != root or co.is_moved(ob, own)
    changed = co.is_lens_changed(ob.data, own)
    kept = photos and changed and not camera.is_pinhole
    if (changed and not kept) or (own.photo_size is not None and not photos):
        _, frame = cm.lens_from_intrinsics(own.K, own.width, own.height)
        camera = _pinhole(_intrinsics(ob, frame), frame)
    return ExportView(
        name=own.image,
        photo=Path(own.photo) if own.photo else None,
        viewmat=_rigid(co.viewmat_in(ob, root, depsgraph)) if moved else own.viewmat,
        camera=camera,
        is_moved=moved or (changed and not kept),
        is_lens_kept=kept,
    )


def _plain_view(
    ob: bpy.types.Object,
    scene: bpy.types.Scene,
    root: bpy.types.Object | None,
    depsgraph: bpy.types.Depsgraph | None,
) -> ExportView:
    if ob.type != "CAMERA":
        raise ValueError(f"{ob.name} is no camera. Select cameras only.")
    frame = co.frame_of(scene)
    letters = [c if c.isalnum() or c in " ._-" else "_" for c in ob.name]
    return ExportView(
        name="".join(letters).strip(" .") + ".png",
        photo=None,
        viewmat=_rigid(co.viewmat_in(ob, root, depsgraph)),
        camera=_pinhole(_intrinsics(ob, frame), frame),
        is_moved=True,
    )


def _intrinsics(ob: bpy.types.Object, frame: cm.Frame) -> np.ndarray:
    if ob.data.type != "PERSP":
        raise ValueError(
            f"Camera {ob.name} is not perspective, which COLMAP and transforms.json have no model "
            f"for. Leave it out or change its type."
        )
    return cm.intrinsics(co.lens_of(ob.data), frame)


def _pinhole(K: np.ndarray, frame: cm.Frame) -> ColmapCamera:
    params = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])
    return ColmapCamera(model="PINHOLE", width=frame.width, height=frame.height, params=params)


def _rigid(viewmat: np.ndarray) -> np.ndarray:
    """The nearest pose with a true rotation and the same camera centre."""
    u, _, vt = np.linalg.svd(viewmat[:3, :3])
    out = np.eye(4)
    out[:3, :3] = u @ vt
    center = -np.linalg.solve(viewmat[:3, :3], viewmat[:3, 3])
    out[:3, 3] = -out[:3, :3] @ center
    return out


def source_of(root: bpy.types.Object | None) -> Path | None:
    """The capture that an empty was imported from, if it is still there."""
    text = stored_paths.read(root, stored_paths.SOURCE) if root is not None else ""
    path = Path(text)
    return path if text and path.exists() else None


def known_captures() -> list[Path]:
    """The captures of the open file that are there, imported or chosen to be trained."""
    roots = [ob for ob in bpy.data.objects if co.is_kind(ob, "capture")]
    found = [path for root in roots if (path := source_of(root)) is not None]
    for scene in bpy.data.scenes:
        for holder in outcomes.holders(scene):
            with contextlib.suppress(ValueError):  # none is chosen
                found.append(find_capture(absolute(holder.capture_path, "Capture")))
    return [path for path in dict.fromkeys(found) if path.exists()]


def _model_folder(source: Path) -> Path | None:
    try:
        return find_colmap(source)[0]
    except (GsError, OSError):
        return None


def _same(a: Path, b: Path | None) -> bool:
    return b is not None and a.resolve() == b.resolve()


def _source_model(source: Path | None) -> tuple[ColmapModel | None, list[str]]:
    if source is None or _model_folder(source) is None:
        return None, []
    try:
        return read_colmap(source), []
    except (GsError, OSError) as error:
        return None, [f"Observations are left out, for the capture cannot be read: {error}"]


def _points_without_tracks(source: Path | None) -> ColmapPoints | None:
    """Points of a capture without a COLMAP model, in float64."""
    if source is None:
        return None
    try:
        capture: Capture = read_capture(DataConfig(source=source), photos_required=False)
    except (GsError, OSError):
        return None
    return _new_points(capture.points.points, capture.points.colors)


def _new_points(xyz: np.ndarray, rgb: np.ndarray, first: int = 1) -> ColmapPoints:
    count = len(xyz)
    return ColmapPoints(
        ids=np.arange(first, first + count, dtype=np.int64),
        xyz=np.asarray(xyz, np.float64).reshape(-1, 3),
        rgb=rgb,
        error=np.full(count, UNKNOWN_ERROR),
        track_lengths=np.zeros(count, np.int32),
    )


def _joined(a: ColmapPoints, b: ColmapPoints) -> ColmapPoints:
    return ColmapPoints(
        ids=np.concatenate([a.ids, b.ids]),
        xyz=np.concatenate([a.xyz, b.xyz]),
        rgb=np.concatenate([a.rgb, b.rgb]),
        error=np.concatenate([a.error, b.error]),
        track_lengths=np.concatenate([a.track_lengths, b.track_lengths]),
    )


def _restated(views: list[ExportView], model: ColmapModel | None) -> int:
    """Number of untouched cameras that the capture's files state differently by now."""
    known = {image.name: image for image in model.images} if model else {}
    pairs = [(known[v.name], v) for v in views if not v.is_moved and v.name in known]
    return sum(1 for image, view in pairs if not _same_pose(image, view))


def _camera_table(
    views: list[ExportView], model: ColmapModel | None
) -> tuple[list[int], dict[int, ColmapCamera]]:
    """Camera id of each view, and the cameras: those of the model where they are the same."""
    table: dict[int, ColmapCamera] = {}
    by_image = {image.name: image.camera_id for image in model.images} if model else {}
    known: dict[tuple, int] = {}
    free = max(model.cameras, default=0) + 1 if model else 1
    ids = []
    for view in views:
        camera = view.camera
        key = (camera.model, camera.width, camera.height, camera.params.tobytes())
        own = by_image.get(view.name)
        if model and own is not None and _equal(model.cameras[own], camera):
            table[own] = camera
            ids.append(own)
            continue
        if key not in known:
            known[key], free = free, free + 1
            table[known[key]] = camera
        ids.append(known[key])
    return ids, table


def _equal(a: ColmapCamera, b: ColmapCamera) -> bool:
    return (a.model, a.width, a.height) == (b.model, b.width, b.height) and np.array_equal(
        a.params, b.params
    )


def _same_pose(image: ColmapImage, view: ExportView) -> bool:
    return np.allclose(image.viewmat, view.viewmat, rtol=1e-12, atol=1e-12)


def _images(
    views: list[ExportView], camera_ids: list[int], model: ColmapModel | None
) -> list[ColmapImage]:
    """The views; what the model says of one that nobody touched is kept to the last bit."""
    known = {image.name: image for image in model.images} if model else {}
    free = max((image.id for image in known.values()), default=0) + 1
    images = []
    for view, camera_id in zip(views, camera_ids, strict=True):
        own = known.get(view.name)
        if own is not None and not view.is_moved and _same_pose(own, view):
            images.append(replace(own, camera_id=camera_id))
            continue
        if own is None:
            image_id, free = free, free + 1
        else:
            image_id = own.id
        images.append(
            ColmapImage(
                id=image_id,
                name=view.name,
                camera_id=camera_id,
                qvec=rotmat_to_quat(view.viewmat[:3, :3]),
                tvec=view.viewmat[:3, 3].copy(),
                xys=np.zeros((0, 2)),
                point3D_ids=np.zeros(0, np.int64),
            )
        )
    order = {name: i for i, name in enumerate(known)}
    return sorted(images, key=lambda image: order.get(image.name, len(order)))  # as in the model
