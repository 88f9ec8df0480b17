"""Models that were trained side by side, shown as one."""

from collections.abc import Sequence
from functools import cache

import numpy as np
import torch

from ...splats import PARAMETERS

_DRAWN_FROM = 1 / 255
"""Nothing fainter is drawn (Kerbl et al. 2023), so this is where the tail of a splat ends."""
_NODES = 100_001


def shown_as_one(models: Sequence[dict[str, torch.Tensor]]) -> dict[str, torch.Tensor]:
    """The raw parameters of one model that looks like the mean of several.

    Args:
        models: Raw parameters of each, as in `Splats`, of one SH degree; of a single one, these
            are what is returned.
    """
    if len(models) == 1:
        return models[0]
    joined = {name: torch.cat([model[name] for model in models]) for name in PARAMETERS}
    return joined | {"opacities": shared_opacities(joined["opacities"], len(models))}


def shared_opacities(opacities: torch.Tensor, models: int) -> torch.Tensor:
    """What splats need so that as many `models` in one place take as much light as one did.

    A splat of opacity o is drawn where alpha = o exp(-r^2 / 2) is 1/255 or more, and there it
    takes the optical depth -log(1 - alpha), in all 2 pi (Li2(o) - Li2(1/255)) standard deviations
    squared; the result takes 1 / `models` of that. To share the opacity in the middle alone,
    1 - (1 - o)^(1 / models), would leave out of the tails of faint splats what falls below 1/255
    then, and let the background through (docs/experiments/2026-11-ensembles.md).

    Args:
        opacities: [N] float32 logits.
        models: At least 1; of 1, nothing changes.

    Returns:
        [N] float32 logits. What was not drawn is as it was.
    """
    if models == 1:
        return opacities
    nodes, depths = _depths()
    o = torch.sigmoid(opacities.double()).numpy()
    shared = np.interp(np.interp(o, nodes, depths) / models, depths, nodes)
    out = torch.logit(torch.from_numpy(shared)).float()
    return torch.where(torch.from_numpy(o > _DRAWN_FROM), out, opacities)


@cache
def _depths() -> tuple[np.ndarray, np.ndarray]:
    """Opacities from 1/255 to almost 1, and the optical depth that splats of these take, in
    2 pi standard deviations squared; both rise."""
    from scipy.special import spence  # half a second, and only ensembles need it

    nodes = np.linspace(_DRAWN_FROM, 1 - 1e-6, _NODES)
    depths = spence(1 - nodes)  # of 1 - x it is Li2(x)
    return nodes, depths - depths[0]
