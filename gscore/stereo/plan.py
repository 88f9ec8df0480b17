"""Stereo plan: the neighbour views of each photo, and its range of depths."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..depth.observations import PointVisibility
from ..raster.header import STEREO_PLANES_MAX
from ..raster.stereo_depth import StereoView
from ..scene import Cameras
from ..transforms import SMALLEST

SOURCES = 4
"""Source views of each photo."""
NEIGHBOURS = 8
"""Views of the consistency check of a depth map, sources included."""
_BEST_ANGLE = 9.0
"""Best triangulation angle of two photos, degrees: less makes depths inaccurate, more makes
surfaces
look different."""
_NARROWER, _WIDER = 4.0, 9.0
"""Standard deviations of the weight below and above it, degrees."""
_POINTS = 4000
"""Sample of the points for the view selection."""
_FEWEST_SHARED = 1e-3
"""Minimum sum of weights of a matched pair."""
_ENDS = (0.01, 0.99)
"""Quantiles of the inverse depths of a view's points."""
_FARTHER, _NEARER = 0.5, 1.3
"""Factors by which the range extends beyond these quantiles."""
_FEWEST_POINTS = 8
"""Minimum number of visible points for the depth range of a view."""
_AROUND = (0.4, 2.5)
"""Inverse depth range of a subject where the axes of all views meet, relative to that point."""
_BEHIND = 0.01
"""Minimum relative inverse depth of the background; in inverse depth a far limit costs little."""
_STEP = 1.0
"""Distance of a point's projections from neighbouring planes, px."""
_FEWEST_PLANES = 16
PLANES = 128
"""Maximum number of planes; the time of a sweep grows with it."""


@dataclass(frozen=True, kw_only=True)
class ViewPlan:
    """Plane sweep settings of one view. Indices count the participating views."""

    sources: tuple[int, ...]
    """Source views, best first."""
    neighbours: tuple[int, ...]
    """Views of the consistency check, best first."""
    farthest: float
    """Inverse depth of the first plane, 1/world unit."""
    nearest: float
    """Inverse depth of the last plane, 1/world unit."""


def plan_views(
    cameras: Cameras, tracks: PointVisibility, used: Sequence[int], *, subject: bool = False
) -> list[ViewPlan | None]:
    """A plan for each of the views `used`; None for a view without suitable neighbours.

    Args:
        cameras: Cameras of all views.
        tracks: Points and their visibility; may be empty.
        used: Indices of the participating views; others are ignored.
        subject: Only the subject where the axes meet counts, without background.
    """
    centers, axes = cameras.centers[list(used)], cameras.viewmats[list(used), 2, :3]
    seen = _seen(tracks, used)
    plans: list[ViewPlan | None] = []
    for place, index in enumerate(used):
        points = tracks.points[tracks.observed[index]]
        depth_range = _range(points, cameras.viewmats[index]) or _range_by_axes(
            centers, axes, place, farthest=_AROUND[0] if subject else _BEHIND
        )
        if depth_range is None:
            plans.append(None)
            continue
        if len(points) >= _FEWEST_POINTS:
            weights = _shared(tracks, seen, centers, place)
        else:
            weights = _facing(centers, axes, place, depth_range)
        weights[place] = 0
        order = np.argsort(-weights, kind="stable")[:NEIGHBOURS]
        order = [int(i) for i in order if weights[i] > _FEWEST_SHARED]
        if not order:
            plans.append(None)
            continue
        far, near = depth_range
        plans.append(
            ViewPlan(
                sources=tuple(order[:SOURCES]), neighbours=tuple(order), farthest=far, nearest=near
            )
        )
    return plans


