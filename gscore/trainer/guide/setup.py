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
from ...text_format import count_text
from ..depth.rule import coverage
from ..depth.targets import DepthTargets
from .mesh_support import (
    FEW,
    MeshSupportTotals,
    measure_mesh_support,
    total_support,
    weighted_views,
)
from .mesh_views import MeshView, mesh_views

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
        f"is {where}. Its bounds are {_place(corners.min(axis=0))} to "
        f"{_place(corners.max(axis=0))}, those of the cameras "
        f"{_place(cameras.centers.min(axis=0))} to {_place(cameras.centers.max(axis=0))}. It must "
        "be in the world of the capture, in its axes and unit."
    )


def _place(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in point) + ")"
