"""LPIPS input: two pictures of one size, RGB in [-1, 1], for any network."""

from typing import Any

import numpy as np

from ..errors import ShapeError
from .image import as_float

SHORTEST_SIDE = 32
"""Minimum side, px; smaller pictures vanish in the pooling of the networks."""


def checked_pair(image: Any, target: Any) -> tuple[np.ndarray, np.ndarray]:
    """Two [1, 3, H, W] float32 arrays in [-1, 1].

    Args:
        image: [H, W, 3], float in [0, 1] or uint8.
        target: Likewise.

    Raises:
        ShapeError: Sizes differ or a side is shorter than 32 px.
    """
    a, b = as_float("image", image), as_float("target", target)
    if a.shape != b.shape:
        raise ShapeError(
            f"image and target must have the same size, got {list(a.shape)} and {list(b.shape)}."
        )
    if min(a.shape[:2]) < SHORTEST_SIDE:
        raise ShapeError(
            f"LPIPS needs pictures of at least {SHORTEST_SIDE} x {SHORTEST_SIDE} pixels, "
            f"got {a.shape[1]} x {a.shape[0]}."
        )
    one, other = (
        np.ascontiguousarray((x * 2.0 - 1.0).transpose(2, 0, 1)[None], dtype=np.float32)
        for x in (a, b)
    )
    return one, other
