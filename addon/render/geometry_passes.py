"""Passes of the splats' surface: normals and positions in world space, and motion."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..cameras.panorama import Panorama
from ..cameras.render_camera import RenderCamera
from ..core import Rendered
from .color import NOTHING
from .picture import Window
from .scene import Identity


@dataclass(frozen=True, kw_only=True)
class Placement:
    """Camera and objects at a frame."""

    camera: RenderCamera | Panorama
    matrices: Mapping[Identity, np.ndarray]
    """[4, 4] to the world, of one object of each identity."""


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


def vector_pass(
    world: np.ndarray,
    known: np.ndarray,
    frames: list[Placement],
    covered: Mapping[Identity, np.ndarray],
) -> np.ndarray:
    """Motion for Blender's Vector pass: where what a pixel shows was in the picture of the frame
    before, minus where it is, and where it is, minus where it will be; 0 for panoramas.

    Args:
        world: World positions [H, W, 3], the bottom row first, as the pass Position.
        known: Where there are splats [H, W].
        frames: The previous frame, the frame itself, and the next.
        covered: Coverage of each pixel by each object [H, W].

    Returns:
        [H, W, 4] float32, pixels, the y axis up, the bottom row first.
    """
    before, now, after = frames
    out = np.zeros((*known.shape, 4), np.float32)
    if any(isinstance(one.camera, Panorama) for one in frames):
        return out
    shown = _shown(covered)
    here = _pixels(now, now, world, shown)
    out[..., :2] = _pixels(now, before, world, shown) - here
    out[..., 2:] = here - _pixels(now, after, world, shown)
    out[~known] = 0
    return out


def _shown(covered: Mapping[Identity, np.ndarray]) -> dict[Identity, np.ndarray]:
    """The pixels [H, W] bool that each object covers most."""
    if not covered:  # there are only holdouts
        return {}
    most = np.argmax(np.stack(list(covered.values())), axis=0)
    return {owner: most == number for number, owner in enumerate(covered)}


def _pixels(
    now: Placement,
    other: Placement,
    world: np.ndarray,
    shown: Mapping[Identity, np.ndarray],
) -> np.ndarray:
    """Places [H, W, 2] in another frame's picture of what is shown now, pixels, the y axis up."""
    moved = world.astype(np.float64)
    for owner, part in shown.items():
        mine, there = now.matrices.get(owner), other.matrices.get(owner)
        if mine is not None and there is not None and not np.array_equal(mine, there):
            change = there @ np.linalg.inv(mine)
            moved[part] = moved[part] @ change[:3, :3].T + change[:3, 3]
    camera = other.camera
    seen = moved @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    scale = 1.0 if camera.orthographic else np.maximum(seen[..., 2], 1e-9)
    x = camera.K[0, 0] * seen[..., 0] / scale + camera.K[0, 2]
    y = camera.K[1, 1] * seen[..., 1] / scale + camera.K[1, 2]
    return np.stack([x, -y], -1)
