"""Free space around cameras: splats in it are removed.

A training puts splats close to cameras, because each fits a single photo or serves as a wall for
cameras across the room. They occlude other cameras nearby. SfM points give the distance of the
first surface.
"""

import numpy as np
import torch

from ...raster.memory import zeros
from ..model.nearest_points import NearestPoints

_NEAREST = 10
"""The distance of this many-th nearest point is that of the first surface, because single points
are often wrong."""
_FEWEST_POINTS = 500
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
        if share <= 0 or surfaces is None or len(surfaces) < _FEWEST_POINTS:
            centers = centers[:0]
        radii = np.zeros(len(centers))
        if len(centers) and surfaces is not None:
            radii = share * surfaces.distances(centers, _NEAREST)[:, -1]
        # |m - c|^2 < r^2 as |m|^2 + (|c|^2 - r^2 - 2 m c) < 0.
        self._towards = torch.from_numpy(-2 * centers.T)
        self._rest = torch.from_numpy(np.square(centers).sum(axis=1) - radii**2)

    def contains(self, means: torch.Tensor) -> torch.Tensor:
        """Return [N] bool: `means`, [N, 3], in a ball."""
        inside = zeros(len(means), dtype=torch.bool)
        balls = len(self._rest)
        if balls == 0:
            return inside
        rows = max(_PRODUCTS // balls, 1)
        for at in range(0, len(means), rows):
            part = means[at : at + rows].double()
            least = torch.addmm(self._rest, part, self._towards).amin(dim=1)
            inside[at : at + rows] = part.square().sum(dim=1) + least < 0
        return inside
