"""Minimum scale of splats by the sampling rate of the photos: the 3D filter of Mip-Splatting.

The photos do not constrain a splat thinner than a pixel of every photo, because the rasterizer
widens it to half a pixel; a closer view would show the arbitrary thickness.
"""

import math
from collections.abc import Iterable

import numpy as np
import torch

from ...engine.base import RowEdit
from ...raster.memory import empty, ones, zeros
from ...raster.request import Frustum
from .base import Read

_MARGIN = 0.15
"""Margin around a photo, relative to its sides, from which splats may still reach into it."""


def sampling_rates(means: torch.Tensor, views: Iterable[Frustum]) -> torch.Tensor:
    """Return sampling rates of positions: pixels per unit in the nearest photo that has them in its
    frame, occluded or not (Yu et al. 2024, Mip-Splatting, section 4.2).

    Args:
        means: [N, 3] float32, any unit.
        views: Perspective views.

    Returns:
        [N] float32; 0 where no photo contains the position.
    """
    rates = zeros(len(means))
    if not len(means):
        return rates
    places = torch.cat([means.T, ones(1, len(means))])
    found = empty(3, len(means))
    for view in views:
        viewmat, K = (torch.from_numpy(np.asarray(m, np.float32)) for m in (view.viewmat, view.K))
        x, y, z = torch.mm(K @ viewmat[:3], places, out=found)
        inside = z > view.near
        for at, side in ((x, view.width), (y, view.height)):
            inside &= (at > -_MARGIN * side * z) & (at < (1 + _MARGIN) * side * z)
        rate = float(max(K[0, 0], K[1, 1])) / z
        torch.maximum(rates, rate.where(inside, rates), out=rates)
    return rates


def min_scale_edit(read: Read, views: Iterable[Frustum], pixels: float) -> RowEdit:
    """Return the edit that raises scales to at least `pixels` of the nearest photo.

    Args:
        read: Returns columns.
        views: Training views at full photo size.
        pixels: Standard deviation, above 0.
    """
    rates = sampling_rates(torch.from_numpy(read("means")), views)
    floor = math.log(pixels) - torch.log(rates)
    # Without a photo there is no limit; log 0 would make it infinite.
    floor.masked_fill_(rates == 0, -math.inf)
    scales = torch.maximum(torch.from_numpy(read("scales")), floor[:, None])
    return RowEdit(values={"scales": scales.numpy()})
