"""Rasterizer API with only numpy and the native library, for Blender and scripts."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import ShapeError
from ..formats import read_decoded
from ..photo_exposure import PhotoExposure
from ..scene import Cameras, moved_viewmats, offset_between
from ..sh import rgb_to_sh0
from ..shared_constants import EPS2D
from ..splats import PARAMETERS, Splats
from ..text_format import count_text, number
from ..transforms import quat_to_rotmat
from . import _native, arguments, header
from .request import CancelFlag, Frustum, Settings

if TYPE_CHECKING:
    from .gpu.choice import Chosen
    from .render_client import RenderClient

_NO_NORMAL = 1e-5
"""Length of a sum of normals that is only rounding: there is no splat, or normals cancel."""

_MOST_ROWS = 1 << 24
"""Largest whole number up to which float32 has all."""


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
    """[H, W], expected z: sum of weight * z / sum of weight; world units, 0 where alpha is 0."""
    median_depth: np.ndarray | None
    """[H, W], z at which transmittance falls to 0.5; world units, 0 where it never does."""
    visible: int
    """Number of splats in the picture."""
    normal: np.ndarray | None = None
    """[H, W, 3], mean normal of the splats, unit length, camera axes (OpenCV), towards the camera;
    0 where alpha is 0. See `splat_normals`."""
    median_splat: np.ndarray | None = None
    """[H, W] int32, row of the splat of `median_depth`; -1 where that is 0."""

    def exposed(
        self, exposure: PhotoExposure, background: tuple[float, float, float]
    ) -> "Rendered":
        """Return the picture with the splats exposed; `background`, over which it was rendered,
        stays."""
        alpha = self.alpha[..., None]
        rest = np.array(background, np.float32) * (1 - alpha)
        return replace(self, rgb=exposure.apply(self.rgb - rest, alpha) + rest)


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
    eps2d: float = EPS2D,
    antialias: bool = False,
    depths: bool = True,
    normals: bool = False,
    median_splats: bool = False,
    orthographic: bool = False,
    window: tuple[int, int, int, int] | None = None,
    far_depths: np.ndarray | None = None,
    origin: np.ndarray | Sequence[float] | None = None,
    threads: int = 0,
    cancel: CancelFlag | None = None,
    device: "str | Chosen | RenderClient" = "auto",
    keep: bool = False,
) -> Rendered:
    """Render splats from one camera (Kerbl et al. 2023; EWA of Zwicker et al. 2001).

    Args:
        splats: The model, or the path of a splat file.
        K: [3, 3] px, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; pixel centres are at +0.5.
        viewmat: [4, 4] world to camera, OpenCV axes (+x right, +y down, +z forward).
        width: Of the picture, px.
        height: Of the picture, px.
        background: Background colour, in the encoding of the training images.
        sh_degree: Degree of the spherical harmonics used; None: the stored degree.
        near: Splats with z at or below this are not drawn; world units.
        far: Splats beyond this are not drawn; world units.
        eps2d: Added to the diagonal of the 2D covariance, px^2.
        antialias: Compensate opacities for `eps2d`, as Mip-Splatting models expect.
        depths: Compute the three depths too; if False they are None, and it is a fifth faster.
        normals: Compute the normal too, by a second picture of the same splats.
        median_splats: Compute the median splat too, by one more picture.
        orthographic: Parallel rays: K's focal lengths are pixels per world unit, x = fx X + cx,
            and the view direction of colours is the camera's +z.
        window: Left, top, width and height, px: only this part of the picture is drawn and
            returned, bit for bit as in the whole one.
        far_depths: [H, W] float32: at a pixel only splats with z at most this are drawn, in front
            of an opaque object; world units. None, or NaN at a pixel: all.
        origin: [3], the local origin of the world of `viewmat`, in the coordinates of the capture:
            zeros for these coordinates themselves. None: that of the file, which the cameras.json
            of its run has too.
        threads: 0: all cores.
        cancel: Set it from another thread to stop.
        device: What draws: `cpu`; `gpu`, a graphics card; `auto`, a graphics card if there is a
            usable one, which is tested first, or the CPU; or the number of a device in `gscore
            doctor`. In Blender `cpu`, or a `gscore.frontend.RenderClient`, which also needs arrays
            that do not change.
        keep: The graphics card may keep its copy of the splats for further pictures; their arrays
            must not change from now on.

    Returns:
        The picture and its depths.

    Raises:
        ShapeError: K, viewmat, size, window, far_depths, origin or degree cannot be used; or
            median splats of more than 2^24 splats are requested.
        FormatError: The file has no readable splats.
        ConfigError: There is no such device.
        BackendError: The native library is missing or out of memory, or the device cannot draw.
        Cancelled: `cancel` was set.
    """
    viewmat = np.asarray(viewmat, np.float64)
    if not isinstance(splats, Splats):
        found = read_decoded(Path(splats))
        splats = found.splats
        if origin is not None:
            shift = offset_between(found.origin, np.asarray(origin, np.float64))
            viewmat = moved_viewmats(viewmat, shift)
    elif origin is not None:
        raise ShapeError("origin needs a splat file, which has its own origin; got Splats.")
    arguments.check_size(width, height)  # before memory is taken
    part, tiles = (..., None) if window is None else _window(window, width, height)
    view = Frustum(
        viewmat,
        np.asarray(K, np.float64),
        width,
        height,
        near,
        far,
        orthographic,
    )
    settings = Settings(
        sh_degree=sh_degree,
        eps2d=eps2d,
        antialias=antialias,
        background=background,
        outputs=sum(header.DEPTH_OUTPUTS.values()) if depths else 0,
        tiles=tiles,
        far_depths=far_depths,
        threads=threads,
        cancel=cancel,
    )
    arrays = [np.require(getattr(splats, name), requirements=["C", "A"]) for name in PARAMETERS]
    shape = (height, width)
    pictures = {"rgb": np.zeros((*shape, 3), np.float32), "alpha": np.zeros(shape, np.float32)}
    pictures |= {name: np.zeros(shape, np.float32) for name in header.DEPTH_OUTPUTS if depths}
    visible = _draw(device, arrays, view, settings, pictures, keep=keep)
    if depths:
        depth, alpha = pictures["depth"], pictures["alpha"]
        with np.errstate(all="ignore"):
            np.divide(depth, alpha, out=depth, where=alpha > 0)
    if normals:
        pictures["normal"] = _normals(device, arrays, view, settings)
    if median_splats:
        pictures["median_splat"] = _median_splats(device, arrays, view, settings)
    drawn = {name: picture[part] for name, picture in pictures.items()}
    return Rendered(**dict.fromkeys(header.DEPTH_OUTPUTS) | drawn, visible=visible)  # pyright: ignore


def splat_normals(
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    viewmat: np.ndarray,
    *,
    orthographic: bool = False,
) -> np.ndarray:
    """Normals of splats: the shortest axis, turned to the camera (Guedon and Lepetit 2024).

    Args:
        means: [N, 3], world.
        quats: [N, 4], wxyz, of any non-zero length.
        scales: [N, 3], logarithms or standard deviations.
        viewmat: [4, 4] world to camera, OpenCV axes; may scale.
        orthographic: The camera looks along its +z everywhere, instead of from its centre.

    Returns:
        [N, 3] float64, unit length, camera axes. Of equal axes the first one counts.
    """
    shortest = np.argmin(scales, axis=1)
    with np.errstate(invalid="ignore"):  # quaternions of length 0, whose splats are not drawn
        axes = np.nan_to_num(quat_to_rotmat(quats.astype(np.float64)))
    R, t = viewmat[:3, :3], viewmat[:3, 3]
    normals = axes[np.arange(len(axes)), :, shortest] @ (R.T / np.cbrt(np.linalg.det(R)))
    towards = normals[:, 2] if orthographic else ((means @ R.T + t) * normals).sum(axis=1)
    return np.where(towards[:, None] > 0, -normals, normals)


def _normals(
    device: "str | Chosen | RenderClient",
    arrays: Sequence[np.ndarray],
    view: Frustum,
    settings: Settings,
) -> np.ndarray:
    """[H, W, 3], the normal of `Rendered`: a picture of splats whose colours are their normals."""
    means, quats, scales = arrays[:3]
    found = splat_normals(means, quats, scales, view.viewmat, orthographic=view.orthographic)
    # Colours are not below 0, so they are those of (normal + 1) / 2.
    colors = rgb_to_sh0((found + 1) / 2).astype(np.float32)[:, None]
    none = np.zeros((len(means), 0, 3), np.float32)
    shape = (view.height, view.width)
    pictures = {"rgb": np.zeros((*shape, 3), np.float32), "alpha": np.zeros(shape, np.float32)}
    plain = replace(settings, background=(0.0, 0.0, 0.0), sh_degree=0, outputs=0)
    _draw(device, [*arrays[:4], colors, none], view, plain, pictures, keep=False)
    sums = 2 * pictures["rgb"] - pictures["alpha"][..., None]
    lengths = np.linalg.norm(sums, axis=-1, keepdims=True)
    sums[lengths[..., 0] < _NO_NORMAL] = 0
    return np.divide(sums, lengths, out=sums, where=lengths >= _NO_NORMAL)


def _median_splats(
    device: "str | Chosen | RenderClient",
    arrays: Sequence[np.ndarray],
    view: Frustum,
    settings: Settings,
) -> np.ndarray:
    """[H, W] int32, as in `Rendered`."""
    count, shape = len(arrays[0]), (view.height, view.width)
    if count > _MOST_ROWS:
        raise ShapeError(
            f"median_splats: {count_text(count, 'splat')} are more than the {number(_MOST_ROWS)} "
            f"whose rows float32 values can tell apart. Draw fewer splats, or without their rows."
        )
    names = ("alpha", "median_depth")
    pictures = {"rgb": np.zeros((*shape, 3), np.float32)}
    pictures |= {name: np.zeros(shape, np.float32) for name in names}
    plain = replace(settings, sh_degree=0, outputs=header.OUT_MEDIAN_DEPTH | header.MEDIAN_SPLAT)
    _draw(device, arrays, view, plain, pictures, keep=False)
    return pictures["median_depth"].astype(np.int32) - 1


def _draw(
    device: "str | Chosen | RenderClient",
    arrays: Sequence[np.ndarray],
    view: Frustum,
    settings: Settings,
    pictures: dict[str, np.ndarray],
    *,
    keep: bool,
) -> Any:
    """Draw on a device; returns the number of splats in the picture."""
    if device == "auto":
        from .gpu.absence import no_automatic_card

        device = "cpu" if no_automatic_card() else device
    if isinstance(device, str) and device != "cpu":
        from .gpu.choice import chosen_device  # loads what only graphics cards need

        device = chosen_device(device)
    if not isinstance(device, str):
        return device.forward(arrays, view, settings, pictures, keep=keep)["visible"]
    with _native.pool.lend() as raster:
        raster.forward(arrays, view, settings, pictures)
        return raster.stats()["visible"]


def render_camera(
    splats: Splats, cameras: Cameras, index: int, *, depths: bool = False, **how: Any
) -> Rendered:
    """`render` from one of several cameras, at its size.

    Args:
        splats: The model.
        cameras: The cameras.
        index: Index of the camera.
        depths: As for `render`.
        **how: Other arguments of `render`: background, near, antialias, threads, device and
            more.

    Raises:
        As `render`.
    """
    size = int(cameras.widths[index]), int(cameras.heights[index])
    return render(splats, cameras.Ks[index], cameras.viewmats[index], *size, depths=depths, **how)


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
    tiles = np.zeros((-(-height // header.TILE), -(-width // header.TILE)), np.uint8)
    rows = slice(top // header.TILE, -(-(top + high) // header.TILE))
    tiles[rows, left // header.TILE : -(-(left + wide) // header.TILE)] = 1
    return (slice(top, top + high), slice(left, left + wide)), tiles
