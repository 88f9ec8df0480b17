"""Block photos: training photos of a block, those that show enough of its cell."""

from collections.abc import Sequence

import numpy as np

from ..edit import in_frustum
from ..io.colmap.model import ColmapModel, PointIndex

MARGIN = 0.2
"""Share of a cell's extent by which it is widened to select photos, so that neighbours agree at the
seam (VastGaussian, section 4.1)."""
SHARE = 0.25
"""Least share of a photo's visible points in the widened cell (VastGaussian, section 4.1, where it
is a share of the picture)."""
_SAMPLE = 200_000
"""Most points that are projected, if a model has no observations."""


def visible_points(model: ColmapModel) -> list[np.ndarray]:
    """Per image: [M] int64, rows of the points visible in it.

    Images without tracks get all points in their frustum, ignoring occlusion.
    """
    index = PointIndex(model.points)
    step = max(1, -(-len(model.points) // _SAMPLE))
    sample = np.arange(0, len(model.points), step)
    rows = []
    for image in model.images:
        visible = np.unique(index.find(image.point3D_ids)[1])
        if not len(visible):
            camera = model.cameras[image.camera_id]
            inside = in_frustum(
                model.points.xyz[sample], camera.K, image.viewmat, camera.width, camera.height, 0.0
            )
            visible = sample[inside]
        rows.append(visible)
    return rows


def photos_per_cell(observed: Sequence[np.ndarray], around: np.ndarray, share: float) -> np.ndarray:
    """Mask [N, C] bool of the training photos of each cell.

    Args:
        observed: Per photo, rows of its visible points.
        around: [N, P] bool, points in each widened cell.
        share: Least share of a photo's points. The cell with the largest share always gets the
            photo, so that none is left out.
    """
    chosen = np.zeros((len(around), len(observed)), bool)
    for i, rows in enumerate(observed):
        if len(rows):
            parts = around[:, rows].mean(axis=1)
            chosen[:, i] = (parts >= share) | (parts == parts.max())
    return chosen
