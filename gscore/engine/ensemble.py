"""Ensemble: merges models that were trained in parallel into one."""

from collections.abc import Sequence
from functools import cache

import numpy as np
import torch

from ..shared_constants import ALPHA_MIN
from ..splats import PARAMETERS
from .base import Columns

_TOP, _NODES = 1 - 1e-6, 20_001
"""Last opacity in the table, and number of opacities."""


def merge_models(models: Sequence[Columns]) -> Columns:
    """Return the raw parameters of one model that renders as the mean of several.

    Args:
        models: Raw parameters of each model, as in `Splats`, with equal SH degree; one model is
            returned unchanged.
    """
    if len(models) == 1:
        return models[0]
    merged = {name: np.concatenate([model[name] for model in models]) for name in PARAMETERS}
    return merged | {"opacities": divide_opacities(merged["opacities"], len(models))}


def divide_opacities(opacities: np.ndarray, models: int) -> np.ndarray:
    """Reduce opacities so that coinciding splats of several `models` absorb as much light as one.

    A splat of opacity o is drawn where alpha = o exp(-r^2 / 2) is 1/255 or more. Its optical depth
    -log(1 - alpha) integrates there to 2 pi (Li2(o) - Li2(1/255)) standard deviations squared; the
    result has 1 / `models` of that. Dividing only the optical depth at the centre, 1 - (1 - o)^(1 /
    models), would lose the tails of faint splats that fall below 1/255 then, and let the background
    through (docs/experiments/2026-11-ensembles.md).

    Args:
        opacities: [N] float32 logits.
        models: At least 1; 1 changes nothing.

    Returns:
        [N] float32 logits. Splats below the drawing threshold are unchanged.
    """
    if models == 1:
        return opacities
    shared = _shared(models)
    logits = torch.from_numpy(opacities)
    o = torch.sigmoid(logits.double())  # float32 bits depend on the split into parts
    at = (o - ALPHA_MIN) * ((_NODES - 1) / (_TOP - ALPHA_MIN))
    at = torch.nan_to_num(at).clamp(0, _NODES - 1.01)
    before, share = at.long(), at.frac()
    found = torch.lerp(shared[before], shared[before + 1], share)
    return torch.where(o > ALPHA_MIN, torch.logit(found).float(), logits).numpy()


@cache
def _shared(models: int) -> torch.Tensor:
    """Return [_NODES] float64: divided opacities for evenly spaced ones from 1/255 to _TOP."""
    from scipy.special import spence  # imports in half a second, only needed by ensembles

    nodes = np.linspace(ALPHA_MIN, _TOP, _NODES)
    depths = spence(1 - nodes)  # spence(1 - x) is Li2(x)
    depths -= depths[0]
    return torch.from_numpy(np.interp(depths / models, depths, nodes))
