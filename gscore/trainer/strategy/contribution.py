"""Contribution of splats to the photos: blending weights, summed over pixels."""

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import torch

from ...raster.memory import ones, zeros
from ...raster.request import Settings
from ...raster.training_rasterizer import TrainingRasterizer
from ..photos.image_pyramid import SizedView


class Weights(NamedTuple):
    """The blending weights of the splats in one view, summed over pixels; good until the next."""

    kept: torch.Tensor
    """[N] float32, px: over the pixels that the mask shows, as far as it does."""
    whole: torch.Tensor
    """[N] float32, px: over all pixels."""


def weights_by_view(
    rasterizer: TrainingRasterizer,
    params: Mapping[str, torch.Tensor],
    shown: Iterable[SizedView],
    *,
    antialias: bool,
    masks_hide: bool,
    scratch: Mapping[str, torch.Tensor],
    threads: int = 0,
) -> Iterator[Weights]:
    """With how much weight each splat was blended in each view: one channel of
    `raster.weights.blending_weights` is summed over the pixels that masks show, another over all.

    Args:
        painter: What it drew last is lost.
        params: The splats, raw, as in `Model.params`; their SH coefficients are not read.
        shown: Views to look at.
        antialias: As in the training.
        masks_hide: Pixels count as kept as far as masks show them; else all do.
        scratch: Tensors of the shapes of `params` by name, which are overwritten; not those of SH.
        threads: 0: all cores; the result does not depend on it.
    """
    for view, _, mask, _, _ in shown:
        settings = Settings(antialias=antialias, threads=threads)
        counts = ones(view.height, view.width, 3)
        if masks_hide and mask is not None:
            counts[..., 0] = torch.from_numpy(mask).to(counts.dtype) / 255
        sums = torch.from_numpy(rasterizer.weights(params, view, settings, counts, scratch))
        yield Weights(sums[:, 0].contiguous(), sums[:, 1].contiguous())


def max_contribution(weights: Iterable[Weights], count: int) -> torch.Tensor:
    """[N] float32, px: what each of `count` splats adds to the view in which it adds most.

    A splat that one view needs is needed; the sum over all views would favour the background, which
    all show. Of half of the splats pruned that cost 0.1 to 0.2 dB more on plush.
    """
    most = zeros(count)
    for kept, _ in weights:
        torch.maximum(most, kept, out=most)
    return most


def mostly_masked(weights: Iterable[Weights], count: int, *, share: float) -> torch.Tensor:
    """[N] bool: which of `count` splats have less than `share` of their weight where masks show it.

    No photo says what these should look like, and they veil what other photos show.
    """
    kept, whole = zeros(count), zeros(count)
    for of_kept, of_whole in weights:
        kept += of_kept
        whole += of_whole
    return kept < share * whole


def lowest_rows(weights: torch.Tensor, count: int) -> torch.Tensor:
    """[N] bool: the `count` smallest of `weights` [N]; of equal ones, those that come first."""
    out = zeros(len(weights), dtype=torch.bool)
    out[torch.sort(weights, stable=True).indices[:count]] = True
    return out
