"""Splat errors: the error of renders against photos, attributed to splats by blending weight.

The error of a splat is the mean error of its pixels, weighted by its blending weights: the factors
by which a gradient in the picture reaches its colour.
"""

import numpy as np

from ..raster.blend_weights import GEOMETRY, blending_weights
from ..raster.request import Frustum, Settings
from ..splats import Splats

_LEAST = 1.0
"""Minimum sum of weights over all views for an error of a splat, px."""


class SplatErrors:
    """Accumulates the errors of splats over views."""

    def __init__(self, splats: Splats, *, antialias: bool = False, threads: int = 0) -> None:
        """Start for `splats`, raw parameters, with or without the `antialias` compensation."""
        self._geometry = [
            np.require(getattr(splats, name), np.float32, ["C", "A"]) for name in GEOMETRY
        ]
        self._scratch = {
            name: np.empty_like(a) for name, a in zip(GEOMETRY, self._geometry, strict=True)
        }
        self._settings = Settings(antialias=antialias, threads=threads)
        self._sums = np.zeros((len(splats), 2))

    def add(
        self, view: Frustum, picture: np.ndarray, target: np.ndarray, weights: np.ndarray | None
    ) -> None:
        """Add a view.

        Args:
            view: The camera, in the world of the splats.
            picture: [H, W, 3] float, the render; clipped to [0, 1].
            target: [H, W, 3] float in [0, 1], the photo.
            weights: [H, W] uint8, pixel weights, 255 is 1; None: all 1.
        """
        counts = np.ones(target.shape[:2]) if weights is None else weights / 255.0
        error = np.abs(np.clip(picture, 0.0, 1.0) - target).mean(axis=2) * counts
        shares = np.zeros((*counts.shape, 3), np.float32)
        shares[..., 0], shares[..., 1] = error, counts
        found = blending_weights(
            self._geometry, view, self._settings, shares, scratch=self._scratch
        )
        self._sums += found[:, :2]

    def mean(self) -> np.ndarray:
        """[N] float32, 0 to 1: mean absolute difference per channel in the pixels of each splat;
        NaN for splats with hardly any visible pixel."""
        error, weight = self._sums.T
        visible = weight >= _LEAST
        found = np.full(len(error), np.nan, np.float32)
        found[visible] = np.clip(error[visible] / weight[visible], 0.0, 1.0)
        return found
