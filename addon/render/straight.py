"""Photos of lenses that bend lines, as a straight lens would have taken them."""

import numpy as np

from ..cameras.objects import PhotoCamera
from ..core import BENT, Pixels, bent_pixels

STRAIGHT = frozenset({"PINHOLE", "SIMPLE_PINHOLE"})
"""Models without a bend."""
_ROWS = 64
"""That are looked up at once."""
_STEP = 1e-3
"""How much farther out, as a share, a ray has to land farther out too."""


def can_straighten(own: PhotoCamera) -> bool:
    """Whether photos of a camera are straight, or can be made so."""
    return own.model in STRAIGHT | BENT


def straightened(picture: np.ndarray, own: PhotoCamera) -> tuple[np.ndarray, np.ndarray]:
    """A photo through the pinhole of its camera's K.

    Args:
        picture: [H, W, D] float32, of another size than the camera's too.
        own: Its camera, of a model in `BENT`.

    Returns:
        The same of what K sees, and [H, W] bool, which of its pixels the photo shows.
    """
    height, width = picture.shape[:2]
    scale = np.array([width / own.width, height / own.height])
    lookup, out, seen = Pixels(picture), np.empty_like(picture), np.zeros((height, width), bool)
    middle, focal = own.K[:2, 2], own.K[[0, 1], [0, 1]]
    for top in range(0, height, _ROWS):
        rows = slice(top, min(top + _ROWS, height))
        places = np.mgrid[rows, 0:width][::-1].reshape(2, -1).T + 0.5
        rays = (places / scale - middle) / focal
        found = bent_pixels(own.model, own.params, rays)
        farther = bent_pixels(own.model, own.params, rays * (1 + _STEP))
        # Beyond a fold of the lens's formula the photo would show once more, mirrored.
        folded = np.hypot(*(farther - middle).T) < np.hypot(*(found - middle).T)
        x, y = (found * scale - 0.5).T
        with np.errstate(invalid="ignore"):
            there = (x >= -0.5) & (y >= -0.5) & (x <= width - 0.5) & (y <= height - 0.5)
        there &= ~folded
        shape = rows.stop - rows.start, width
        seen[rows] = there.reshape(shape)
        x, y = np.clip(np.where(there, x, 0), 0, width - 1), np.where(there, y, 0)
        lookup.bilinear(x.reshape(shape), np.clip(y, 0, height - 1).reshape(shape), out[rows])
    out[~seen] = 0
    return out, seen
