"""Smallest-three encoding of unit quaternions: the largest component is implied."""

import numpy as np

OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""The other components, by index of the largest."""


def smallest_three(unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index [N] of the largest component, and the others [N, 3] in their order, at most sqrt(1/2)
    in magnitude, with the signs for a positive largest component.

    Args:
        unit: [N, 4] quaternions of length 1, in any order of components; float of any width.
    """
    largest = np.abs(unit).argmax(axis=1)
    negative = np.take_along_axis(unit, largest[:, None], axis=1) < 0
    three = np.take_along_axis(unit, OTHERS[largest], axis=1)
    return largest, np.where(negative, -three, three)


def with_largest(largest: np.ndarray, three: np.ndarray) -> np.ndarray:
    """[N, 4] quaternions, dtype of `three`: the inverse of `smallest_three`, up to the sign.

    Args:
        largest: [N] indices, 0 to 3, any integer dtype.
        three: [N, 3] the other components.
    """
    at = largest.astype(np.intp)
    quats = np.empty((len(three), 4), three.dtype)
    np.put_along_axis(quats, OTHERS[at], three, axis=1)
    rest = np.sqrt(np.maximum(1 - (three**2).sum(axis=1, keepdims=True), 0))
    np.put_along_axis(quats, at[:, None], rest, axis=1)
    return quats
