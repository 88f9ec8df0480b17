"""Depth maps without error, from splats that are known."""

from typing import Any

import numpy as np

from gscore.depth import DepthPrior
from gscore.raster.api import render


def exact_depth_maps(
    photos: Any, splats: Any, *, unaligned: tuple[int, ...] = ()
) -> list[DepthPrior]:
    """Inverse depth of known splats, where they are nearly opaque; some as an affine of it."""
    cameras, priors = photos.scene.cameras, []
    for i in range(len(cameras.names)):
        size = int(cameras.widths[i]), int(cameras.heights[i])
        view = render(splats, cameras.Ks[i], cameras.viewmats[i], *size)
        assert view.inverse_depth is not None
        aligned = i not in unaligned
        priors.append(
            DepthPrior(
                inverse_depth=view.inverse_depth if aligned else 3 * view.inverse_depth + 1,
                confidence=(view.alpha > 0.9).astype(np.float32),
                aligned=aligned,
                fit=None,
            )
        )
    return priors
