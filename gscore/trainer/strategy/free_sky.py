"""Free sky: the space between the cameras and the sky of their photos.

A photo that shows the sky shows that nothing is in front of it. Splats there are sky that a single
photo explains, which other views show as clouds beside the scene.
"""

import numpy as np
import torch

from ...raster.memory import zeros
from ...sampling import evenly_spaced
from ...scene import Cameras
from ..photos.sky import BEYOND
from ..photos.sky_search import Sky

_FEWEST = 2
"""Least photos whose sky a splat covers, as single ones may be wrong."""
_MOST_PHOTOS = 30
"""Most photos with sky that are used, evenly spaced: a splat there is in front of many."""


class FreeSky:
    """Positions that lie in front of the sky in several photos."""

    def __init__(self, sky: Sky, cameras: Cameras, middle: np.ndarray, radius: float):
        """Create the space.

        Args:
            sky: The sky of the capture.
            cameras: Cameras of the capture, training frame.
            middle: [3] float64 centre of the splats of the sky.
            radius: Their distance from it.
        """
        self._middle, self._farthest = middle.tolist(), BEYOND * radius
        self._maps: list[tuple[torch.Tensor, torch.Tensor]] = []
        """[3, 4] projections of positions to cells, and [h, w] uint8 sky cells, of some photos."""
        shown = {v: one for v, one in sky.shown.items() if one.any()}
        for view in evenly_spaced(list(shown), _MOST_PHOTOS):
            onto = cameras.Ks[view] @ cameras.viewmats[view, :3] / sky.cells[view].side
            onto[2] *= sky.cells[view].side
            cells = torch.from_numpy(shown[view].astype(np.uint8))
            self._maps.append((torch.from_numpy(onto).float(), cells))

    def contains(self, means: torch.Tensor) -> torch.Tensor:
        """Return [N] bool: `means`, [N, 3], in the space."""
        x, y, z = means.T.contiguous()
        photos = zeros(len(means), dtype=torch.uint8)
        for onto, cells in self._maps:
            # Products by element, because those of a matrix depend on the number of threads.
            across, down, depth = (x * a + y * b + z * c + d for a, b, c, d in onto.tolist())
            height, width = cells.shape
            inside = (depth > 0) & (across >= 0) & (across < width * depth)
            rows = (inside & (down >= 0) & (down < height * depth)).nonzero().flatten()
            ahead = depth[rows]
            places = ((down[rows] / ahead).long().clamp_(max=height - 1)) * width
            places += (across[rows] / ahead).long().clamp_(max=width - 1)
            photos[rows] += cells.view(-1)[places]
        a, b, c = self._middle
        near = (x - a).square() + (y - b).square() + (z - c).square() < self._farthest**2
        return near & (photos >= _FEWEST)
