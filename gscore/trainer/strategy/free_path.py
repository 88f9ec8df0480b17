"""Free space around training cameras, and free path: the space between neighbouring ones, where
novel views may be.

Splats of a few centimetres next to the photographer's path are small dark leaves or faint haze for
the cameras on the other side of a yard, and a veil over the whole picture for a camera beside them.
No training camera corrects them, because none has them in its picture from nearby.
"""

import numpy as np
import torch

from ...camera_neighbours import pairs_with_views_between
from ...raster.memory import zeros
from ...scene import Cameras
from ..model.nearest_points import NearestPoints

NEAREST = 10
"""The distance of this many-th nearest point is that of the first surface, because single points
are often wrong."""
FEWEST_POINTS = 500
"""Least points for free space: fewer do not show that the space between them is empty."""
_PRODUCTS = 1 << 19
"""Distances computed per block."""


class FreeSpace:
    """Balls around cameras, in float64 because a ball may be small and far from the origin.

    A training puts splats close to cameras, because each fits a single photo or serves as a wall
    for cameras across the room. They occlude other cameras nearby. SfM points give the distance of
    the first surface.
    """

    def __init__(
        self, centers: np.ndarray, surfaces: NearestPoints | None, *, share: float
    ) -> None:
        """Compute the balls.

        Args:
            centers: [C, 3] float64 positions of cameras, any unit.
            surfaces: Surface points, same unit. None or fewer than 500: no balls.
            share: Radius of a ball relative to the distance of its camera from the tenth nearest
                point.
        """
        if share <= 0 or surfaces is None or len(surfaces) < FEWEST_POINTS:
            centers = centers[:0]
        radii = np.zeros(len(centers))
        if len(centers) and surfaces is not None:
            radii = share * surfaces.distances(centers, NEAREST)[:, -1]
        self._centers = centers
        self._radii = radii

    def contains(self, means: torch.Tensor) -> torch.Tensor:
        """Return [N] bool: `means`, [N, 3], in a ball."""
        return balls_contain(self._centers, self._radii, means)


