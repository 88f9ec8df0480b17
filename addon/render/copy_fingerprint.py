"""Fingerprint of a copy of splats, kept after decoding in a fraction of the copy's memory."""

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

from .mesh_copies import Frozen, FrozenMesh


@dataclass(frozen=True)
class Trace:
    """Enough to tell whether another copy differs and, where only paint does, in which splats."""

    fingerprint: Hashable
    """`Frozen.fingerprint`."""
    unpainted: Hashable
    """`FrozenMesh.unpainted`; None: the splats are those of a file, which nobody paints."""
    base: np.ndarray | None
    """[N, 4] of `radiance:base`; None as before."""
    kept: np.ndarray | None
    """[N] bool, which splats passed the filters; None: there were none."""


def trace_of(frozen: Frozen, kept: np.ndarray | None = None) -> Trace:
    """The trace of a copy, of which the splats that are `kept` were decoded."""
    if isinstance(frozen, FrozenMesh) and frozen.unpainted is not None:
        return Trace(frozen.fingerprint, frozen.unpainted, frozen.base, kept)
    return Trace(frozen.fingerprint, None, None, kept)


def repainted_rows(before: Trace, after: Frozen) -> np.ndarray | None:
    """[K], which splats differ in colour or opacity, where two copies are alike in all else.

    None where they are not, or where new values are not finite, which reading them refuses.
    """
    if before.base is None or not isinstance(after, FrozenMesh):
        return None
    if before.unpainted != after.unpainted:
        return None
    rows = np.flatnonzero((before.base != after.base).any(axis=1))
    return rows if np.isfinite(after.base[rows]).all() else None
