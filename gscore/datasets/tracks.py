"""Tracks: observations of SfM points in each view."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import DatasetError
from ..io.colmap.folder import ColmapModel, find_model, read_model
from ..io.colmap.model import ColmapCamera, PointIndex
from ..scene import within_reach
from .dataset import Dataset
from .undistort import rays_of

_ENOUGH = 2000
"""Most points per view: more make neither its pose nor its exposure more certain, and some captures
have a hundred thousand."""


@dataclass(frozen=True, kw_only=True)
class Tracks:
    """SfM points and their observations, per view at most 2,000 with the longest tracks."""

    points: np.ndarray
    """[P, 3] float64, world units."""
    observed: list[np.ndarray]
    """Per view: [M] int64, rows of the observed `points`."""
    rays: list[np.ndarray]
    """Per view: [M, 2] float64, x / z and y / z of the observation rays, camera frame."""


def tracks_of(dataset: Dataset) -> Tracks | None:
    """Tracks of a capture; None if it has no COLMAP model of its views.

    Raises:
        FormatError: the model is corrupt.
    """
    model = model_of(dataset, most=_ENOUGH)
    if model is None:
        return None
    good = within_reach(model.points.xyz)
    images = {image.name: image for image in model.images}
    index = PointIndex(model.points)
    seen, rays = [], []
    for name in dataset.names:
        image = images[name]
        known, rows = index.find(image.point3D_ids)
        kept = good[rows]
        seen.append(rows[kept])
        rays.append(_rays(model.cameras[image.camera_id], image.xys[known][kept]))
    return Tracks(points=model.points.xyz, observed=seen, rays=rays)


def _rays(camera: ColmapCamera, pixels: np.ndarray) -> np.ndarray:
    """[M, 2]: x / z and y / z for pixels [M, 2] of the camera before undistortion."""
    if not camera.is_pinhole:
        return rays_of(camera, pixels)
    K = camera.K
    return (pixels - K[:2, 2]) / K[[0, 1], [0, 1]]


def model_of(dataset: Dataset, *, most: int | None = None) -> ColmapModel | None:
    """COLMAP model of a capture, as from `model_with`."""
    cameras = dataset.scene.cameras
    viewmats = dict(zip(dataset.names, cameras.viewmats, strict=True))
    return model_with(dataset.source, viewmats, origin=cameras.origin, most=most)


def model_with(
    source: Path,
    viewmats: Mapping[str, np.ndarray],
    *,
    origin: np.ndarray | None,
    most: int | None = None,
) -> ColmapModel | None:
    """COLMAP model of a capture if it has images of all views, with equal poses; else None.

    Poses can differ, because a transforms.json next to it, or cameras of another capture, may have
    another world.

    Args:
        source: Folder of the capture.
        viewmats: [4, 4] world to camera, by view name.
        origin: Local origin of `viewmats` and of the result, as `Cameras.origin`.
        most: As for `read_model`.

    Raises:
        FormatError: the model is corrupt.
    """
    try:
        find_model(source)
    except DatasetError:
        return None
    model = read_model(source, most=most).about(origin)
    poses = {image.name: image.viewmat for image in model.images}
    same = all(name in poses and np.allclose(poses[name], pose) for name, pose in viewmats.items())
    return model if same else None