def balls_contain(centers: np.ndarray, radii: np.ndarray, means: torch.Tensor) -> torch.Tensor:
    """Return [N] bool: `means`, [N, 3], in one of the balls with `centers`, [B, 3] float64, and
    `radii`, [B]."""
    inside = zeros(len(means), dtype=torch.bool)
    if not len(radii):
        return inside
    # |m - c|^2 < r^2 as |m|^2 + (|c|^2 - r^2 - 2 m c) < 0.
    towards = torch.from_numpy(-2 * centers.T)
    rest = torch.from_numpy(np.square(centers).sum(axis=1) - radii**2)
    rows = max(_PRODUCTS // len(radii), 1)
    for at in range(0, len(means), rows):
        part = means[at : at + rows].double()
        least = torch.addmm(rest, part, towards).amin(dim=1)
        inside[at : at + rows] = part.square().sum(dim=1) + least < 0
    return inside


_LARGER = 1.5
"""Radius of a ball on the path relative to one around a camera: splats in it are tested further."""
_SUPPORT = 2.0
"""A splat at distance d from a place on the path is supported by the training cameras that have it
in their picture at less than this many times d."""
_SUPPORTING = 3
"""Number of training cameras that must support a splat, as of points of SfM that are reliable."""
_FEWEST = 2 * _SUPPORTING
"""Least training cameras for a path: of fewer, support by those nearby cannot be expected."""
_SPACING = 0.3
"""Distance of two places on the path, in distances to the nearest points."""
_MOST_PLACES = 16
"""Most places between two cameras."""
_NARROWER = 0.5
"""A place that is closer to points than this share of both its cameras is not on the path: an
object stands between them."""


class FreePath:
    """Balls between neighbouring cameras, in which splats need the support of cameras nearby."""

    def __init__(
        self, cameras: Cameras, train: list[int], surfaces: NearestPoints | None, *, share: float
    ) -> None:
        """Find the places between the cameras.

        Args:
            cameras: Cameras of the capture, training frame.
            train: Indices of the training cameras.
            surfaces: Surface points, same frame. None or fewer than 500: no balls. Nor are there
                any with fewer than six training cameras.
            share: As in `FreeSpace`.
        """
        if share <= 0 or surfaces is None or len(surfaces) < FEWEST_POINTS or len(train) < _FEWEST:
            self.places, self.radii = np.zeros((0, 3)), np.zeros(0)
        else:
            self.places, distances = _places(cameras, train, surfaces)
            self.radii = _LARGER * share * distances
            """Radii of the balls around the places."""
        self._nearest_place = NearestPoints(self.places)
        self._cameras = cameras
        self._train = train

    def contains(self, means: torch.Tensor) -> torch.Tensor:
        """Return [N] bool: `means`, [N, 3], in a ball and without support."""
        inside = zeros(len(means), dtype=torch.bool)
        if not len(self.places):
            return inside
        low = torch.from_numpy((self.places - self.radii[:, None]).min(axis=0))
        high = torch.from_numpy((self.places + self.radii[:, None]).max(axis=0))
        rows = ((means > low) & (means < high)).all(dim=1).nonzero().flatten()
        rows = rows[balls_contain(self.places, self.radii, means[rows])]
        inside[rows] = torch.from_numpy(self._unsupported(means[rows].double().numpy()))
        return inside

    def _unsupported(self, means: np.ndarray) -> np.ndarray:
        """Return [N] bool: too few training cameras have `means`, [N, 3], in their picture from
        nearby."""
        if not len(means):
            return np.zeros(0, bool)
        near = self._nearest_place.distances(means, 1)[:, 0]
        support = np.zeros(len(means), int)
        for camera in self._train:
            support += self._in_picture(camera, means, _SUPPORT * near)
        return support < _SUPPORTING

    def _in_picture(self, camera: int, means: np.ndarray, farthest: np.ndarray) -> np.ndarray:
        """Return [N] bool: `means` in the picture of a camera, at most `farthest`, [N], away."""
        viewmat, K = self._cameras.viewmats[camera], self._cameras.Ks[camera]
        points = means @ viewmat[:3, :3].T + viewmat[:3, 3]
        pixels = points @ K.T
        sides = self._cameras.widths[camera], self._cameras.heights[camera]
        inside = (pixels[:, :2] > 0) & (pixels[:, :2] < pixels[:, 2:] * np.array(sides))
        return inside.all(axis=1) & (np.linalg.norm(points, axis=1) < farthest)


def _places(
    cameras: Cameras, train: list[int], surfaces: NearestPoints
) -> tuple[np.ndarray, np.ndarray]:
    """Places between neighbouring cameras, [P, 3], and their distances from the tenth nearest
    point, [P]; of several places close together, one."""
    centers = cameras.centers
    clear = dict(zip(train, surfaces.distances(centers[train], NEAREST)[:, -1], strict=True))
    places, ends = [], []
    for a, b in pairs_with_views_between(cameras, train):
        least = min(clear[a], clear[b])
        length = float(np.linalg.norm(centers[a] - centers[b]))
        if not 0 < length < np.inf or least <= 0:
            continue
        count = int(min(max(np.ceil(length / (_SPACING * least)), 2), _MOST_PLACES + 1))
        share = np.arange(1, count)[:, None] / count
        places.append((1 - share) * centers[a] + share * centers[b])
        ends.append(np.full(count - 1, least))
    if not places:
        return np.zeros((0, 3)), np.zeros(0)
    place, end = np.concatenate(places), np.concatenate(ends)
    distances = surfaces.distances(place, NEAREST)[:, -1]
    free = distances > _NARROWER * end
    place, distances = place[free], distances[free]
    cell = 2.0 ** np.floor(np.log2(_SPACING * distances))
    keys = np.column_stack([np.floor(place / cell[:, None]), cell])
    _, first = np.unique(keys, axis=0, return_index=True)
    return place[first], distances[first]