def planes_of(plan: ViewPlan, views: Sequence[StereoView]) -> int:
    """Number of planes for a motion of one pixel between planes in the median source.

    Args:
        plan: Plan of the reference, the first of `views`.
        views: The reference and its sources.
    """
    height, width = views[0].grey.shape
    x, y = np.meshgrid([0.1 * width, 0.5 * width, 0.9 * width], [0.2 * height, 0.8 * height])
    pixels = np.stack([x.ravel(), y.ravel(), np.ones(6)])
    moved = []
    for source in views[1:]:
        warp = views[0].warp_to(source)
        ends = [
            warp.rotation @ pixels + inverse * warp.translation[:, None]
            for inverse in (plan.farthest, plan.nearest)
        ]
        front = (ends[0][2] > 1e-9) & (ends[1][2] > 1e-9)
        if front.any():
            a, b = (end[:2, front] / end[2, front] for end in ends)
            moved.append(float(np.median(np.hypot(*(b - a)))))
    path = float(np.median(moved)) if moved else 0.0
    most = min(PLANES, STEREO_PLANES_MAX)
    return int(np.clip(np.ceil(min(path / _STEP, most)) + 1, _FEWEST_PLANES, most))


def _seen(tracks: PointVisibility, used: Sequence[int]) -> np.ndarray:
    """[V, P] bool: visibility of an even sample of the points."""
    stride = max(1, len(tracks.points) // _POINTS)
    out = np.zeros((len(used), len(tracks.points[::stride])), bool)
    for place, index in enumerate(used):
        rows = tracks.observed[index]
        out[place, rows[rows % stride == 0] // stride] = True
    return out


def _shared(
    tracks: PointVisibility, seen: np.ndarray, centers: np.ndarray, place: int
) -> np.ndarray:
    """[V] sum of the weights of the points shared with each other view."""
    stride = max(1, len(tracks.points) // _POINTS)
    mine = np.flatnonzero(seen[place])
    rays = tracks.points[mine * stride][None] - centers[:, None]
    rays /= np.maximum(np.linalg.norm(rays, axis=2, keepdims=True), 1e-300)
    cosines = np.einsum("vpi,pi->vp", rays, rays[place])
    return (_worth(cosines) * seen[:, mine]).sum(axis=1)


def _facing(
    centers: np.ndarray, axes: np.ndarray, place: int, depth_range: tuple[float, float]
) -> np.ndarray:
    """[V] weight of each view for one without points, from the centre of its depth range."""
    middle = centers[place] + axes[place] * (2 / (depth_range[0] + depth_range[1]))
    rays = middle - centers
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-300)
    facing = np.clip((rays * axes).sum(axis=1), 0, 1)
    return _worth(rays @ rays[place]) * facing


def _worth(cosines: np.ndarray) -> np.ndarray:
    angles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    width = np.where(angles < _BEST_ANGLE, _NARROWER, _WIDER)
    # Photos from one place show no depth at all, however many points they share.
    return np.exp(-0.5 * ((angles - _BEST_ANGLE) / width) ** 2) * np.minimum(angles, 1.0)


def _range(points: np.ndarray, viewmat: np.ndarray) -> tuple[float, float] | None:
    """Inverse depth range of a view from its points [P, 3]; None: too few."""
    z = points @ viewmat[2, :3] + viewmat[2, 3]
    z = z[z > SMALLEST]
    if len(z) < _FEWEST_POINTS:
        return None
    far, near = np.quantile(1 / z, _ENDS)
    return float(_FARTHER * far), float(_NEARER * near)


def _range_by_axes(
    centers: np.ndarray, axes: np.ndarray, place: int, *, farthest: float
) -> tuple[float, float] | None:
    """Inverse depth range from the point where the axes of all views meet; None if they do not."""
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    matrix = across.sum(axis=0)
    if np.linalg.eigvalsh(matrix)[0] < 1e-3 * len(axes):
        return None
    focus = np.linalg.solve(matrix, np.einsum("cij,cj->i", across, centers))
    z = float((focus - centers[place]) @ axes[place])
    return (farthest / z, _AROUND[1] / z) if z > SMALLEST else None
