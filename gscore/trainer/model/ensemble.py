"""Ensemble: models that were trained in parallel, merged into one."""

from collections.abc import Sequence
from functools import cache

import numpy as np
import torch

from ...splats import PARAMETERS

_DRAWN_FROM = 1 / 255
"""Nothing fainter is drawn (Kerbl et al. 2023), so this is where the tail of a splat ends."""
_TOP, _NODES = 1 - 1e-6, 20_001
"""Last and number of the opacities in the table."""


def merge_models(models: Sequence[dict[str, torch.Tensor]]) -> dict[str, torch.Tensor]:
    """Raw parameters of one model that renders as the mean of several.

    Args:
        models: Raw parameters of each, as in `Splats`, of one SH degree.
    """
    joined = {name: torch.cat([model[name] for model in models]) for name in PARAMETERS}
    return joined | {"opacities": divide_opacities(joined["opacities"], len(models))}


def divide_opacities(opacities: torch.Tensor, models: int) -> torch.Tensor:
    """Opacities with which splats of several `models` in one place absorb as much light as one.

    A splat of opacity o is drawn where alpha = o exp(-r^2 / 2) is 1/255 or more, and there it
    takes the optical depth -log(1 - alpha), in all 2 pi (Li2(o) - Li2(1/255)) standard deviations
    squared; the result takes 1 / `models` of that. To share the opacity in the middle alone,
    1 - (1 - o)^(1 / models), would leave out of the tails of faint splats what falls below 1/255
    then, and let the background through (docs/experiments/2026-11-ensembles.md).

    Args:
        opacities: [N] float32 logits.
        models: At least 1; of 1, nothing changes.

    Returns:
        [N] float32 logits. Splats below the drawing threshold are unchanged.
    """
    if models == 1:
        return opacities
    shared = _shared(models)
    o = torch.sigmoid(opacities.double())  # float32 is not the same bits in parts and as a whole
    at = (o - _DRAWN_FROM) * ((_NODES - 1) / (_TOP - _DRAWN_FROM))
    at = torch.nan_to_num(at).clamp(0, _NODES - 1.01)
    before, share = at.long(), at.frac()
    found = torch.lerp(shared[before], shared[before + 1], share)
    return torch.where(o > _DRAWN_FROM, torch.logit(found).float(), opacities)


@cache
def _shared(models: int) -> torch.Tensor:
    """[_NODES] float64: shared opacities of evenly spaced opacities from 1/255 to _TOP."""
    from scipy.special import spence  # half a second, and only ensembles need it

    nodes = np.linspace(_DRAWN_FROM, _TOP, _NODES)
    depths = spence(1 - nodes)  # of 1 - x it is Li2(x)
    depths -= depths[0]
    return torch.from_numpy(np.interp(depths / models, depths, nodes))
