"""Raster request: the view and the render settings of a call, besides the splats."""

import ctypes as ct
from dataclasses import dataclass

from ..shared_constants import EPS2D
from .buffers import Array


class CancelFlag:
    """Flag that stops a running call from another thread: pass it to the call, then `set()` it."""

    def __init__(self) -> None:
        self.value = ct.c_int32(0)

    def set(self) -> None:
        """Make the calls it was passed to, and later ones, raise Cancelled."""
        self.value.value = 1


@dataclass(frozen=True)
class Frustum:
    """A camera with picture size, near and far plane."""

    viewmat: Array
    """[4, 4], world to camera, OpenCV axes."""
    K: Array
    """[3, 3], px, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; pixel centres are at +0.5."""
    width: int
    """Width, px."""
    height: int
    """Height, px."""
    near: float = 0.01
    """Splats with z at or below this are not drawn; world units."""
    far: float = 1e10
    """Splats beyond this are not drawn; world units."""
    orthographic: bool = False
    """Parallel rays: K's focal lengths are pixels per world unit; forward only."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Render settings that do not depend on the view."""

    raw: bool = True
    """Scales are logs and opacities logits."""
    sh_degree: int | None = None
    """SH degree to evaluate; None: the stored degree."""
    eps2d: float = EPS2D
    """Added to the diagonal of the 2D covariance, px^2."""
    antialias: bool = False
    """Multiply opacities by max(sqrt(det0 / det), 0.005)."""
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """RGB background colour."""
    outputs: int = 0
    """Bits of `header.OUT_*`: outputs besides RGB and alpha."""
    tiles: Array | None = None
    """[ceil(H / 16), ceil(W / 16)] uint8: no splat is drawn in tiles of 16 x 16 px that are 0 here;
    None: all are drawn."""
    far_depths: Array | None = None
    """[H, W]: at a pixel only splats with z at most this are drawn, in front of an opaque object;
    world units. None, or NaN at a pixel: all."""
    threads: int = 0
    """CPU threads; 0: all cores."""
    disable: int = 0
    """Bits of `header.NO_*`: skips to disable, for tests and benchmarks."""
    cancel: CancelFlag | None = None
    """Set it from another thread to stop."""
