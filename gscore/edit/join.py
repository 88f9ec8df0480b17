"""Several models in one world made one."""

from collections.abc import Sequence

import numpy as np

from ..splats import Splats


def join_splats(parts: Sequence[Splats]) -> Splats:
    """One model of several [at least one], in their order; SH coefficients that a part lacks are
    zero."""
    if len(parts) == 1:
        return parts[0]
    width = max(part.shN.shape[1] for part in parts)
    rest = [np.pad(p.shN, ((0, 0), (0, width - p.shN.shape[1]), (0, 0))) for p in parts]
    names = ("means", "quats", "scales", "opacities", "sh0")
    arrays = {name: np.concatenate([getattr(p, name) for p in parts]) for name in names}
    return Splats(**arrays, shN=np.concatenate(rest))
