"""Relocation: dead splats move onto live ones, and new ones are copies (Kheradmand et al. 2024)."""

import math
from collections.abc import Iterator

import numpy as np
import torch

from ...engine.base import RowEdit
from ...engine.random import uniform
from ...splats import PARAMETERS
from .base import Read

MAX_COPIES = 51
"""Most copies of one splat that a relocation accounts for (Kheradmand et al. 2024)."""


def logit(p: float) -> float:
    """Inverse of the sigmoid."""
    return math.log(p / (1 - p))


def relocate(
    read: Read,
    dead: np.ndarray,
    generator: torch.Generator,
    *,
    within: np.ndarray,
    min_opacity: float,
) -> Iterator[RowEdit]:
    """Yield the edit that moves dead splats onto live ones, drawn by opacity, without changing the
    rendered image; none if none is dead, or no live one is `within`.

    A splat that ends up as n copies of itself gets the opacity and scale of equation 9 of
    Kheradmand et al. 2024.

    Args:
        read: Returns a column of the model.
        dead: [N] bool.
        generator: Source of the draw.
        within: [N] bool, allowed targets.
        min_opacity: Lower bound of the new opacities.
    """
    targets, alive = np.flatnonzero(dead), np.flatnonzero(~dead & within)
    if len(targets) == 0 or len(alive) == 0:
        return
    chosen = alive[_draw(read("opacities")[alive], len(targets), generator)]
    rows, values = _share(read, chosen, min_opacity)
    yield RowEdit(rows=rows, values=values, forget=PARAMETERS, moved=targets, sources=chosen)


def grow(
    read: Read,
    count: int,
    generator: torch.Generator,
    *,
    within: np.ndarray,
    min_opacity: float,
) -> Iterator[RowEdit]:
    """Yield the edit that adds `count` copies of splats drawn by opacity, without changing the
    rendered image; none if none may be copied.

    Args:
        read: Returns a column of the model.
        count: Number of copies.
        generator: Source of the draw.
        within: [N] bool, splats that may be copied.
        min_opacity: Lower bound of the new opacities.
    """
    among = np.flatnonzero(within)
    if count <= 0 or len(among) == 0:
        return
    chosen = among[_draw(read("opacities")[among], count, generator)]
    rows, values = _share(read, chosen, min_opacity)
    yield RowEdit(rows=rows, values=values, forget=PARAMETERS, parents=chosen)


def shared_opacity_scale(
    opacity: np.ndarray, scale: np.ndarray, copies: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the opacity and scale with which n coinciding copies render like one (equation 9).

    With o' = 1 - (1 - o)^(1/n) the scale is divided by
    sum_{i=1..n} sum_{k=0..i-1} C(i-1, k) (-1)^k o'^(k+1) / sqrt(k+1) / o; the inner sums over i
    are C(n, k+1), which leaves one sum.

    Args:
        opacity: [M] float64 in (0, 1).
        scale: [M, 3] float64.
        copies: [M] int64, 1 to MAX_COPIES.

    Returns:
        New opacity [M] and scale [M, 3].
    """
    shared = 1 - (1 - opacity) ** (1.0 / copies)
    total = np.zeros_like(opacity)
    for k in range(int(copies.max(initial=0))):
        factor = _BINOMIALS[copies, k + 1] * (-1) ** k / math.sqrt(k + 1)
        total += factor * shared ** (k + 1)
    return shared, scale * (opacity / total)[:, None]


_BINOMIALS = np.array(
    [[math.comb(n, k) for k in range(MAX_COPIES + 1)] for n in range(MAX_COPIES + 1)], np.float64
)


def _draw(logits: np.ndarray, count: int, generator: torch.Generator) -> np.ndarray:
    """Draw [count] positions by opacity, with replacement.

    Inverts the cumulative sum in float64: unlike torch.multinomial it has no limit of 2^24
    categories, and it is summed in one thread, so the draw does not depend on their number.
    """
    weights = _sigmoid(logits.astype(np.float64))
    weights = np.where(np.isfinite(weights), weights, 0)
    cumulative = np.cumsum(weights)
    drawn = uniform(count, generator, dtype=torch.float64).numpy()
    if not cumulative[-1] > 0:
        return (drawn * len(weights)).astype(np.int64)
    found = np.searchsorted(cumulative, drawn * cumulative[-1], side="right")
    return np.minimum(found, len(weights) - 1)


def _share(
    read: Read, chosen: np.ndarray, min_opacity: float
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the rows of `chosen`, and their opacities and scales for one more copy per
    occurrence."""
    rows, repeats = np.unique(chosen, return_counts=True)
    opacity = _sigmoid(read("opacities")[rows].astype(np.float64))
    copies = np.minimum(repeats + 1, MAX_COPIES)
    opacity = np.clip(opacity, 1e-12, 1 - 1e-7)
    scale = np.exp(read("scales")[rows].astype(np.float64))
    opacity, scale = shared_opacity_scale(opacity, scale, copies)
    opacity = np.clip(opacity, min_opacity, 1 - 1e-7)
    return rows, {
        "opacities": np.log(opacity / (1 - opacity)).astype(np.float32),
        "scales": np.log(scale).astype(np.float32),
    }


def _sigmoid(x: np.ndarray) -> np.ndarray:
    return 0.5 * (1 + np.tanh(0.5 * x))
