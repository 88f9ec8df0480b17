"""Mesh views: inverse depth of a mesh in the training photos."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from ...datasets import Dataset
from ...datasets.dataset import map_threads
from ...depth.confidence import inner, shown_by
from ...io.mesh.files import TriangleMesh
from ...raster.mesh import mesh_depth
from ...scene import Cameras
from ...transforms import Similarity

_CURVATURE = 0.02
"""Relative second difference of inverse depth between pixels at which the confidence is one half:
folds of a surface are below it, silhouettes in front of other parts of the mesh above it."""


@dataclass(frozen=True, kw_only=True)
class MeshView:
    """Inverse depth of a mesh in one photo; a prior for `DepthTargets`."""

    inverse_depth: np.ndarray
    """[H, W] float32, 1/world unit; 0 without mesh."""
    confidence: np.ndarray
    """[H, W] float32 in [0, 1]; 0 without mesh, at silhouettes and in masked pixels."""
    aligned: bool = True
    """True if it has the scale of the capture."""


def mesh_views(
    mesh: TriangleMesh,
    photos: Dataset,
    *,
    threads: int = 0,
    on_progress: Callable[[int, int], None] | None = None,
) -> list[MeshView | None]:
    """Render a mesh in the training views at training resolution, by index of the view.

    Held-out views and views that do not show the mesh are None.

    Args:
        mesh: Mesh in COLMAP world.
        photos: The capture.
        threads: Views processed in parallel; 0: one per core.
        on_progress: Called with (done, total) after each training view; may raise to stop.
    """
    cameras, train = photos.scene.cameras, list(photos.train)

    def render(index: int) -> MeshView | None:
        inverse = mesh_depth(
            mesh.vertices,
            mesh.triangles,
            cameras.Ks[index],
            cameras.viewmats[index],
            int(cameras.widths[index]),
            int(cameras.heights[index]),
        )
        if not inverse.any():
            return None
        known = np.where(inverse > 0, inverse, np.float32(np.nan))
        trust = inner(known, np.float32(_CURVATURE) * np.maximum(inverse, np.float32(1e-30)))
        mask = photos.mask(index) if photos.mask_mode != "none" else None
        if mask is not None:
            trust = shown_by(mask, trust)
        return MeshView(inverse_depth=inverse, confidence=trust.astype(np.float32, copy=False))

    out: list[MeshView | None] = [None] * len(photos)
    for done, view in enumerate(map_threads(render, train, threads=threads), start=1):
        out[train[done - 1]] = view
        if on_progress is not None:
            on_progress(done, len(train))
    return out


_SIDE = 400
"""Cells of the depth grid along the longer side of a photo."""
_MARGIN = 0.05
"""Share of the mesh depth, in front of the mesh, that still counts as its surface."""


class _View(NamedTuple):
    """Depth grid of a mesh in one camera, training frame."""

    projection: torch.Tensor
    """[3, 4] float32, K times the upper rows of the view matrix, in cells."""
    begins: torch.Tensor
    """[H', W'] float32, depth at which the free space ends; 0: no free space."""


class MeshFreeSpace:
    """Free space between training cameras and a mesh, training frame."""

    def __init__(
        self, views: Sequence[MeshView | None], cameras: Cameras, similarity: Similarity
    ) -> None:
        """`views`, by index of `cameras` [C], and the cameras are in COLMAP world."""
        moved = similarity.cameras_to_training(cameras)
        self._views = [
            _of_view(view.inverse_depth, moved.Ks[i] @ moved.viewmats[i, :3], similarity.scale)
            for i, view in enumerate(views)
            if view is not None
        ]

    def contains(self, means: torch.Tensor) -> torch.Tensor:
        """Return [N] bool: `means`, [N, 3], in the free space of at least one camera."""
        inside = means.new_zeros(len(means), dtype=torch.bool)
        for view in self._views:
            inside |= _before(view, means)
        return inside


def _of_view(inverse_depth: np.ndarray, projection: np.ndarray, scale: float) -> _View:
    """Compute the depth grid of a view, [H, W]: a cell is free up to the nearest mesh depth in it
    and its eight neighbours, if the mesh covers all of them."""
    cell = -(-max(inverse_depth.shape) // _SIDE)
    rows, columns = (-(-side // cell) for side in inverse_depth.shape)
    padded = np.zeros((rows * cell, columns * cell), np.float32)
    padded[: inverse_depth.shape[0], : inverse_depth.shape[1]] = inverse_depth
    cells = padded.reshape(rows, cell, columns, cell)
    nearest, farthest = cells.max(axis=(1, 3)), cells.min(axis=(1, 3))
    around = np.pad(nearest, 1, mode="edge"), np.pad(farthest, 1)
    nearest, farthest = (np.lib.stride_tricks.sliding_window_view(part, (3, 3)) for part in around)
    nearest, covered = nearest.max(axis=(2, 3)), farthest.min(axis=(2, 3)) > 0
    begins = np.where(covered, scale * (1 - _MARGIN) / np.where(covered, nearest, 1), 0)
    return _View(
        torch.from_numpy((np.diag([1 / cell, 1 / cell, 1]) @ projection).astype(np.float32)),
        torch.from_numpy(begins.astype(np.float32)),
    )


def _before(view: _View, means: torch.Tensor) -> torch.Tensor:
    """Return [N] bool: `means`, [N, 3], in front of the mesh of a view."""
    x, y, z = torch.addmm(view.projection[:, 3], means, view.projection[:, :3].T).T
    height, width = view.begins.shape
    u, v = x / z, y / z
    inside = (z > 0) & (u >= 0) & (v >= 0) & (u < width) & (v < height)
    found = torch.zeros_like(inside)
    rows = inside.nonzero().flatten()
    found[rows] = z[rows] < view.begins[v[rows].long(), u[rows].long()]
    return found
