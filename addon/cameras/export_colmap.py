"""COLMAP export of the cameras in `export_views`.

Unmoved cameras keep their observations; those of moved cameras would be wrong.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ..core import (
    ColmapCamera,
    ColmapImage,
    ColmapModel,
    GsError,
    find_colmap,
    read_colmap,
    rotmat_to_quat,
    write_colmap,
)
from ..interface.option_labels import error_text
from ..process.incremental_tasks import Check, Steps, run_in_thread
from .export_sources import ExportInputs, points_to_export, reading_inputs
from .export_views import Exported, ExportView, Tracked, all_or_none, kept_lenses


def exporting_colmap(path: str | Path, tracked: Tracked, *, binary: bool = True) -> Steps[Exported]:
    """Write cameras and points into `path`/sparse/0; photos are not copied.

    Args:
        path: Folder of the new capture.
        tracked: The cameras.
        binary: `.bin` rather than `.txt` files.

    Raises:
        GsError: a file cannot be written.
        ValueError: a camera cannot be written, or the folder has the model of a capture of the open
            file.
    """
    folder = Path(path) / "sparse" / "0"
    inputs = yield from reading_inputs(tracked)
    write = partial(_write, folder, inputs, binary)
    return (yield from run_in_thread(write, f"Writing {folder}"))


def _write(
    folder: Path,
    inputs: ExportInputs,
    binary: bool,
    check: Check,
) -> Exported:
    """Write the files; no bpy."""
    views, source = inputs.views, inputs.source
    for known in inputs.captures:
        own = _model_folder(known)
        if own is not None and own.resolve() == folder.resolve():
            raise ValueError(f"{folder} is the own model of {known}. Choose another folder.")
    if not binary and (folder / "cameras.bin").exists():
        raise ValueError(
            f"{folder} contains a binary model, which readers prefer to text. Choose another "
            "folder."
        )
    model, warnings = _source_model(source, inputs.origin)
    check()
    warnings += kept_lenses(views)
    cloud, more = points_to_export(inputs.capture_points, source, model, origin=inputs.origin)
    ids, table = _camera_table(views, model)
    images = _images(views, ids, model)
    known = {image.name: image for image in model.images} if model else {}
    stated = [(known[v.name], v) for v in views if not v.is_moved and v.name in known]
    if other := sum(not _same_pose(image, view) for image, view in stated):
        warnings.append(
            f"{other} cameras have changed in {source} since the import; they are written as "
            f"imported, without observations."
        )
    written = ColmapModel(cameras=table, images=images, points=cloud, origin=inputs.origin)
    written = written.about(None)  # other programs have no local origin
    with all_or_none(check):
        write_colmap(written, folder, binary=binary)
    return Exported.of(folder, views, cloud, [*warnings, *more])


def _model_folder(source: Path) -> Path | None:
    try:
        return find_colmap(source)[0]
    except (GsError, OSError):
        return None


def _source_model(
    source: Path | None, origin: np.ndarray | None
) -> tuple[ColmapModel | None, list[str]]:
    if source is None or _model_folder(source) is None:
        return None, []
    try:
        return read_colmap(source).about(origin), []
    except (GsError, OSError) as error:
        return None, [
            f"Observations are left out, because the capture cannot be read: {error_text(error)}"
        ]


def _camera_table(
    views: list[ExportView], model: ColmapModel | None
) -> tuple[list[int], dict[int, ColmapCamera]]:
    """Camera id of each view, and the cameras by id; equal cameras of the model are reused."""
    table: dict[int, ColmapCamera] = {}
    by_image = {image.name: image.camera_id for image in model.images} if model else {}
    known: dict[tuple, int] = {}
    free = max(model.cameras, default=0) + 1 if model else 1
    ids = []
    for view in views:
        camera = view.camera
        key = _key_of(camera)
        own = by_image.get(view.name)
        known_camera = None if model is None or own is None else model.cameras[own]
        if known_camera is not None and _key_of(known_camera) == key:
            table[own] = camera
            ids.append(own)
            continue
        if key not in known:
            known[key], free = free, free + 1
            table[known[key]] = camera
        ids.append(known[key])
    return ids, table


def _key_of(camera: ColmapCamera) -> tuple:
    return (camera.model, camera.width, camera.height, *camera.params.tolist())


def _same_pose(image: ColmapImage, view: ExportView) -> bool:
    return np.allclose(image.viewmat, view.viewmat, rtol=1e-12, atol=1e-12)


def _images(
    views: list[ExportView], camera_ids: list[int], model: ColmapModel | None
) -> list[ColmapImage]:
    """The views; unmoved ones keep the model's entries bit for bit."""
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
