"""Selection masks: splats that are similar, faint, small or near; no bpy."""

import numpy as np

from ..core import Splats, cluster_sizes, reached_from, sh0_to_rgb

_BLOCK = 1 << 14
"""Splats per block, so that intermediate results stay in the cache."""
SET, ADD, TAKE, COMMON = "SET", "ADD", "TAKE", "COMMON"


def combined(before: np.ndarray, mask: np.ndarray, mode: str) -> np.ndarray:
    """[N] bool: a selection [N] combined with a new mask [N].

    Args:
        before: Previous selection.
        mask: New mask.
        mode: SET: the mask alone; ADD: union; TAKE: difference; COMMON: intersection.
    """
    if mode == ADD:
        return before | mask
    if mode == TAKE:
        return before & ~mask
    return before & mask if mode == COMMON else mask


def between(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """[N] bool: values [N] between two inclusive limits; `high` 0: no limit."""
    keep = values >= np.float32(low)
    return keep & (values <= np.float32(high)) if high > 0 else keep


def similar_color(base: np.ndarray, color: np.ndarray, tolerance: float) -> np.ndarray:
    """[N] bool: splats with a colour near the given one.

    Args:
        base: [N, 4] of `radiance:base`.
        color: [3] sRGB values.
        tolerance: Largest distance in sRGB values; black and white are sqrt(3) apart.
    """
    similar, color = np.empty(len(base), bool), np.asarray(color, np.float32)
    for at in range(0, len(base), _BLOCK):
        part = slice(at, at + _BLOCK)
        x, y, z = (colors(base[part]) - color).T
        similar[part] = x * x + y * y + z * z <= np.float32(tolerance) ** 2
    return similar


def colors(base: np.ndarray) -> np.ndarray:
    """[N, 3] float32 sRGB values of `radiance:base` [N, 4], without the view-dependent part."""
    return np.maximum(sh0_to_rgb(base[:, :3]), 0).astype(np.float32)


def flooded(
    means: np.ndarray, base: np.ndarray, seeds: np.ndarray, gap: float, tolerance: float
) -> np.ndarray:
    """[N] bool: splats connected to the seeds, with similar colours.

    Args:
        means: [N, 3].
        base: [N, 4] of `radiance:base`.
        seeds: [N] bool, included in the result.
        gap: Side of the cells of `gscore.edit.reached_from`, units of `means`.
        tolerance: As `similar_color`, from the seeds' mean colour; 0: any colour.
    """
    if tolerance <= 0 or not seeds.any():
        return reached_from(means, seeds, gap)
    allowed = similar_color(base, colors(base[seeds]).mean(axis=0), tolerance) | seeds
    reached = np.zeros(len(means), bool)
    reached[allowed] = reached_from(means[allowed], seeds[allowed], gap)
    return reached


def floaters(splats: Splats, gap: float, few: int) -> np.ndarray:
    """[N] bool: splats in clusters of fewer than `few` splats; `gap` as a share of the model's size
    (`gscore.edit.cluster_sizes`)."""
    return cluster_sizes(splats, gap) < few
