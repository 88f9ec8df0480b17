"""Photo renders: small renders of training photos as points, warped into other views."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from ..raster.api import Rendered, render, render_camera
from ..raster.gpu.choice import CPU, Chosen
from ..raster.request import Frustum
from ..scene import Cameras, camera_centers
from ..splats import Splats

_SIDE = 128
"""Longer side of the renders, px: their points leave no gaps in a picture of half the size at half
the distance."""
_MOST_KEPT = 256
"""Most renders that are kept: 110 MB."""
_SOLID = 0.5
"""Least opacity of a pixel with a surface; the others are infinitely far."""
_FAR = 1e6
"""Their distance, in sizes of the capture."""
_FACING = 0.5
"""Cosine of the largest angle between the directions from which a photo and a view show a surface.
From the other side it would be another surface."""


@dataclass(frozen=True)
class Warped:
    """The P points of a photo that are in a view."""

    pixels: np.ndarray
    """[P] int, row * width + column in the view; several points may have the same."""
    z: np.ndarray
    """[P], depth in the view, world units."""
    rgb: np.ndarray
    """[P, 3] float32, colour in the photo's render, 0 to 1."""


class PhotoRenders:
    """Renders of a model in its training photos, each made when it is first used."""

    def __init__(
        self,
        splats: Splats,
        cameras: Cameras,
        *,
        near: float = 0.01,
        antialias: bool = False,
        threads: int = 0,
        device: Chosen = CPU,
    ) -> None:
        """Render nothing yet.

        Args:
            splats: The model, world units; its arrays must not change.
            cameras: Cameras of the capture, same world.
            near: Near plane, world units.
            antialias: Whether opacities are compensated.
            threads: 0: all cores.
            device: What draws.
        """
        self.cameras = cameras
        self.near = near
        self._splats = splats
        self._small = resized(cameras, _SIDE)
        self._how: dict[str, Any] = {"near": near, "antialias": antialias, "threads": threads}
        self._how |= {"device": device, "keep": True}
        self._far = _FAR * max(float(np.ptp(cameras.centers, axis=0).max()), near)
        self._points = lru_cache(_MOST_KEPT)(self._points_of)

    def frustum(self, view: int, longest: int) -> Frustum:
        """A view of the capture with at most `longest` pixels a side."""
        small = resized(self.cameras, longest)
        size = int(small.widths[view]), int(small.heights[view])
        return Frustum(small.viewmats[view], small.Ks[view], *size, self.near)

    def colours(self, view: Frustum) -> np.ndarray:
        """[H * W, 3] float32, 0 to 1, colours that the model shows in a view.

        It is rendered at twice its size and averaged, as the points of a photo in a pixel are.
        """
        K = view.K * np.array([[2.0], [2.0], [1.0]])
        size = 2 * view.width, 2 * view.height
        rgb = render(self._splats, K, view.viewmat, *size, depths=False, **self._how).rgb
        parts = _displayed(rgb).reshape(view.height, 2, view.width, 2, 3)
        return parts.mean(axis=(1, 3)).reshape(-1, 3)

    def warp(self, photo: int, view: Frustum) -> Warped:
        """The points of a photo's render in a view, without those that the photo shows from a
        direction more than 60 degrees from that of the view."""
        points, rgb = self._points(photo)
        places = points @ view.viewmat[:3, :3].T + view.viewmat[:3, 3]
        z = places[:, 2]
        ahead = z > view.near
        u, v = (places @ view.K.T)[:, :2].T / np.where(ahead, z, 1.0)
        inside = ahead & (u >= 0) & (u < view.width) & (v >= 0) & (v < view.height)
        ours = points - camera_centers(view.viewmat[None])[0]
        theirs = points - self.cameras.centers[photo]
        lengths = np.linalg.norm(ours, axis=1) * np.linalg.norm(theirs, axis=1)
        inside &= np.einsum("pc,pc->p", ours, theirs) >= _FACING * lengths
        pixels = v[inside].astype(int) * view.width + u[inside].astype(int)
        return Warped(pixels, z[inside], rgb[inside])

    def _points_of(self, photo: int) -> tuple[np.ndarray, np.ndarray]:
        """World points of the pixels of a photo's render, [P, 3] float64, and colours, [P, 3]."""
        drawn = render_camera(self._splats, self._small, photo, depths=True, **self._how)
        z = self._depth(drawn)[..., None]
        v, u = np.mgrid[: z.shape[0], : z.shape[1]] + 0.5
        rays = np.stack([u, v, np.ones_like(u)], axis=-1)
        rays = rays @ np.linalg.inv(self._small.Ks[photo]).T
        viewmat = self._small.viewmats[photo]
        points = ((rays * z).reshape(-1, 3) - viewmat[:3, 3]) @ viewmat[:3, :3]
        return points, _displayed(drawn.rgb).reshape(-1, 3)

    def _depth(self, drawn: Rendered) -> np.ndarray:
        return np.where(drawn.alpha >= _SOLID, np.asarray(drawn.depth), self._far)


def _displayed(rgb: np.ndarray) -> np.ndarray:
    return np.clip(rgb, 0.0, 1.0)


def resized(cameras: Cameras, longest: int) -> Cameras:
    """The cameras with pictures of at most `longest` pixels a side."""
    scale = np.minimum(longest / np.maximum(cameras.widths, cameras.heights), 1.0)
    widths, heights = (
        np.maximum(np.round(side * scale), 1).astype(side.dtype)
        for side in (cameras.widths, cameras.heights)
    )
    Ks = cameras.Ks.copy()
    Ks[:, 0] *= (widths / cameras.widths)[:, None]
    Ks[:, 1] *= (heights / cameras.heights)[:, None]
    return replace(cameras, widths=widths, heights=heights, Ks=Ks)
