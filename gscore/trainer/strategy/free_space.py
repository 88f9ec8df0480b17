"""Free space around cameras: splats in it are removed.

A training puts splats close to cameras, because each fits a single photo or serves as a wall for
cameras across the room. They occlude other cameras nearby. SfM points give the distance of the
first surface.
"""

import numpy as np
import torch

from ...raster.memory import zeros
from ..model.nearest_points import NearestPoints

NEAREST = 10
"""The distance of this many-th nearest point is that of the first surface, because single points
are often wrong."""
FEWEST_POINTS = 500
"""Least points for free space: fewer do not show that the space between them is empty."""
_PRODUCTS = 1 << 19
"""Distances computed per block."""


class FreeSpace:
    """Balls around cameras, in float64 because a ball may be small and far from the origin."""

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
