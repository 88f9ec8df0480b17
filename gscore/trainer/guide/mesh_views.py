"""Mesh views: inverse depth of a mesh in the training photos."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...datasets import Dataset
from ...datasets.dataset import map_threads
from ...depth.confidence import inner, shown_by
from ...io.mesh.files import TriangleMesh
from ...raster.mesh import mesh_depth

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
