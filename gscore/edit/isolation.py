"""Isolation of splats: distance to their neighbours relative to the neighbours' own distances."""

import os

import numpy as np

from ..extras import need

NEIGHBOURS = 8
"""Of a splat, that are looked at."""


def isolation_of(means: np.ndarray, *, threads: int = 0) -> np.ndarray:
    """How much lonelier each splat is than its neighbours.

    The distance to the splat's eighth neighbour, divided by the median of the same distance of
    these eight: about 1 inside of anything, however dense or sparse it is, and large for what
    floats alone (a simple form of the local outlier factor, Breunig et al. 2000).

    Args:
        means: [N, 3], finite.
        threads: 0: all cores; the result does not depend on it.

    Returns:
        [N] float64; 1 where there are too few splats to tell.

    Raises:
        BackendError: scipy is not installed.
    """
    if len(means) <= NEIGHBOURS:
        return np.ones(len(means))
    spatial = need("scipy.spatial", "Looking for isolated splats")
    # Asked for in the order of the tree, neighbours are still in the cache: four times as fast.
    tree = spatial.KDTree(means, compact_nodes=False, balanced_tree=False)
    order, cores = tree.indices, threads or os.cpu_count() or 1
    distances, near = tree.query(means[order], k=NEIGHBOURS + 1, workers=cores)
    reach = np.empty(len(means))
    reach[order] = distances[:, -1]
    usual = np.empty(len(means))
    usual[order] = np.median(reach[near[:, 1:]], axis=1)
    # Copies in one place have neighbours at no distance; what they are far from is not alone.
    return reach / np.maximum(usual, np.finfo(np.float64).tiny)
