"""Implicit surface through splats: oriented normals and radial basis functions; numpy only."""

import numpy as np

from ..splats import Splats, sigmoid
from ..transforms import quat_to_rotmat

_NEAR = 16
"""Neighbours whose shapes and positions give a normal."""
_RIDGE = {1: -1.0, 3: 1.0}
"""Smoothing by the exponent of a field, on the diagonal of its matrix. The kernel of exponent 1 is
conditionally negative definite. Trained splats are noisy: a hundredth of it halves the accuracy of
the surface in a hole of plush."""
_STEP, _FLATTEST = 0.25, 0.01
"""Longest step of Newton's method, and the least square of the gradient that it assumes."""
_BLOCK = 1 << 18
"""Distances per block."""


def farthest_points(points: np.ndarray, count: int, *, gap: float = 0.0) -> np.ndarray:
    """Indices [K] of points [N, 3], each the farthest from those before it, starting with the first
    (Gonzalez 1985).

    Args:
        points: [N, 3], at least one.
        count: Most indices.
        gap: Stop when the farthest is closer than this.
    """
    rows = [0]
    left = ((points - points[0]) ** 2).sum(axis=1)
    while len(rows) < count:
        farthest = int(left.argmax())
        if left[farthest] <= gap * gap:
            break
        rows.append(farthest)
        left = np.minimum(left, ((points - points[farthest]) ** 2).sum(axis=1))
    return np.array(rows)


def nearest(points: np.ndarray, others: np.ndarray, count: int = 1) -> tuple[np.ndarray, ...]:
    """Distances and indices, [N, count] each and unordered, of the `count` nearest of the others
    [M, 3] to points [N, 3]; `count` is at most M."""
    squares = (others * others).sum(axis=1)
    distances = np.empty((len(points), count))
    rows = np.empty((len(points), count), np.int64)
    at = 0
    for some in _blocks(points, len(others)):
        found = squares - 2 * (some @ others.T)
        if count == 1:
            near = found.argmin(axis=1)[:, None]
        else:
            near = np.argpartition(found, count - 1, axis=1)[:, :count]
        end = at + len(some)
        rows[at:end] = near
        distances[at:end] = np.linalg.norm(some[:, None] - others[near], axis=2)
        at = end
    return distances, rows


class Field:
    """Smooth function of space through values at points: radial basis functions and a linear part,
    which reproduces linear functions exactly (Carr et al. 2001)."""

    def __init__(self, points: np.ndarray, values: np.ndarray, *, power: int) -> None:
        """Fit.

        Args:
            points: [P, 3], at least 4 that are not in one plane, about -1 to 1.
            values: [P, C].
            power: Exponent of the distance: 1 is biharmonic, 3 triharmonic and smoother.
        """
        self._points, self._power = points, power
        count = len(points)
        matrix = np.zeros((count + 4, count + 4))
        matrix[:count, :count] = self._kernel(points)
        matrix[range(count), range(count)] += _RIDGE[power]
        matrix[:count, count:] = np.pad(points, ((0, 0), (1, 0)), constant_values=1)
        matrix[count:, :count] = matrix[:count, count:].T
        # Points in one plane leave the slope across it open: the least one.
        matrix[count:, count:] = -1e-9 * np.eye(4)
        right = np.pad(values, ((0, 4), (0, 0)))
        solved = np.linalg.solve(matrix, right)
        self._weights, self._linear = solved[:count], solved[count:]

    def _squares(self, points: np.ndarray) -> np.ndarray:
        squares = (points * points).sum(axis=1)[:, None] + (self._points**2).sum(axis=1)
        squares -= 2 * (points @ self._points.T)
        return np.maximum(squares, 0, out=squares)

    def _kernel(self, points: np.ndarray) -> np.ndarray:
        squares = self._squares(points)
        distances = np.sqrt(squares)
        return distances if self._power == 1 else distances * squares

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Values [N, C] at points [N, 3]."""
        out = [self._kernel(some) @ self._weights for some in _blocks(points, len(self._points))]
        return np.concatenate(out) + self._linear[0] + points @ self._linear[1:]

    def slopes(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First value [N] and its gradient [N, 3] at points [N, 3], of power 3: the derivative of
        |x - p|^3 is 3 |x - p| (x - p)."""
        values, gradients = [], []
        for some in _blocks(points, len(self._points)):
            squares = self._squares(some)
            shares = np.sqrt(squares)
            shares *= self._weights[:, 0]
            values.append(np.einsum("np,np->n", shares, squares))
            gradients.append(3 * (shares.sum(axis=1)[:, None] * some - shares @ self._points))
        linear = self._linear[:, 0]
        return (
            np.concatenate(values) + linear[0] + points @ linear[1:],
            np.concatenate(gradients) + linear[1:],
        )

    def onto(self, points: np.ndarray, level: np.ndarray | float, rounds: int) -> np.ndarray:
        """Points [N, 3] moved along the gradient to a level of the first value, [N] or one, by
        Newton's method with short steps."""
        points = points.copy()
        for _ in range(rounds):
            values, slope = self.slopes(points)
            off = (values - level) / np.maximum((slope * slope).sum(axis=1), _FLATTEST)
            move = off[:, None] * slope
            length = np.linalg.norm(move, axis=1, keepdims=True)
            points -= move * np.minimum(1, _STEP / np.maximum(length, _STEP))
        return points


