"""Which points of structure from motion were seen in which views."""

from dataclasses import dataclass

import numpy as np

from ..errors import DatasetError
from ..io.colmap import ColmapModel, find_model, read_model
from ..io.colmap_model import PointIndex
from ..scene import within_reach
from .dataset import Dataset


@dataclass(frozen=True, kw_only=True)
class Tracks:
    """The points that structure from motion found, and where it saw them."""

    points: np.ndarray
    """[P, 3] float64, world units."""
    seen: list[np.ndarray]
    """By view: [M] int64, rows of `points` that were seen there."""
    at: list[np.ndarray]
    """By view: [M, 2] float64, where, in pixels of the camera before undistortion."""


def tracks_of(dataset: Dataset) -> Tracks | None:
    """The tracks of a capture; None where it keeps none: it has no COLMAP model of its views.

    Raises:
        FormatError: the model is corrupt.
    """
    model = model_of(dataset)
    if model is None:
        return None
    good = within_reach(model.points.xyz)
    images = {image.name: image for image in model.images}
    index = PointIndex(model.points)
    seen, at = [], []
    for name in dataset.names:
        image = images[name]
        known, rows = index.find(image.point3D_ids)
        kept = good[rows]
        seen.append(rows[kept])
        at.append(image.xys[known][kept])
    return Tracks(points=model.points.xyz, seen=seen, at=at)


def model_of(dataset: Dataset) -> ColmapModel | None:
    """The COLMAP model of a capture if its images are the views, and stand where these do.

    A transforms.json beside it, or cameras of another capture, may be of another world.

    Raises:
        FormatError: the model is corrupt.
    """
    try:
        find_model(dataset.source)
    except DatasetError:
        return None
    model = read_model(dataset.source)
    poses = {image.name: image.viewmat for image in model.images}
    views = zip(dataset.names, dataset.scene.cameras.viewmats, strict=True)
    same = all(name in poses and np.allclose(poses[name], pose) for name, pose in views)
    return model if same else None
