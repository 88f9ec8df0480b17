"""Contribution of splats: blending weights summed over the pixels of cameras (LightGaussian, Fan et
al. 2024; also used for pruning in trainings)."""

from collections.abc import Callable

import numpy as np

from ..raster.blend_weights import GEOMETRY, blending_weights
from ..raster.request import Frustum, Settings
from ..scene import Cameras
from ..splats import Splats


def contributions(
    splats: Splats,
    cameras: Cameras,
    *,
    antialias: bool = False,
    near: float = 0.01,
    threads: int = 0,
    on_view: Callable[[int], None] | None = None,
) -> np.ndarray:
    """Largest contribution of each splat to a view.

    The maximum over views, because a splat that one view needs is needed; a sum over views would
    favour the background, which is visible in all.

    Args:
        splats: Raw parameters.
        cameras: Cameras in the same world.
        antialias: As the splats were trained.
        near: Splats with z at or below this are not drawn; world units.
        threads: 0: all cores; the result does not depend on it.
        on_view: Called after each view with the number of views done.

    Returns:
        [N] float32, px: largest sum of its weights in a view; 0: visible in none.

    Raises:
        ShapeError: a camera is invalid.
        BackendError: the native library is missing or out of memory.
    """
    geometry = [np.require(getattr(splats, name), requirements=["C", "A"]) for name in GEOMETRY]
    scratch = {name: np.empty_like(a) for name, a in zip(GEOMETRY, geometry, strict=True)}
    settings = Settings(antialias=antialias, threads=threads)
    most = np.zeros(len(splats), np.float32)
    for i in range(len(cameras)):
        width, height = int(cameras.widths[i]), int(cameras.heights[i])
        view = Frustum(cameras.viewmats[i], cameras.Ks[i], width, height, near)
        shares = np.ones((height, width, 3), np.float32)
        weights = blending_weights(geometry, view, settings, shares, scratch=scratch)
        np.maximum(most, weights[:, 0], out=most)
        if on_view is not None:
            on_view(i + 1)
    return most
