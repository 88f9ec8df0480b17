"""Before/after pictures of edited splats: the error, and one view rendered before and after."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...edit.pipeline import EditViews
from ...io.images.png import SIGNED, write_png
from ...metrics.image import psnr
from ...raster.api import Rendered, render_camera
from ...sampling import evenly_spaced
from ...scene import Cameras
from ...splats import Splats
from ..terminal.status import Counted, Status
from .stills import to_rgb

_SIZE = (960, 720)
"""Size of a picture without cameras, px."""
_FOCAL = 1.1
"""Focal length of its camera, as a share of the width."""
_GUTTER = 8
"""White pixels between both pictures."""


@dataclass(frozen=True, kw_only=True)
class PictureLoss:
    """Renders after a change compared to renders before it."""

    psnr: float | None
    """Mean over the changed views, dB; None: no view changed."""
    worst: str
    """Name of the view with the largest change; empty: no view changed."""
    worst_psnr: float | None
    """PSNR of that view, dB."""
    views: int
    """Number of rendered views."""
    unchanged: int
    """Views whose pictures are bit-identical."""


def picture_loss(
    before: Splats, after: Splats, views: EditViews, most: int, status: Status
) -> PictureLoss:
    """Difference of pictures, clamped to [0, 1], over black, in at most `most` even views."""
    cameras = views.cameras
    chosen = evenly_spaced(range(len(cameras)), most)
    progress = Counted(status, len(chosen), "view")
    found: dict[str, float] = {}
    for done, i in enumerate(chosen, start=1):
        pictures = [_picture(splats, cameras, i, views) for splats in (after, before)]
        found[cameras.names[i]] = psnr(*pictures)
        progress(done, "measuring")
    changed = {name: worth for name, worth in found.items() if math.isfinite(worth)}
    worst = min(changed, key=changed.__getitem__, default="")
    return PictureLoss(
        psnr=math.fsum(changed.values()) / len(changed) if changed else None,
        worst=worst,
        worst_psnr=changed.get(worst),
        views=len(found),
        unchanged=len(found) - len(changed),
    )


def write_before_after(
    path: Path, before: Splats, after: Splats, views: EditViews, index: int
) -> None:
    """Write one view before (left) and after (right) the change as a PNG."""
    pair = [to_rgb(_rendered(s, views.cameras, index, views)) for s in (before, after)]
    gutter = np.full((len(pair[0]), _GUTTER, 3), 255, np.uint8)
    write_png(path, np.concatenate([pair[0], gutter, pair[1]], axis=1), SIGNED)


def some_view(splats: Splats) -> Cameras:
    """A camera that shows most of the splats from the front and slightly above, with y down as in
    COLMAP's world."""
    low, high = np.quantile(splats.means.astype(np.float64), (0.05, 0.95), axis=0)
    middle, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-6)
    width, height = _SIZE
    forward = np.array([0.25, 0.35, 1.0])
    forward /= np.linalg.norm(forward)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    viewmat = np.eye(4)
    viewmat[:3, :3] = right, np.cross(forward, right), forward
    distance = 1.1 * radius * 2 * _FOCAL * width / height
    viewmat[:3, 3] = -viewmat[:3, :3] @ (middle - distance * forward)
    focal = _FOCAL * width
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Cameras(
        viewmats=viewmat[None],
        Ks=K[None],
        widths=np.array([width], np.int64),
        heights=np.array([height], np.int64),
        names=("view",),
    )


def _picture(splats: Splats, cameras: Cameras, index: int, views: EditViews) -> np.ndarray:
    return np.clip(_rendered(splats, cameras, index, views).rgb, 0, 1)


def _rendered(splats: Splats, cameras: Cameras, index: int, views: EditViews) -> Rendered:
    how = {"near": views.near, "antialias": views.antialias, "threads": views.threads}
    return render_camera(splats, cameras, index, **how, device="cpu")
