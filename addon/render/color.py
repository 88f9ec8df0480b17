"""Color conversion: from the sRGB values of blended splats to Blender's passes and views."""

from typing import Any

import numpy as np

from ..compat import TEXTURES_ARE_ENCODED
from ..srgb import decode, encode

NOTHING = 1e10
"""Depth of an empty pixel, as Blender's own engines write it."""
EXPONENT = 2.2
"""Gamma with which Blender encodes overlays of a view's picture."""


def combined(rgb: np.ndarray, alpha: np.ndarray | None, *, to_scene: np.ndarray) -> np.ndarray:
    """A picture for Blender's Combined pass.

    Args:
        rgb: [H, W, 3] sRGB values, over black if there is an alpha, else over the background,
            which is decoded with them.
        alpha: [H, W] coverage; None: 1. Colours are decoded as straight alpha, so that a saved
            PNG contains the splats' own colours.
        to_scene: [3, 3], from linear Rec. 709 to the file's working space.

    Returns:
        [H, W, 4] float32, scene-linear, premultiplied, the bottom row first.
    """
    out = np.ones((*rgb.shape[:2], 4), np.float32)
    if alpha is not None:
        out[..., :3] = decode(_straight(rgb, alpha)) * alpha[..., None]
        out[..., 3] = alpha
    else:
        out[..., :3] = decode(rgb)
    if not np.allclose(to_scene, np.eye(3), atol=1e-6):
        out[..., :3] = out[..., :3] @ to_scene.T.astype(np.float32)
    return np.ascontiguousarray(out[::-1])


def over_view(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """A texture to draw over a view's picture, [H, W, 4] float32, the bottom row first: linear,
    premultiplied, and encoded if Blender does not encode it.

    Args:
        rgb: [H, W, 3] sRGB values over black.
        alpha: [H, W] coverage.
    """
    out = np.empty((*alpha.shape, 4), np.float32)
    light = np.clip(_straight(rgb, alpha), 0, 1) ** np.float32(EXPONENT) * alpha[..., None]
    out[..., :3] = encode(light) if TEXTURES_ARE_ENCODED else light
    out[..., 3] = alpha
    return np.ascontiguousarray(out[::-1])


def _straight(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Colors [H, W, 3] divided by alpha [H, W]."""
    share = alpha[..., None]
    return np.divide(rgb, share, out=np.zeros_like(rgb), where=share > 0)


def z_pass(rendered: Any) -> np.ndarray:
    """Planar depths for Blender's Depth pass, [H, W] float32, the bottom row first.

    The z at which half of the light is blocked; the splats' mean z if they block less than half;
    `NOTHING` where there are none.
    """
    z = np.where(rendered.median_depth > 0, rendered.median_depth, rendered.depth)
    return np.ascontiguousarray(np.where(z > 0, z, np.float32(NOTHING))[::-1])
