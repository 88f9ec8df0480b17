"""Block photos: the training photos of a block, those that show enough of its cell."""

from collections.abc import Sequence

import numpy as np

from ..edit import in_frustum
from ..io.colmap.model import ColmapModel, PointIndex

MARGIN = 0.2
"""Share of a cell's extent by which it is widened to choose photos: what is just outside is
trained too, so that neighbours agree at the seam (VastGaussian, section 4.1)."""
SHARE = 0.25
"""Least share of what a photo shows that lies in the wider cell (VastGaussian, section 4.1, where
it is a share of the picture)."""
_SAMPLE = 200_000
"""Points that are projected at most, where a model does not say what each photo shows."""


def visible_points(model: ColmapModel) -> list[np.ndarray]:
    """By image: [M] int64, rows of the points that it shows.

    Where a model has no tracks of an image, those that fall into its picture: what is hidden
    behind something else is not known then.
    """
    index = PointIndex(model.points)
    step = max(1, -(-len(model.points) // _SAMPLE))
    sample = np.arange(0, len(model.points), step)
    rows = []
    for image in model.images:
        found = np.unique(index.find(image.point3D_ids)[1])
        if not len(found):
            camera = model.cameras[image.camera_id]
            inside = in_frustum(
                model.points.xyz[sample], camera.K, image.viewmat, camera.width, camera.height, 0.0
            )
            found = sample[inside]
        rows.append(found)
    return rows


def photos_per_cell(seen: Sequence[np.ndarray], around: np.ndarray, share: float) -> np.ndarray:
    """[N, C] bool: which cell is trained on which photo.

    Args:
        seen: By photo, rows of the points that it shows.
        around: [N, P] bool, which wider cell holds which point.
        share: Least share of its points. The cell of which a photo shows most always has it, so
            that no photo is left out.
    """
    chosen = np.zeros((len(around), len(seen)), bool)
    for i, rows in enumerate(seen):
        if len(rows):
            parts = around[:, rows].mean(axis=1)
            chosen[:, i] = (parts >= share) | (parts == parts.max())
    return chosen
