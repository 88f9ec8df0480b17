"""Sanitizing of the model: runaway rows are reset, saturated parameters are clamped.

A runaway row (not finite, or with colours of 1e30) spoils every view that shows it, and its
gradients do not bring it back. A reset row is transparent and neutral in everything else, without
moments: the strategy removes or relocates it like other transparent splats.
"""

import math
from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from .model import CpuModel


MAX_MEAN = 1e6
"""Farthest coordinate, in camera extents."""
MAX_SCALE = 1e3
"""Largest standard deviation, in camera extents."""
MAX_SPREAD = 5.0
"""Upper bound of scales, in camera extents plus the distance from the mean camera position. A splat
of that size is one colour over every image. Trained captures reach 1.4 (sky and walls)."""
MAX_VALUE = 1e4
"""Largest quaternion component, logit and SH coefficient."""
MAX_LOGIT = 20.0
"""Bound of opacity logits: beyond it the slope of the sigmoid is smaller than the optimizer's
epsilon, so they would never return. Trained captures reach 17."""
MAX_RATIO = 1e5
"""Longest to shortest axis. Thinner discs look the same and lose float32 precision."""
_LARGEST = 1e37
"""Second moments above this are infinite after a few more steps."""
_GONE = -MAX_LOGIT
_NEUTRAL = {"means": 0.0, "quats": 1.0, "scales": -10.0, "opacities": _GONE, "sh0": 0.0, "shN": 0.0}


def clamp_runaways(model: "CpuModel", *, extent: float) -> int:
    """Reset runaway rows, and clamp opacities and axes to their bounds.

    Args:
        model: Changed in place; the number of rows stays.
        extent: Camera extent, training units.

    Returns:
        Number of rows that were reset.
    """
    limits = {
        "means": MAX_MEAN * extent,
        "quats": MAX_VALUE,
        "opacities": MAX_VALUE,
        "sh0": MAX_VALUE,
        "shN": MAX_VALUE,
    }
    with torch.no_grad():
        scales = model.params["scales"]
        # Short axes are harmless, so scales have no lower limit here.
        good = ((scales <= math.log(MAX_SCALE * extent)) & scales.isfinite()).all(dim=1)
        for name, limit in limits.items():
            p = model.params[name].detach()
            if p.numel() > 0 and not _all_within(p, limit):
                # Comparisons that NaN fails.
                good = good & (p.reshape(len(p), -1).abs() <= limit).all(dim=1)
        count = len(model) - int(good.sum())
        if count:
            _reset_rows(model, ~good)
        model.params["opacities"].clamp_(-MAX_LOGIT, MAX_LOGIT)
        _clamp_spread(model, extent)
        floor = scales.amax(dim=1, keepdim=True) - math.log(MAX_RATIO)
        torch.maximum(scales, floor, out=scales)
        for name, p in model.params.items():
            _reset_overflowed_moments(model, name)
            # Invalidates the model's cached parameters.
            model.replace(name, p, *model.moments(name), grad=model.grads[name])
    return count


def _clamp_spread(model: "CpuModel", extent: float) -> None:
    scales = model.params["scales"]
    if scales.numel() == 0 or float(scales.max()) <= math.log(MAX_SPREAD * extent):
        return
    distance = model.params["means"].norm(dim=1, keepdim=True)  # cameras are around the origin
    torch.minimum(scales, torch.log(MAX_SPREAD * (extent + distance)), out=scales)


def _all_within(values: torch.Tensor, limit: float) -> bool:
    """Return whether all values are in [-limit, limit] and finite; a single pass propagates NaN."""
    low, high = torch.aminmax(values)
    return -limit <= float(low) and float(high) <= limit and math.isfinite(float(low))


def _reset_rows(model: "CpuModel", bad: torch.Tensor) -> None:
    for name, value in _NEUTRAL.items():
        model.params[name][bad] = value
        model.grads[name][bad] = 0
        for moment in model.moments(name):
            moment[bad] = 0
    for counter in model.rows.values():
        counter[bad] = 0


def _reset_overflowed_moments(model: "CpuModel", name: str) -> None:
    """Clear moments that overflowed, as after one gradient of 1e20: such rows would stop moving."""
    first, second = model.moments(name)
    if second.numel() == 0 or _all_within(second, _LARGEST):
        return
    frozen = ~(second.reshape(len(second), -1) <= _LARGEST).all(dim=1)
    first[frozen] = 0
    second[frozen] = 0
