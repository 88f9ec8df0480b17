"""Parameters as a viewer stores them: quantized, with the gradient of unquantized ones."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ..morton import morton_order
from ..raster.reference.rasterize import SplatTensors
from ..shared_constants import SH_C0
from .rules import Coding, ViewerRules

_CHUNK = 256
"""Splats per range of the group `chunk`."""
_DEGREE_ENDS = (3, 8, 15)
"""Numbers of coefficients up to degrees 1, 2 and 3."""


class _Domain(NamedTuple):
    to: Callable[[Tensor], Tensor]
    back: Callable[[Tensor], Tensor]


def _centred_square(opacities: Tensor) -> Tensor:
    x = opacities - 0.5
    return 0.5 + 2 * x * x.abs()


def _centred_root(values: Tensor) -> Tensor:
    x = (values - 0.5) / 2
    return 0.5 + x.sign() * x.abs().clamp(min=1e-12).sqrt()


_DOMAINS = {
    "": _Domain(lambda x: x, lambda x: x),
    "eighth root": _Domain(lambda logs: (logs / 8).exp(), lambda x: 8 * x.clamp(min=1e-12).log()),
    "centred square": _Domain(_centred_square, _centred_root),
}


def stored(splats: SplatTensors, rules: ViewerRules) -> SplatTensors:
    """Splats as a viewer decodes them from its storage; degree 3 at most.

    Args:
        splats: Raw parameters: scales are logarithms, opacities logits.
        rules: Of the viewer.

    Returns:
        The same with activated scales and opacities. Gradients pass through the rounding, but not
        where a value is clamped.
    """
    count = _DEGREE_ENDS[-1]
    shN = splats.shN[:, :count]
    order = None
    if any(c is not None and c.group == "chunk" for c in (rules.scales, rules.sh0)):
        order = torch.from_numpy(morton_order(splats.means.detach().cpu().numpy()))

    def coded(values: Tensor, coding: Coding | None) -> Tensor:
        return values if coding is None else _coded(values, coding, order)

    means = splats.means.half().to(splats.means) if rules.half_means else splats.means
    base = coded(0.5 + SH_C0 * splats.sh0, rules.sh0)
    bands = rules.shN
    if len(bands) == 1:
        shN = coded(shN, bands[0])
    elif bands:
        starts = (0, *_DEGREE_ENDS)
        parts = [coded(shN[:, a:b], c) for a, b, c in zip(starts, starts[1:], bands, strict=False)]
        shN = torch.cat(parts, 1)
    return SplatTensors(
        means=coded(means, rules.means),
        quats=splats.quats,
        scales=coded(splats.scales, rules.scales).exp(),
        opacities=coded(splats.opacities.sigmoid()[:, None], rules.opacities)[:, 0],
        sh0=(base - 0.5) / SH_C0,
        shN=shN,
    )


def _coded(values: Tensor, coding: Coding, order: Tensor | None) -> Tensor:
    """Values [N, C] or [N, K, C] quantized in their domain."""
    if not values.numel():
        return values
    domain = _DOMAINS[coding.domain]
    x = domain.to(values)
    steps = x.new_tensor(coding.steps)[: x.shape[-1]]
    with torch.no_grad():
        low, high = _range(x, coding, order)
        unit = (high - low).clamp(min=1e-30) / steps
    x = torch.minimum(torch.maximum(x, low), high)
    return domain.back(low + unit * rounded((x - low) / unit))


def rounded(values: Tensor, steps: float = 1.0) -> Tensor:
    """Multiples of 1 / steps, with the gradient of the values themselves."""
    exact = values.detach()
    return values + ((exact * steps).round() / steps - exact)


def _range(x: Tensor, coding: Coding, order: Tensor | None) -> tuple[Tensor, Tensor]:
    """Lowest and highest values of the group of each value, broadcastable to `x`."""
    rows = tuple(range(x.ndim - 1))
    if coding.group == "fixed":
        return x.new_tensor(coding.low), x.new_tensor(coding.high)
    if coding.group == "model":
        return x.amin(rows), x.amax(rows)
    if coding.group == "splat":
        largest = x.abs().amax(tuple(range(1, x.ndim)), keepdim=True)
        return -largest, largest
    assert order is not None
    flat = x.flatten(1, -2) if x.ndim > 2 else x[:, None]
    shape = (len(x), *[1] * (x.ndim - 2), x.shape[-1])
    low, high = (
        _of_chunks(flat.amin(1), order, torch.amin),
        _of_chunks(flat.amax(1), order, torch.amax),
    )
    return low.reshape(shape), high.reshape(shape)


def _of_chunks(values: Tensor, order: Tensor, reduce: Callable[..., Tensor]) -> Tensor:
    """[N, C] the reduction of the chunk of each row."""
    chunks = values[order].split(_CHUNK)
    found = torch.cat([reduce(c, 0, keepdim=True).expand_as(c) for c in chunks])
    return torch.empty_like(found).index_copy_(0, order, found)
