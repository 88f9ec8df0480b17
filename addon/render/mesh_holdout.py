"""Mesh holdout of a picture: share of each pixel that meshes hide, and from which depth on."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ..cameras.render_camera import RenderCamera
from ..core import Rendered, mesh_depth
from ..triangles import Triangles, joined, repeated
from .holdout_meshes import HoldoutMesh
from .picture import Window

_SAMPLES = 4
"""Samples along either side of a pixel at which meshes are rasterized."""
MOST_TRIANGLES = 20_000_000
"""Limit of the triangles of all holdout meshes, each instance counted."""
_AT_ONCE = 1 << 22
"""Samples of one band."""
_BLENDED = ("rgb", "alpha")
_PICTURES = (*_BLENDED, "depth", "inverse_depth", "median_depth")


@dataclass(frozen=True, kw_only=True)
class Hidden:
    """Parts of a picture that meshes hide."""

    share: np.ndarray
    """[H, W] float32, coverage of a pixel by meshes."""
    far: np.ndarray
    """[H, W] float32, z of the meshes that cover it; NaN: none."""

    def inside(self, window: Window | None) -> "Hidden":
        """The part in a window of the picture; None: everything."""
        if window is None:
            return self
        left, top, width, height = window
        part = (slice(top, top + height), slice(left, left + width))
        return Hidden(share=self.share[part], far=self.far[part])

    @property
    def edges(self) -> Window | None:
        """The smallest window with all partly covered pixels; None: there are none."""
        rows, columns = np.nonzero((self.share > 0) & (self.share < 1))
        if not len(rows):
            return None
        left, top = int(columns.min()), int(rows.min())
        return left, top, int(columns.max()) - left + 1, int(rows.max()) - top + 1


def hidden(meshes: Sequence[HoldoutMesh], camera: RenderCamera) -> Hidden:
    """The parts of a camera's picture that meshes hide, by 4 x 4 samples per pixel.

    Raises:
        ValueError: there are too many triangles.
    """
    count = sum(len(m.triangles.triangles) * len(m.matrices) for m in meshes)
    if count > MOST_TRIANGLES:
        raise ValueError(
            f"Holdout meshes have {count:,} triangles with all instances; the limit is "
            f"{MOST_TRIANGLES:,}. Use a simpler mesh as holdout."
        )
    mesh, height = joined([repeated(m.triangles, m.matrices) for m in meshes]), camera.height
    rows = max(1, _AT_ONCE // (_SAMPLES**2 * camera.width))
    bands = [slice(first, min(first + rows, height)) for first in range(0, height, rows)]
    share = np.zeros((height, camera.width), np.float32)
    far = np.full_like(share, np.nan)

    def sample(band: slice) -> None:
        share[band], far[band] = _sampled(mesh, camera, band)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(sample, bands))
    return Hidden(share=share, far=far)


def _sampled(mesh: Triangles, camera: RenderCamera, band: slice) -> tuple[np.ndarray, np.ndarray]:
    """`Hidden.share` and `far` of some rows."""
    K = camera.K.copy()
    K[1, 2] -= band.start
    K[:2] *= _SAMPLES
    inverse = mesh_depth(
        mesh.vertices,
        mesh.triangles,
        K,
        camera.viewmat,
        camera.width * _SAMPLES,
        (band.stop - band.start) * _SAMPLES,
        near=camera.near,
        orthographic=camera.orthographic,
    ).reshape(band.stop - band.start, _SAMPLES, camera.width, _SAMPLES)
    hits = (inverse > 0).sum((1, 3), dtype=np.float32)
    with np.errstate(invalid="ignore"):
        # The mean of inverse depths is that of a plane in the middle of the pixel.
        far = hits / inverse.sum((1, 3), dtype=np.float32)
    return hits / np.float32(_SAMPLES**2), far


def cut(covered: Rendered, free: Rendered | None, at: Hidden) -> tuple[Rendered, np.ndarray]:
    """A picture without background in which meshes hide the splats behind them.

    Args:
        covered: Picture of the splats in front of the meshes.
        free: Picture of all splats, in the window `at.edges`; None if that is None.
        at: The parts that meshes hide.

    Returns:
        The picture, with the depths of the larger part of each pixel; and [H, W] float32, the
        share of the background that still shows.
    """
    light = (1 - at.share) * (1 - covered.alpha)
    if free is None or at.edges is None:
        return covered, light
    left, top, width, height = at.edges
    part = (slice(top, top + height), slice(left, left + width))
    share = at.share[part]
    light[part] = (1 - share) * (1 - free.alpha)
    mixed = {name: getattr(covered, name) for name in _PICTURES}
    mixed = {name: picture.copy() for name, picture in mixed.items() if picture is not None}
    for name, picture in mixed.items():
        mine, other = picture[part], getattr(free, name)
        weight = (share if name in _BLENDED else np.round(share)).reshape(
            share.shape + (1,) * (mine.ndim - 2)
        )
        picture[part] = weight * mine + (1 - weight) * other
    return replace(covered, **mixed), light
