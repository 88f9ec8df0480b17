"""Holdout of splats: splats that cut holes into colour and alpha of a picture; no bpy."""

from dataclasses import replace

import numpy as np

from ..core import Splats, sh_basis

HALF = float(0.5 / sh_basis(0, np.array([0.0, 0.0, 1.0]))[0])
"""Added to sh0 it makes white of grey, taken off it black."""


def apply_holdout(splats: Splats, runs: list[tuple[int, bool]]) -> tuple[Splats, Splats]:
    """Splats to draw, so that some of them cut holes.

    Args:
        splats: All of them.
        runs: How many in a row cut holes, or do not; together all.

    Returns:
        The splats, black where they cut; and those that draw how much of the light is not cut
        out: black where they cut and white elsewhere, without view dependence.
    """
    cuts = np.repeat([cut for _, cut in runs], [count for count, _ in runs])[:, None, None]
    sh0 = np.where(cuts, np.float32(-HALF), splats.sh0)
    rest = np.where(cuts, np.float32(0), splats.shN)
    share = np.repeat(np.where(cuts, np.float32(-HALF), np.float32(HALF)), 3, axis=2)
    return (
        replace(splats, sh0=sh0, shN=rest),
        replace(splats, sh0=share, shN=np.zeros_like(rest[:, :0])),
    )
