"""Support of a mesh by SfM: observations on, in front of and behind the mesh."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...datasets import Dataset
from ...datasets.tracks import Tracks
from .mesh_views import MeshView

ON_MESH = 0.05
"""Relative depth difference up to which a point counts as on the mesh."""
FEW = 50
"""Least observations for a statement on the mesh."""
_NEIGHBOURS, _REACH = 3, 0.1
"""Most observations that weight a pixel, and their largest distance relative to the photo's longer
side."""
_COLUMNS = 400
"""Columns of the grid on which weights are computed."""


@dataclass(frozen=True, kw_only=True)
class MeshSupport:
    """Observations of SfM points in one photo where it shows the mesh."""

    pixels: np.ndarray
    """[M, 2] float64, px."""
    ratios: np.ndarray
    """[M] float64, depth of the point divided by that of the mesh."""

    @property
    def on(self) -> np.ndarray:
        """[M] bool: the observations on the mesh."""
        return np.abs(self.ratios - 1) <= ON_MESH


@dataclass(frozen=True, kw_only=True)
class MeshSupportTotals:
    """Counts of observations in all photos: on, in front of and behind the mesh."""

    on: int
    before: int
    behind: int

    @property
    def total(self) -> int:
        """Number of observations."""
        return self.on + self.before + self.behind

    def __str__(self) -> str:
        if self.total < FEW:
            return "almost no points of the capture are observed there"
        shares = [f"{part / self.total:.0%}" for part in (self.on, self.before, self.behind)]
        return (
            f"of the points observed there {shares[0]} are on it within {ON_MESH:.0%}, "
            f"{shares[1]} in front of it and {shares[2]} behind it"
        )


def measure_mesh_support(
    views: Sequence[MeshView | None], photos: Dataset, tracks: Tracks | None
) -> list[MeshSupport | None]:
    """Compare a mesh with the points observed in each photo, by index of the view.

    None where a photo does not show the mesh, and for all photos of a capture without tracks:
    points without an observation may be hidden by the mesh.
    """
    cameras = photos.scene.cameras
    found: list[MeshSupport | None] = [None] * len(views)
    for index, view in enumerate(views):
        if view is None or tracks is None:
            continue
        local = tracks.points[tracks.observed[index]] @ cameras.viewmats[index, :3, :3].T
        local += cameras.viewmats[index, :3, 3]
        x, y, z = (local[local[:, 2] > 0] @ cameras.Ks[index].T).T
        height, width = view.inverse_depth.shape
        inside = (x >= 0) & (y >= 0) & (x < width * z) & (y < height * z)
        pixels, z = np.stack([x, y], axis=1)[inside] / z[inside, None], z[inside]
        at = pixels.astype(np.int64)
        ratios = z * view.inverse_depth[at[:, 1], at[:, 0]]  # 0 where the mesh is not
        found[index] = MeshSupport(pixels=pixels[ratios > 0], ratios=ratios[ratios > 0])
    return found


def total_support(found: Sequence[MeshSupport | None]) -> MeshSupportTotals:
    """Count the observations in all photos."""
    known = [one for one in found if one is not None]
    ratios = np.concatenate([one.ratios for one in known]) if known else np.zeros(0)
    return MeshSupportTotals(
        on=int((np.abs(ratios - 1) <= ON_MESH).sum()),
        before=int((ratios < 1 - ON_MESH).sum()),
        behind=int((ratios > 1 + ON_MESH).sum()),
    )


def weighted_views(
    views: Sequence[MeshView | None], found: Sequence[MeshSupport | None]
) -> list[MeshView | None]:
    """Weight the confidence of the views by the support of the mesh: the share of the observations
    around a pixel that are on the mesh.

    Points reveal objects in front of the mesh or visible through it, so a floor mesh needs no hole
    for a vase on it. Without observations nearby, the weight is on / (on + behind) over all photos,
    so that a misplaced mesh does less harm.
    """
    total = total_support(found)
    elsewhere = total.on / (total.on + total.behind) if total.on + total.behind >= FEW else 1.0
    out: list[MeshView | None] = []
    for view, one in zip(views, found, strict=True):
        if view is not None and one is not None:
            share = _shares(view.confidence.shape, one, elsewhere)
            view = replace(view, confidence=view.confidence * share)
        out.append(view)
    return out


def _shares(shape: tuple[int, ...], found: MeshSupport, elsewhere: float) -> np.ndarray:
    """Return [H, W] float32: share of the observations near a pixel that are on the mesh;
    `elsewhere` without any."""
    from scipy.spatial import KDTree

    if len(found.ratios) == 0:
        return np.full(shape, elsewhere, np.float32)
    height, width = shape
    step = max(1, round(width / _COLUMNS))
    rows, columns = np.arange(0, height, step), np.arange(0, width, step)
    v, u = np.meshgrid(rows + 0.5 * step, columns + 0.5 * step, indexing="ij")
    places = np.stack([u.ravel(), v.ravel()], axis=1)
    count = min(_NEIGHBOURS, len(found.ratios))
    distances, at = KDTree(found.pixels).query(
        places, k=count, distance_upper_bound=_REACH * max(height, width)
    )
    near = np.isfinite(distances).reshape(-1, count)
    on = np.append(found.on, False)[at].reshape(-1, count) & near
    observed = near.sum(axis=1)
    share = np.where(observed > 0, on.sum(axis=1) / np.maximum(observed, 1), elsewhere)
    grid = share.astype(np.float32).reshape(v.shape).repeat(step, axis=0).repeat(step, axis=1)
    return grid[:height, :width]
