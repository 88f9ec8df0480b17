"""Observations of SfM points in each view, with their depths."""

from dataclasses import dataclass

import numpy as np

from ..config import DataConfig
from ..datasets import Dataset, read_capture
from ..datasets.tracks import model_of, tracks_of
from ..io.colmap.folder import ColmapImage, ColmapModel
from ..io.colmap.model import PointIndex
from ..transforms import SMALLEST

_LONG_TRACK = 10
"""Track length above which the weight of a point no longer grows."""


@dataclass(frozen=True, kw_only=True)
class Observations:
    """SfM points observed in one view, in the original photo (before undistortion)."""

    x: np.ndarray
    """[M] float64, px of the camera, 0 = left border."""
    y: np.ndarray
    """[M] float64, px of the camera, 0 = upper border."""
    inverse_depth: np.ndarray
    """[M] float64, 1 / camera z, 1/world unit; not positive behind the camera."""
    weights: np.ndarray
    """[M] float64, positive: reliability of a point."""
    width: int
    """Width of the camera, px."""
    height: int
    """Height of the camera, px."""

    def __len__(self) -> int:
        return len(self.x)


def observations(data: DataConfig, dataset: Dataset) -> list[Observations]:
    """Observations of the SfM points by view of `dataset`.

    Without a COLMAP model all points in the frame count, hidden ones too, so the fit must be robust
    to them.
    """
    model = model_of(dataset)
    if model is None:
        # Not the dataset's points: those may be random.
        points = read_capture(data, photos_required=False).points.points
        points = points[np.isfinite(points).all(axis=1)]
        return [_projected(dataset, points, i) for i in range(len(dataset))]
    images = {image.name: image for image in model.images}
    index = PointIndex(model.points)
    return [observed(model, images[name], index) for name in dataset.names]


def observed(model: ColmapModel, image: ColmapImage, index: PointIndex) -> Observations:
    """COLMAP's observations in one image; `index` is that of the model's points."""
    points, camera = model.points, model.cameras[image.camera_id]
    known, rows = index.find(image.point3D_ids)
    viewmat = image.viewmat
    z = points.xyz[rows] @ viewmat[2, :3] + viewmat[2, 3]
    # A long track makes the depth more accurate, a large reprojection error less.
    error = np.where(points.error[rows] >= 0, points.error[rows], 1.0)
    tracks = np.clip(points.track_lengths[rows], 2, _LONG_TRACK)
    return Observations(
        x=image.xys[known, 0],
        y=image.xys[known, 1],
        inverse_depth=_inverse(z),
        weights=tracks / (1.0 + error**2),
        width=camera.width,
        height=camera.height,
    )


@dataclass(frozen=True, kw_only=True)
class PointVisibility:
    """SfM points and their visibility."""

    points: np.ndarray
    """[P, 3] float64, world."""
    observed: list[np.ndarray]
    """Visible points of each view: [M] int64, ascending rows."""


def point_visibility(dataset: Dataset) -> PointVisibility:
    """Visibility of the SfM points in the views of `dataset`.

    Without a COLMAP model of these views, all points in a view's frame count as visible, hidden
    ones too. Random initial points are ignored.
    """
    tracks = tracks_of(dataset)
    if tracks is not None:
        return PointVisibility(
            points=tracks.points, observed=[np.unique(rows) for rows in tracks.observed]
        )
    cloud = dataset.scene.points
    points = cloud.points[:0] if cloud.made_up else cloud.points
    seen = [_in_frame(dataset, points, i) for i in range(len(dataset))]
    return PointVisibility(points=points, observed=seen)


def _in_frame(dataset: Dataset, points: np.ndarray, index: int) -> np.ndarray:
    """Rows of the points [P, 3] in the frame of a view."""
    cameras = dataset.scene.cameras
    viewmat = cameras.viewmats[index]
    x, y, z = cameras.Ks[index] @ (viewmat[:3, :3] @ points.T + viewmat[:3, 3:])
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = x / z, y / z
    inside = (z > 0) & (u >= 0) & (v >= 0)
    return np.flatnonzero(inside & (u < cameras.widths[index]) & (v < cameras.heights[index]))


def _projected(dataset: Dataset, points: np.ndarray, index: int) -> Observations:
    """Observations of all points [P, 3] in the frame of a view."""
    file, viewmat = dataset.files[index], dataset.scene.cameras.viewmats[index]
    width, height = file.photo_size
    local = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    local = local[local[:, 2] > 0]
    K = dataset.scene.cameras.Ks[index]
    pixels = (local @ K.T)[:, :2] / local[:, 2:]
    size = np.array(file.size, np.float64)
    inside = ((pixels >= 0) & (pixels < size)).all(axis=1)
    pixels, z = pixels[inside] / size, local[inside, 2]
    if file.plan is None:
        pixels = pixels * (width, height)
    else:
        camera = file.plan.camera
        pixels = file.plan.distort(pixels * (file.plan.width, file.plan.height))
        pixels = pixels * (width / camera.width, height / camera.height)
    return Observations(
        x=pixels[:, 0],
        y=pixels[:, 1],
        inverse_depth=_inverse(z),
        weights=np.ones(len(z)),
        width=width,
        height=height,
    )


def _inverse(z: np.ndarray) -> np.ndarray:
    """1 / z; 0, which counts as behind the camera, where it is too close for float32."""
    return np.divide(1.0, z, out=np.zeros_like(z), where=np.abs(z) > SMALLEST)
