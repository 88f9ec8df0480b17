"""Blending weights of splats in a view, summed over pixels."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..sh import SH_C0
from ..splats import PARAMETERS
from . import _native
from .buffers import Array
from .request import Frustum, Settings

GEOMETRY = PARAMETERS[:4]
"""Parameters that determine the blending weights."""


def blending_weights(
    geometry: Sequence[Array],
    view: Frustum,
    settings: Settings,
    shares: Array,
    *,
    scratch: Mapping[str, Array],
    raster: _native.Raster | None = None,
) -> np.ndarray:
    """Blending weights of all splats in one view.

    They are the gradients of the picture's sum in the splats' colours, so the backward pass
    computes them. Colours are set to grey, because one clamped at zero passes no gradient.

    Args:
        geometry: Arrays of `GEOMETRY`, in their order, contiguous.
        view: Camera and picture size.
        settings: Render settings.
        shares: [H, W, 3] float32, pixel weights of three sums.
        scratch: Arrays of the shapes of `geometry` by name, which are overwritten.
        raster: A workspace; its last view is lost. None: one from the pool.

    Returns:
        [N, 3] float32, px.
    """
    if raster is None:
        with _native.pool.lend() as lent:
            return blending_weights(geometry, view, settings, shares, scratch=scratch, raster=lent)
    count, size = len(geometry[0]), (view.height, view.width)
    grey, rest = np.zeros((count, 1, 3), np.float32), np.zeros((count, 0, 3), np.float32)
    splats = [*geometry, grey, rest]
    pictures = {"rgb": np.empty((*size, 3), np.float32), "alpha": np.empty(size, np.float32)}
    sums = np.empty_like(grey)
    into = {name: scratch[name] for name in GEOMETRY} | {"sh0": sums, "shN": rest}
    raster.forward(splats, view, settings, pictures)
    raster.backward(splats, view, settings, {"rgb": shares}, into)
    return sums[:, 0] / np.float32(SH_C0)
