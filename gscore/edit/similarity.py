"""Similarity matrix from a translation, a rotation and a scale, for `transform_splats`."""

import math
from collections.abc import Sequence

import numpy as np


def similarity_matrix(
    *,
    scale: float = 1.0,
    degrees: Sequence[float] = (0.0, 0.0, 0.0),
    move: Sequence[float] = (0.0, 0.0, 0.0),
) -> np.ndarray:
    """[4, 4] float64 that scales about the origin, then rotates, then translates.

    Args:
        scale: Scale factor.
        degrees: Rotations about the world's x, then y, then z axis, counter-clockwise as seen from
            the end of the axis; multiples of 90 are exact.
        move: Translation, world units.
    """
    matrix = np.eye(4)
    for axis, angle in enumerate(degrees):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(4)
        turn[a, a] = turn[b, b] = _cosine(angle)
        turn[b, a], turn[a, b] = _cosine(angle - 90), -_cosine(angle - 90)
        matrix = turn @ matrix
    matrix[:3, :3] *= scale
    matrix[:3, 3] = move
    return matrix


def _cosine(degrees: float) -> float:
    quarters = degrees / 90
    if quarters == round(quarters):
        return (1.0, 0.0, -1.0, 0.0)[round(quarters) % 4]
    return math.cos(math.radians(degrees))
