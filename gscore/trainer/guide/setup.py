"""Guide setup: loss targets, free space and messages from the user's meshes."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...config import TrainConfig
from ...datasets import Dataset
from ...datasets.tracks import Tracks
from ...errors import ConfigError
from ...events import Decision
from ...io.mesh.files import TriangleMesh, read_mesh
from ...scene import offset_between
from ...text_format import count_text, point_text
from ..depth.rule import coverage
from ..depth.targets import DepthTargets
from .mesh_views import MeshView, mesh_views

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


_BEHIND = 0.3
"""Share of observed points behind a mesh above which the user is warned: outliers and rough proxies
reach a tenth."""


@dataclass(frozen=True, kw_only=True)
class GuideSetup:
    """Guide meshes of a run."""

    surface: DepthTargets | None = None
    """Depth targets of the surface mesh; None: no surface mesh."""
    free: Sequence[MeshView | None] = ()
    """Views of the free-space mesh; empty: no free-space mesh."""
    digest: str = ""
    """Hash of the meshes; empty: none."""
    decision: Decision | None = None
    """Coverage and support of the meshes; None: no meshes."""
    warnings: tuple[str, ...] = ()
    """Warnings for the user."""


def prepare_guide(
    config: TrainConfig,
    photos: Dataset,
    tracks: Tracks | None,
    *,
    on_progress: Callable[[int, int], None] | None = None,
) -> GuideSetup:
    """Read the meshes of `config` and render them in the training photos.

    Args:
        config: Options `guide_*`.
        photos: The capture.
        tracks: Tracks of the capture; None: unknown.
        on_progress: Called with (done, total) after each training view; may raise to stop.

    Raises:
        DatasetError, FormatError: a file is missing or contains no mesh.
        ConfigError: no training photo shows a mesh.
    """
    found: dict[str, Sequence[MeshView | None]] = {}
    digest, messages, warnings = hashlib.sha256(), [], []
    for role, path in (("surface", config.guide_surface), ("free", config.guide_free)):
        if path is None:
            continue
        mesh = read_mesh(path)
        digest.update(role.encode() + mesh.vertices.tobytes() + mesh.triangles.tobytes())
        shift = offset_between(photos.scene.cameras.origin, None)
        mesh = replace(mesh, vertices=mesh.vertices - shift)
        views = mesh_views(mesh, photos, threads=config.threads, on_progress=on_progress)
        if not any(view is not None for view in views):
            raise ConfigError(_unseen(path, mesh, photos))
        observed = measure_mesh_support(views, photos, tracks)
        support = total_support(observed)
        messages.append(_message(role, path, views, support))
        warnings += _position_warnings(path, support)
        found[role] = weighted_views(views, observed) if role == "surface" else views
    if not found:
        return GuideSetup()
    surface = None
    if "surface" in found:
        shown = coverage(photos.scene, photos.train).views_of_point
        surface = DepthTargets(found["surface"], train=photos.train, views=shown)
    return GuideSetup(
        surface=surface,
        free=found.get("free", ()),
        digest=digest.hexdigest()[:16],
        decision=Decision("guide", " ".join(messages)),
        warnings=tuple(warnings),
    )


def _message(
    role: str, path: Path, views: Sequence[MeshView | None], support: MeshSupportTotals
) -> str:
    shown = [view for view in views if view is not None]
    pixels = sum(view.inverse_depth.size for view in shown)
    covered = sum(int((view.inverse_depth > 0).sum()) for view in shown)
    what = "Surface mesh" if role == "surface" else "Free-space mesh"
    return (
        f"{what} {path.name} covers {covered / pixels:.0%} of the pixels of "
        f"{count_text(len(shown), 'training photo')}; {support}."
    )


def _position_warnings(path: Path, support: MeshSupportTotals) -> list[str]:
    """Return a warning if the points contradict the position of a mesh."""
    if support.total < FEW or support.behind <= _BEHIND * support.total:
        return []
    hidden = f"{support.behind / support.total:.0%}"
    return [
        f"{path} is in front of {hidden} of the points observed there, and would hide them. It "
        "may be in the wrong place or have the wrong scale: it must be in the world and unit of "
        "the capture."
    ]


def _unseen(path: Path, mesh: TriangleMesh, photos: Dataset) -> str:
    """Error text for a mesh that no photo shows, with the bounds of mesh and cameras."""
    corners = mesh.vertices[np.unique(mesh.triangles)]
    cameras = photos.scene.cameras
    z = [corners @ cameras.viewmats[i, 2, :3] + cameras.viewmats[i, 2, 3] for i in photos.train]
    where = "behind all cameras" if max(map(np.max, z)) <= 0 else "outside all their frames"
    return (
        f"{path}: none of {count_text(len(photos.train), 'training photo')} shows the mesh, which "
        f"is {where}. Its bounds are {point_text(corners.min(axis=0))} to "
        f"{point_text(corners.max(axis=0))}, those of the cameras "
        f"{point_text(cameras.centers.min(axis=0))} to "
        f"{point_text(cameras.centers.max(axis=0))}. It must be in the world of the capture, in "
        "its axes and unit."
    )
