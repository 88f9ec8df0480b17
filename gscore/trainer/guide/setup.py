"""Guide setup: from the user's meshes to loss targets, free space and messages."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...config import TrainConfig
from ...datasets import Dataset
from ...errors import ConfigError
from ...io.mesh.files import read_mesh
from ...io.mesh.triangles import TriangleMesh
from ...scene import offset_between
from ...text_format import count_words
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
"""Share of the points seen that a mesh would hide, from which on it is told that it may be wrong:
a tenth is what outliers and rough proxies come to."""


@dataclass(frozen=True, kw_only=True)
class GuideSetup:
    """The guides of a run."""

    surface: DepthTargets | None = None
    """Depths of the mesh on which splats lie; None: there is none."""
    free: Sequence[MeshView | None] = ()
    """Views of the mesh before which nothing stands; empty: there is none."""
    digest: str = ""
    """Changes with any of the meshes; empty: there are none."""
    why: str = ""
    """Sentences on what the meshes are seen to be."""
    warnings: tuple[str, ...] = ()
    """Sentences for the user."""


def prepare_guide(
    config: TrainConfig,
    photos: Dataset,
    *,
    on_progress: Callable[[int, int], None] | None = None,
) -> GuideSetup:
    """Read the meshes that `config` names and look at them from the training photos.

    Raises:
        DatasetError, FormatError: a file is missing or holds no mesh.
        ConfigError: no training photo sees a mesh.
    """
    found: dict[str, Sequence[MeshView | None]] = {}
    digest, words, warnings = hashlib.sha256(), [], []
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
        sightings = measure_mesh_support(views, photos)
        said = total_support(sightings)
        words.append(_words(role, path, views, said))
        warnings += _doubts(path, said)
        found[role] = weighted_views(views, sightings) if role == "surface" else views
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
        why=" ".join(words),
        warnings=tuple(warnings),
    )


def _words(role: str, path: Path, views: Sequence[MeshView | None], said: MeshSupportTotals) -> str:
    seen = [view for view in views if view is not None]
    pixels = sum(view.inverse_depth.size for view in seen)
    covered = sum(int((view.inverse_depth > 0).sum()) for view in seen)
    what = "Splats are to lie on" if role == "surface" else "Nothing is to stand before"
    return (
        f"{what} {path.name}, which {count_words(len(seen), 'training photo')} see in "
        f"{covered / pixels:.0%} of their pixels; {said}."
    )


def _doubts(path: Path, said: MeshSupportTotals) -> list[str]:
    """A sentence where points say that a mesh is not where it stands."""
    if said.total < FEW or said.behind <= _BEHIND * said.total:
        return []
    return [
        f"{path} stands before {said.behind / said.total:.0%} of the points that photos see where "
        "it is, and would hide them. It may be in the wrong place or of the wrong size: it must be "
        "in the world of the capture, in its unit."
    ]


def _unseen(path: Path, mesh: TriangleMesh, photos: Dataset) -> str:
    """Why a mesh is no use, and where it and the cameras are."""
    corners = mesh.vertices[np.unique(mesh.triangles)]
    cameras = photos.scene.cameras
    z = [corners @ cameras.viewmats[i, 2, :3] + cameras.viewmats[i, 2, 3] for i in photos.train]
    where = "behind all cameras" if max(map(np.max, z)) <= 0 else "beside all that they see"
    return (
        f"{path}: none of {count_words(len(photos.train), 'training photo')} sees the mesh, which "
        f"lies {where}. It reaches from {_place(corners.min(axis=0))} to "
        f"{_place(corners.max(axis=0))}, cameras stand from "
        f"{_place(cameras.centers.min(axis=0))} to {_place(cameras.centers.max(axis=0))}. It must "
        "be in the world of the capture, in its axes and its unit."
    )


def _place(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in point) + ")"
