"""Render splats with numpy and the native library alone: what Blender and scripts call."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import ShapeError
from ..io.ply import read_splats
from ..splats import SH_REST_BY_DEGREE, Splats
from . import _native

_DEPTHS = _native.OUT_INVERSE_DEPTH | _native.OUT_DEPTH | _native.OUT_MEDIAN_DEPTH


@dataclass(frozen=True, kw_only=True)
class Rendered:
    """A rendered view; all arrays float32. Pixel (0, 0) is the top left."""

    rgb: np.ndarray
    """[H, W, 3], background included, in the encoding of the training images; may exceed 1."""
    alpha: np.ndarray
    """[H, W], coverage in [0, 1]."""
    inverse_depth: np.ndarray | None
    """[H, W], sum of weight / z, not divided by alpha; 1 / world units."""
    depth: np.ndarray | None
    """[H, W], expected z: sum of weight * z / sum of weight; world units, 0 where nothing is."""
    median_depth: np.ndarray | None
    """[H, W], z at which half of the light is blocked; world units, 0 where it never is."""
    visible: int
    """Splats that reach the image."""


def render(
    splats: Splats | str | Path,
    K: np.ndarray,
    viewmat: np.ndarray,
    width: int,
    height: int,
    *,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    sh_degree: int | None = None,
    near: float = 0.01,
    far: float = 1e10,
    eps2d: float = 0.3,
    antialias: bool = False,
    depths: bool = True,
    orthographic: bool = False,
    window: tuple[int, int, int, int] | None = None,
    threads: int = 0,
    cancel: _native.CancelFlag | None = None,
) -> Rendered:
    """Render splats from one camera (Kerbl et al. 2023; EWA of Zwicker et al. 2001).

    Args:
        splats: The model, or the path of a 3DGS PLY.
        K: [3, 3] pixels, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; pixel centres lie at +0.5.
        viewmat: [4, 4] world to camera, OpenCV axes (+x right, +y down, +z forward).
        width: Pixels.
        height: Pixels.
        background: Colour behind the splats, in the encoding of the training images.
        sh_degree: Degree of the spherical harmonics used; None: all that are stored.
        near: Splats with z at or below this are not drawn; world units.
        far: Splats beyond this are not drawn; world units.
        eps2d: Added to the diagonal of the 2D covariance, px^2.
        antialias: Compensate opacities for `eps2d`, as Mip-Splatting models expect.
        depths: Make the three depths too; without them, which are then None, a fifth faster.
        orthographic: Parallel rays: K's focal lengths are pixels per world unit, x = fx X + cx,
            and colours are those seen along the camera's +z.
        window: Left, top, width and height, pixels: only this part of the picture is drawn and
            returned, bit for bit as in the whole one.
        threads: 0: all cores.
        cancel: Set it from another thread to stop.

    Returns:
        The picture and its depths.

    Raises:
        ShapeError: K, viewmat, size, window or degree cannot be used.
        FormatError: The file is not a splat PLY.
        BackendError: The native library is missing or out of memory.
        Cancelled: `cancel` was set.
    """
    if not isinstance(splats, Splats):
        splats = read_splats(Path(splats))
    degree = splats.sh_degree if sh_degree is None else sh_degree
    if not 0 <= degree <= splats.sh_degree:
        raise ShapeError(
            f"sh_degree must be 0 to {splats.sh_degree}, what the splats hold, got {degree}."
        )
    _native.check_size(width, height)
    K, viewmat = np.asarray(K, np.float64), np.asarray(viewmat, np.float64)
    camera = _native.camera_struct(viewmat, K, width, height, near, far, orthographic=orthographic)
    part, tiles = (..., None) if window is None else _window(window, width, height)
    options = _native.options_struct(
        eps2d=eps2d,
        antialias=antialias,
        background=background,
        outputs=_DEPTHS if depths else 0,
        threads=threads,
        cancel=cancel,
        tiles=None if tiles is None else tiles.ctypes.data,
    )
    arrays = [
        np.ascontiguousarray(a)
        for a in (
            splats.means,
            splats.quats,
            splats.scales,
            splats.opacities,
            splats.sh0,
            splats.shN,
        )
    ]
    pointers = [a.ctypes.data for a in arrays]
    struct = _native.SplatsStruct(
        len(splats), *pointers, SH_REST_BY_DEGREE[splats.sh_degree], degree, 1
    )
    shape = (height, width)
    rgb, alpha = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32)
    inverse, depth, median = (np.zeros(shape, np.float32) if depths else None for _ in range(3))
    image = _native.ImageStruct(
        *(None if a is None else a.ctypes.data for a in (rgb, alpha, inverse, depth, median))
    )
    with _native.pool.lend() as raster:
        raster.forward(struct, camera, options, image)
        visible = raster.stats().visible
    if depth is not None:
        np.divide(depth, alpha, out=depth, where=alpha > 0)
    drawn = (None if a is None else a[part] for a in (rgb, alpha, inverse, depth, median))
    rgb, alpha, inverse, depth, median = drawn
    assert rgb is not None and alpha is not None
    return Rendered(
        rgb=rgb,
        alpha=alpha,
        inverse_depth=inverse,
        depth=depth,
        median_depth=median,
        visible=visible,
    )


def _window(
    window: tuple[int, int, int, int], width: int, height: int
) -> tuple[tuple[slice, slice], np.ndarray]:
    """Rows and columns of a window, and the tiles it touches, [rows, columns] uint8."""
    left, top, wide, high = window
    if not (0 <= left < left + wide <= width and 0 <= top < top + high <= height):
        raise ShapeError(
            f"window must be left, top, width and height inside {width} x {height} px, got "
            f"{window}."
        )
    tiles = np.zeros((-(-height // _native.TILE), -(-width // _native.TILE)), np.uint8)
    rows = slice(top // _native.TILE, -(-(top + high) // _native.TILE))
    tiles[rows, left // _native.TILE : -(-(left + wide) // _native.TILE)] = 1
    return (slice(top, top + high), slice(left, left + wide)), tiles