def _blocks(points: np.ndarray, width: int) -> list[np.ndarray]:
    """Parts of points [N, 3] whose distances to `width` others fit the cache; at least one."""
    return np.array_split(points, -(-len(points) * width // _BLOCK) or 1)


def surface_through(splats: Splats, *, centers: int) -> tuple[Field, np.ndarray, float]:
    """Signed distance to a smooth surface through splats, by radial basis functions at some of them
    and at points beside these along their normals.

    Args:
        splats: Opaque splats of the surface, about in [-1, 1]^3, more than `_NEAR`.
        centers: Most splats that are used.

    Returns:
        The distance, whose sign is arbitrary; the indices of the splats that are used; and the
        spacing of splats on the surface.
    """
    means = splats.means.astype(np.float64)
    some = farthest_points(means, centers)
    distances, near = nearest(means[some], means, _NEAR)
    reach = distances.max(axis=1)
    # A disc of radius r has `_NEAR` splats at a spacing of r sqrt(pi / _NEAR).
    spacing = float(np.median(reach)) * np.sqrt(np.pi / _NEAR)
    middles, normals = _planes(splats, near)
    places = means[some]
    places += ((middles - places) * normals).sum(axis=1)[:, None] * normals
    normals = _oriented(places, normals)
    points, values = [places], [np.zeros(len(places))]
    for side in (spacing, -spacing):
        beside = places + side * normals
        own = nearest(beside, places)[1][:, 0] == np.arange(len(places))  # else on another surface
        points.append(beside[own])
        values.append(np.full(int(own.sum()), side))
    field = Field(np.concatenate(points), np.concatenate(values)[:, None], power=3)
    return field, some, spacing


def _planes(splats: Splats, near: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle [K, 3] and unit normal [K, 3] of the plane through the splats `near` [K, 16]: least
    axis of their joint covariance."""
    means = splats.means.astype(np.float64)
    axes = quat_to_rotmat(splats.quats.astype(np.float64)) * np.exp(
        splats.scales.astype(np.float64)[:, None, :]
    )
    own = axes @ axes.transpose(0, 2, 1)
    weights = sigmoid(splats.opacities)[near].astype(np.float64)
    weights /= weights.sum(axis=1, keepdims=True)
    middles = np.einsum("kn,kni->ki", weights, means[near])
    off = means[near] - middles[:, None]
    spread = np.einsum("kn,kni,knj->kij", weights, off, off)
    spread += np.einsum("kn,knij->kij", weights, own[near])
    return middles, np.linalg.eigh(spread)[1][:, :, 0]


def _oriented(places: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Normals [K, 3] with consistent signs, along the spanning tree of near and parallel ones
    (Hoppe et al. 1992)."""
    count = len(places)
    squares = (places * places).sum(axis=1)
    gaps = np.sqrt(np.maximum(squares[:, None] + squares - 2 * (places @ places.T), 0))
    agree = normals @ normals.T
    costs = gaps * (1.1 - np.abs(agree))
    signs, joined = np.ones(count), np.zeros(count, bool)
    best, parent = costs[0].copy(), np.zeros(count, np.int64)
    joined[0] = True
    for _ in range(count - 1):
        row = int(np.where(joined, np.inf, best).argmin())
        joined[row] = True
        signs[row] = signs[parent[row]] * (1 if agree[row, parent[row]] >= 0 else -1)
        closer = costs[row] < best
        best[closer], parent[closer] = costs[row][closer], row
    return normals * signs[:, None]
