"""Packing error of a page: renders of the splats before and after packing, compared."""

import math
from typing import Any

import numpy as np

from ...datasets.resolution import scale_intrinsics
from ...page.pack import Packed, unpack
from ...page.page import PageCamera
from ...raster.api import render
from ...splats import Splats
from ..args.model_argument import ModelArgument
from .page_views import PageViews

_VIEWS = 4
_WIDEST = 800
"""px."""


def difference(
    model: ModelArgument, packed: Packed, views: PageViews, *, threads: int
) -> dict[str, float | None]:
    """Difference of renders before and after packing, mean over some views: `packing_psnr` in dB,
    null if equal, and `packing_difference`, the mean absolute difference of 8-bit values.
    """
    chosen = views.cameras or [views.first]
    places = np.linspace(0, len(chosen) - 1, min(len(chosen), _VIEWS)).round().astype(int)
    found = unpack(packed)
    squares, differences = [], []
    for place in places:
        camera = chosen[place]
        before, after = (_drawn(model, one, camera, threads) for one in (model.splats, found))
        squares.append(float(np.mean((before - after) ** 2)))
        differences.append(float(np.abs(before - after).mean()) * 255)
    worth = [-10 * math.log10(square) for square in squares if square]
    return {
        "packing_psnr": sum(worth) / len(worth) if len(worth) == len(squares) else None,
        "packing_difference": sum(differences) / len(differences),
    }


def _drawn(model: ModelArgument, splats: Splats, camera: PageCamera, threads: int) -> Any:
    """[H, W, 3] float64 in [0, 1]."""
    old = camera.width, camera.height
    scale = min(1.0, _WIDEST / max(old))
    size = max(1, round(old[0] * scale)), max(1, round(old[1] * scale))
    K = scale_intrinsics(camera.K, old, size)
    options = {"background": model.background, "near": model.near, "antialias": model.antialias}
    drawn = render(splats, K, camera.viewmat, *size, depths=False, threads=threads, **options)
    return np.clip(drawn.rgb.astype(np.float64), 0, 1)
