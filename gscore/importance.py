"""Which splats to keep where there may only be so many."""

import numpy as np

from .splats import Splats, sigmoid


def importance_of(splats: Splats) -> np.ndarray:
    """[N] float64: what a splat may show where no camera says what it does: its opacity times the
    area of its largest side, of two standard deviations.

    Splats lie flat on surfaces: of half of those of plush, chosen so, pictures keep 3 dB more than
    with the volume in its place, and 3 dB less than with contributions.
    """
    logs = np.sort(np.clip(splats.scales.astype(np.float64), -300, 300), axis=1)
    return sigmoid(splats.opacities) * np.exp(logs[:, 1] + logs[:, 2])


def most_important(importance: np.ndarray, count: int) -> np.ndarray:
    """[N] bool: the `count` largest of `importance` [N]; of equal ones, those that come first."""
    if count >= len(importance):
        return np.ones(len(importance), bool)
    if count <= 0:
        return np.zeros(len(importance), bool)
    least = np.partition(importance, -count)[-count]
    keep = importance > least
    equal = np.flatnonzero(importance == least)
    keep[equal[: count - int(keep.sum())]] = True
    return keep
