"""Block cells: upright cells of the world with about equal training work in each.

Cells are cut along the ground, as VastGaussian (Lin et al. 2024, arXiv 2402.17427, section 4.1)
does; by recursive halving of the longer side, so that any number of cells comes out.
"""

from dataclasses import dataclass

import numpy as np

from ..io.block_record import in_cells
from ..upright import find_up

_RIM = 0.01
"""Share of the points beyond each end that does not count as the extent: strays lie far away."""
_UPRIGHT = 0.5
"""Length of the mean of the cameras' upward directions from which they agree on one."""


@dataclass(frozen=True, kw_only=True)
class Cells:
    """Upright prisms that fill the world without overlap."""

    axes: np.ndarray
    """[2, 3] float64, two directions along the ground, of length 1, at right angles."""
    bounds: np.ndarray
    """[N, 2, 2] float64: of each cell the lower ends and the upper ends along the axes, world
    units; infinite at the rim."""

    def holding(self, points: np.ndarray) -> np.ndarray:
        """[N, P] bool: which cell holds which of the points [P, 3]; each is in one alone."""
        return in_cells(points, self.axes, self.bounds)

    def around(self, points: np.ndarray, margin: float) -> np.ndarray:
        """As `holding`, with cells that are larger on each side by `margin` of their extent,
        which at the rim ends where the points do."""
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
    """Cut the world.

    Args:
        points: [P, 3] float64, at least one.
        weights: [P] how much each point counts, not negative; points seen often are worth more.
        viewmats: [C, 4, 4] float64, world to camera, OpenCV axes.
        count: Number of cells, at least 1.
        up: [3], up in the world where the capture states it; None: the cameras say what is up.
    """
    axes = _ground(points, viewmats, up)
    ground = points @ axes.T
    bounds: list[np.ndarray] = []
    whole = np.array([[-np.inf, -np.inf], [np.inf, np.inf]])
    _halve(ground, np.maximum(weights, 0.0) + 1e-9, whole, count, bounds)
    return Cells(axes=axes, bounds=np.stack(bounds))


def _ground(points: np.ndarray, viewmats: np.ndarray, stated: np.ndarray | None) -> np.ndarray:
    """[2, 3]: the directions along the ground in which the points reach farthest and least far, the
    first one so that the largest of its numbers is positive."""
    up = find_up(viewmats) if stated is None else stated
    agreed = stated is not None or np.linalg.norm(viewmats[:, 1, :3].mean(axis=0)) >= _UPRIGHT
    if not agreed:  # cameras all around, or turned at will: what is flat is the ground
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
    """Add the bounds of `count` cells that `bounds` [2, 2] is cut into, of which `ground` [P, 2]
    are the points inside."""
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
    """The axis along which points reach farther, and the place with `share` of them below it."""
    if not len(ground):
        return 0, 0.0
    low, high = np.quantile(ground, [_RIM, 1 - _RIM], axis=0)
    axis = int(np.argmax(high - low))
    order = np.argsort(ground[:, axis], kind="stable")
    total = np.cumsum(weights[order])
    at = int(np.searchsorted(total, share * total[-1]))
    return axis, float(ground[order[min(at, len(order) - 1)], axis])
