"""Several models as one."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..splats import Splats


def joined(parts: Sequence[Splats]) -> Splats:
    """One model of at least one; SH coefficients that a part lacks are zero."""
    if len(parts) == 1:
        return parts[0]
    width = max(part.shN.shape[1] for part in parts)
    even = [
        replace(part, shN=np.pad(part.shN, ((0, 0), (0, width - part.shN.shape[1]), (0, 0))))
        for part in parts
    ]
    names = vars(even[0])
    return Splats(
        **{name: np.concatenate([getattr(part, name) for part in even]) for name in names}
    )
