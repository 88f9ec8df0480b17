"""What each splat adds to the photos: its blending weights, summed over pixels."""

from collections.abc import Iterable, Mapping

import torch

from ..raster.painter import Painter
from ..sh import SH_C0
from .pyramid import Sized


def blending_weights(
    painter: Painter,
    params: Mapping[str, torch.Tensor],
    shown: Iterable[Sized],
    *,
    near: float,
    antialias: bool,
    masks_hide: bool,
    scratch: Mapping[str, torch.Tensor],
    threads: int = 0,
) -> torch.Tensor:
    """Sum over the pixels of a view of the weight with which each splat was blended there, of the
    view in which that is most.

    A splat that one view needs is needed; the sum over all views would favour the background, which
    all show. Of half of the splats pruned that cost 0.1 to 0.2 dB more on plush.

    The backward pass knows it: it is the gradient of the sum of a picture in the splat's colour.
    Colours are made grey for that, since one that is clamped at zero passes no gradient.

    Args:
        painter: What it drew last is lost.
        params: The splats, raw, as in `Model.params`; their SH coefficients are not read.
        shown: Views to look at.
        near: Near plane, training units.
        antialias: As in the training.
        masks_hide: Pixels count as far as masks show them; else all do.
        scratch: Tensors of the shapes of `params` by name, which are overwritten; not shN.
        threads: 0: all cores; the result does not depend on it.

    Returns:
        [N] float32, px.
    """
    count = len(params["means"])
    most = torch.zeros(count)
    no_rest = torch.zeros(count, 0, 3)
    grey = {**params, "sh0": torch.zeros_like(params["sh0"]), "shN": no_rest}
    into = {**scratch, "shN": no_rest}
    for view, _, mask, tiles, _ in shown:
        painter.draw(
            tuple(grey.values()),
            view.viewmat,
            view.K,
            view.width,
            view.height,
            near=near,
            antialias=antialias,
            threads=threads,
            tiles=tiles,
        )
        counts = torch.ones(view.height, view.width, 3)
        if masks_hide and mask is not None:
            counts *= torch.from_numpy(mask)[..., None] / 255
        painter.gradients(into, counts)
        torch.maximum(most, into["sh0"][:, 0, 0] / SH_C0, out=most)
    return most


def least(weights: torch.Tensor, count: int) -> torch.Tensor:
    """[N] bool: the `count` smallest of `weights` [N]; of equal ones, those that come first."""
    out = torch.zeros(len(weights), dtype=torch.bool)
    out[torch.sort(weights, stable=True).indices[:count]] = True
    return out
