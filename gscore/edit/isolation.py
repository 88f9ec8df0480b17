"""Isolation of splats: distance to their neighbours, relative to the neighbours' own distances."""

import os

import numpy as np

from ..extras import need

NEIGHBOURS = 8
"""Neighbours per splat."""


def isolation_of(means: np.ndarray, *, threads: int = 0) -> np.ndarray:
    """Isolation of each splat relative to its neighbours.

    The distance to the splat's eighth neighbour, divided by the median of that distance of these
    eight: about 1 inside any object, dense or sparse, and large for single floaters (a simple form
    of the local outlier factor, Breunig et al. 2000).

    Args:
        means: [N, 3], finite.
        threads: 0: all cores; the result does not depend on it.

    Returns:
        [N] float64; 1 for too few splats.

    Raises:
        BackendError: scipy is not installed.
    """
    if len(means) <= NEIGHBOURS:
        return np.ones(len(means))
    spatial = need("scipy.spatial", "Finding isolated splats")
    # Queries in the order of the tree are four times as fast, because neighbours are in cache.
    tree = spatial.KDTree(means, compact_nodes=False, balanced_tree=False)
    order, cores = tree.indices, threads or os.cpu_count() or 1
    distances, near = tree.query(means[order], k=NEIGHBOURS + 1, workers=cores)
    reach = np.empty(len(means))
    reach[order] = distances[:, -1]
    usual = np.empty(len(means))
    usual[order] = np.median(reach[near[:, 1:]], axis=1)
    # Copies in one place have neighbours at distance 0.
    return reach / np.maximum(usual, np.finfo(np.float64).tiny)
