"""Color conversion: from the sRGB values of blended splats to Blender's passes and views, and from
the world to the uniform background over which splats are rendered.
"""

from typing import Any

import bpy
import numpy as np

from ..compat import TEXTURES_ARE_ENCODED, rec709_to_scene, world_nodes
from ..srgb import decode, encode

NOTHING = 1e10
"""Depth of an empty pixel, as Blender's own engines write it."""
_ROWS = 32
"""Rows that are converted at once: fresh memory for temporary arrays takes longer than the rest."""
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
    out = np.empty((*rgb.shape[:2], 4), np.float32)
    turns = not np.allclose(to_scene, np.eye(3), atol=1e-6)
    for first in range(0, len(out), _ROWS):
        rows = slice(first, first + _ROWS)
        own = out[::-1][rows]
        if alpha is not None:
            own[..., :3] = decode(_straight(rgb[rows], alpha[rows])) * alpha[rows, :, None]
            own[..., 3] = alpha[rows]
        else:
            own[..., :3], own[..., 3] = decode(rgb[rows]), 1
        if turns:
            own[..., :3] = own[..., :3] @ to_scene.T.astype(np.float32)
    return out


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


def world_of(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> bpy.types.World | None:
    """The world that a view layer shows; None: none."""
    return (layer.world_override or scene.world) if layer.use_sky else None


def world_light(world: bpy.types.World | None) -> tuple[np.ndarray, str]:
    """Scene-linear colour of the background [3], and a warning if the world is not uniform."""
    if world is None:
        return np.zeros(3), ""
    tree = world_nodes(world)
    if tree is None:
        return np.array(world.color), ""
    node = next((n for n in tree.nodes if n.type == "BACKGROUND"), None)
    if node is not None and not any(s.is_linked for s in node.inputs):
        return np.array(node.inputs[0].default_value[:3]) * node.inputs[1].default_value, ""
    return (
        np.array(world.color),
        f"World {world.name} is not one uniform color: its viewport color is used. To render "
        f"splats over the world, turn on Transparent and composite them.",
    )


def light_of(depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    """Scene-linear colour [3] of the background of a depsgraph."""
    return world_light(world_of(depsgraph.scene, depsgraph.view_layer_eval))[0]


def background_of(light: np.ndarray) -> tuple[float, float, float]:
    """sRGB values of a scene-linear colour."""
    rec709 = np.linalg.solve(rec709_to_scene(), np.asarray(light, np.float64))
    r, g, b = (float(v) for v in encode(rec709))
    return r, g, b
