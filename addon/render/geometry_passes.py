"""Passes of the splats' surface in world space: normals and positions."""

import numpy as np

from ..cameras.panorama import Panorama
from ..cameras.render_camera import RenderCamera
from ..core import Rendered
from .color import NOTHING
from .picture import Window


def normal_pass(rendered: Rendered, camera: RenderCamera) -> np.ndarray:
    """World normals for Blender's Normal pass, [H, W, 3] float32, the bottom row first: as long as
    the pixel is covered, as means over a pixel are."""
    turned = rendered.normal @ camera.viewmat[:3, :3].astype(np.float32)
    return np.ascontiguousarray((turned * rendered.alpha[..., None])[::-1])


def position_pass(
    depth: np.ndarray, camera: RenderCamera | Panorama, window: Window | None
) -> np.ndarray:
    """World positions for Blender's Position pass; 0 where there are no splats.

    Args:
        depth: [H, W], the pass Depth, the bottom row first: z, or distances of a panorama.
        camera: The camera.
        window: The part of the picture that `depth` is; None: all.

    Returns:
        [H, W, 3] float32, the bottom row first.
    """
    left, top, width, height = window or (0, 0, camera.width, camera.height)
    x, y = np.meshgrid(left + np.arange(width) + 0.5, top + np.arange(height)[::-1] + 0.5)
    known = depth < NOTHING
    z = np.where(known, depth, 0).astype(np.float64)
    if isinstance(camera, Panorama):
        places = camera.directions(x, y)[0] * z[..., None]
    else:
        K = camera.K
        right, down = (x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1]
        share = 1.0 if camera.orthographic else z
        places = np.stack([right * share, down * share, z], -1)
    world = (places - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3]
    return np.where(known[..., None], world, 0).astype(np.float32)
