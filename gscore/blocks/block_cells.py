"""Block cells: vertical cells of the world with about equal training work.

Cells divide the ground plane, as in VastGaussian (Lin et al. 2024, arXiv 2402.17427, section 4.1),
but by recursive halving of the longer side, which allows any number of cells. A block has the
photos that show enough of its cell.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..edit import in_frustum
from ..io.block_record import in_cells
from ..io.colmap.model import ColmapModel, PointIndex
from ..upright import find_up

_RIM = 0.01
"""Share of points at each end that is excluded from the extent, because of outliers."""
_UPRIGHT = 0.5
"""Least length of the mean of the cameras' up vectors for a common up direction."""


@dataclass(frozen=True, kw_only=True)
class Cells:
    """Vertical prisms that fill the world without overlap."""

    axes: np.ndarray
    """[2, 3] float64, orthonormal directions of the ground plane."""
    bounds: np.ndarray
    """[N, 2, 2] float64: lower and upper bounds of each cell along the axes, world units; infinite
    at the rim."""

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Mask [N, P] bool of the points [P, 3] in each cell; each point is in exactly one."""
        return in_cells(points, self.axes, self.bounds)

    def around(self, points: np.ndarray, margin: float) -> np.ndarray:
        """Like `contains`, for cells widened on each side by `margin` of their extent; at the rim
        the extent ends with the points."""
        ground = points @ self.axes.T
        low, high = np.quantile(ground, [_RIM, 1 - _RIM], axis=0)
        ends = np.clip(self.bounds, low, high)
        wider = margin * (ends[:, 1] - ends[:, 0])
        bounds = np.stack([self.bounds[:, 0] - wider, self.bounds[:, 1] + wider], axis=1)
        return in_cells(points, self.axes, bounds)


def make_cells(
    points: np.ndarray,
    weights: np.ndarray,
    viewmats: np.ndarray,
    count: int,
    *,
    up: np.ndarray | None = None,
) -> Cells:
    """Divide the world into cells.

    Args:
        points: [P, 3] float64, at least one.
        weights: [P], weight of each point, not negative, such as its number of observations.
        viewmats: [C, 4, 4] float64, world to camera, OpenCV axes.
        count: Number of cells, at least 1.
        up: [3], up direction stated by the capture; None: estimated from the cameras.
    """
    axes = _ground(points, viewmats, up)
    ground = points @ axes.T
    bounds: list[np.ndarray] = []
    whole = np.array([[-np.inf, -np.inf], [np.inf, np.inf]])
    _halve(ground, np.maximum(weights, 0.0) + 1e-9, whole, count, bounds)
    return Cells(axes=axes, bounds=np.stack(bounds))


def _ground(points: np.ndarray, viewmats: np.ndarray, stated: np.ndarray | None) -> np.ndarray:
    """[2, 3]: principal directions of the points in the ground plane, the larger extent first, with
    its largest component positive."""
    up = find_up(viewmats) if stated is None else stated
    agreed = stated is not None or np.linalg.norm(viewmats[:, 1, :3].mean(axis=0)) >= _UPRIGHT
    if not agreed:  # cameras in all orientations: the flattest plane is the ground
        up = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1]
    low, high = np.quantile(points, [_RIM, 1 - _RIM], axis=0)
    flat = np.clip(points, low, high)
    flat = flat - flat.mean(axis=0)
    flat = flat - np.outer(flat @ up, up)
    values, vectors = np.linalg.eigh(flat.T @ flat)
    first = vectors[:, np.argmax(values)]
    first = first - (first @ up) * up
    first = first / (np.linalg.norm(first) * np.sign(first[np.argmax(np.abs(first))]))
    return np.stack([first, np.cross(up, first)])


def _halve(
    ground: np.ndarray,
    weights: np.ndarray,
    bounds: np.ndarray,
    count: int,
    out: list[np.ndarray],
) -> None:
    """Divide `bounds` [2, 2] into `count` cells and append them to `out`; `ground` [P, 2] are the
    points inside."""
    if count == 1:
        out.append(bounds)
        return
    share = (count // 2) / count
    axis, at = _cut(ground, weights, share)
    below = ground[:, axis] < at
    for inside, part, end in ((below, count // 2, 1), (~below, count - count // 2, 0)):
        cell = bounds.copy()
        cell[end, axis] = at
        _halve(ground[inside], weights[inside], cell, part, out)


def _cut(ground: np.ndarray, weights: np.ndarray, share: float) -> tuple[int, float]:
    """Axis of the larger extent, and the position on it with `share` of the weight below."""
    if not len(ground):
        return 0, 0.0
    low, high = np.quantile(ground, [_RIM, 1 - _RIM], axis=0)
    axis = int(np.argmax(high - low))
    order = np.argsort(ground[:, axis], kind="stable")
    total = np.cumsum(weights[order])
    at = int(np.searchsorted(total, share * total[-1]))
    return axis, float(ground[order[min(at, len(order) - 1)], axis])


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
