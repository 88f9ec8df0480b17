"""Fingerprint of a copy of splats, kept after decoding in a fraction of its memory."""

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

from .mesh_copies import Frozen, FrozenMesh


@dataclass(frozen=True)
class Trace:
    """Data that shows whether another copy differs and, if only in paint, in which splats."""

    fingerprint: Hashable
    """`Frozen.fingerprint`."""
    unpainted: Hashable
    """`FrozenMesh.unpainted`; None: the splats come from a file and cannot be painted."""
    base: np.ndarray | None
    """`radiance:base`, [N, 4]; None: the splats come from a file."""
    kept: np.ndarray | None
    """[N] bool, splats that passed the filters; None: no filters."""


def trace_of(frozen: Frozen, kept: np.ndarray | None = None) -> Trace:
    """The trace of a copy whose `kept` splats were decoded."""
    if isinstance(frozen, FrozenMesh) and frozen.unpainted is not None:
        return Trace(frozen.fingerprint, frozen.unpainted, frozen.base, kept)
    return Trace(frozen.fingerprint, None, None, kept)


def repainted_rows(before: Trace, after: Frozen) -> np.ndarray | None:
    """Indices [K] of splats that differ in colour or opacity only.

    None if the copies differ otherwise, or if new values are not finite, which decoding refuses.
    """
    if before.base is None or not isinstance(after, FrozenMesh):
        return None
    if before.unpainted != after.unpainted:
        return None
    rows = np.flatnonzero((before.base != after.base).any(axis=1))
    return rows if np.isfinite(after.base[rows]).all() else None
