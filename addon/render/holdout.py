"""Holdout of splats: splats that cut holes into colour and alpha of a picture; no bpy."""

from dataclasses import replace

import numpy as np

from ..core import Splats, sh_basis

HALF = float(0.5 / sh_basis(0, np.array([0.0, 0.0, 1.0]))[0])
"""Difference in sh0 from grey to white, and from black to grey."""


def apply_holdout(splats: Splats, runs: list[tuple[int, bool]]) -> tuple[Splats, Splats]:
    """Splats of which some cut holes.

    Args:
        splats: All splats.
        runs: Lengths of consecutive runs, and whether the run cuts holes.

    Returns:
        The splats with holdouts in black; and the splats whose picture is the share of light that
        is not cut out: holdouts black, others white, without view dependence.
    """
    cuts = np.repeat([cut for _, cut in runs], [count for count, _ in runs])[:, None, None]
    sh0 = np.where(cuts, np.float32(-HALF), splats.sh0)
    rest = np.where(cuts, np.float32(0), splats.shN)
    share = np.repeat(np.where(cuts, np.float32(-HALF), np.float32(HALF)), 3, axis=2)
    return (
        replace(splats, sh0=sh0, shN=rest),
        replace(splats, sh0=share, shN=np.zeros_like(rest[:, :0])),
    )
