"""Setup of depth supervision: from a capture's depth maps to targets, points and a report.

Points are aligned depth maps back-projected where SfM left holes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...config import DataConfig, Switch, TrainConfig
from ...datasets import Dataset
from ...depth import load_priors
from ...errors import ConfigError
from ...events import Decision
from ...scene import Cameras, PointCloud
from ...text_format import count_text, number
from ..model.nearest_points import NearestPoints
from ..photos.view_sampler import Photos
from ..schedule.caps import MOST_ADDED, SPLATS_A_POINT
from .loss import with_weights
from .rule import coverage, decide
from .targets import DepthTargets, Prior


@dataclass(frozen=True, kw_only=True)
class DepthSetup:
    """Depth supervision of a run."""

    targets: DepthTargets | None = None
    """All readable depth maps, for the report; None: there are none."""
    supervises: bool = False
    """True if the maps enter the loss."""
    why: str = ""
    """The decision with its reason and weights, as sentences."""
    weights: tuple[float, float] = (0.0, 0.0)
    """Weights of the depth loss at the first and the last step, after `auto`; 0, 0: not used."""
    points: PointCloud | None = None
    """Start points, those of the capture and from depth maps; None: those of the capture."""
    table: list[dict[str, Any]] = field(default_factory=list)
    """Fit of each view, see `gscore.depth.Priors`."""
    warnings: tuple[str, ...] = ()
    """Warnings for the user, as sentences."""

    @property
    def decision(self) -> Decision | None:
        """The decision, unless there are no maps or `why` is already a warning."""
        listed = self.why and self.why not in self.warnings
        return Decision("depth", self.why) if listed else None

    @property
    def loss_targets(self) -> DepthTargets | None:
        """The depth maps if they enter the loss."""
        return self.targets if self.supervises else None


def prepare_depth(
    data: DataConfig,
    config: TrainConfig,
    photos: Dataset,
    *,
    on_progress: Callable[[int, int], None] | None = None,
) -> DepthSetup:
    """Read and align the depth maps of `data`, and decide on their use.

    Raises:
        GsError: maps or their scales are missing or damaged.
        ConfigError: options require depth maps but no folder is given.
    """
    if not data.depths:
        if option := depth_option_set(config):
            raise ConfigError(
                f"{option} needs depth maps, but no folder is given. Run gscore depth "
                f"{data.source}, which writes them into its folder depths, and add "
                "`--depths depths`."
            )
        return DepthSetup()
    facts = coverage(photos.scene, photos.train)
    needed, _ = decide(config.depth_mode, facts, usable=len(photos.train))
    priors = load_priors(data, photos, joint=needed, on_progress=on_progress)
    usable = sum(
        1
        for i in photos.train
        if (p := priors.views[i]) is not None
        and (p.aligned or config.depth_pearson > 0)
        and (np.isfinite(p.inverse_depth) & (p.confidence > 0)).any()
    )
    supervises, why = decide(config.depth_mode, facts, usable=usable)
    warnings = [*priors.warnings]
    if not usable:
        warnings.append(why)
    points = None
    resolved = with_weights(config, facts.views_of_point)
    weights = (resolved.depth_weight, resolved.depth_weight_final) if supervises else (0.0, 0.0)
    if supervises:
        why += f" {_weight_text(*weights)}"
        if config.start_splats is not None and config.depth_points > 0:
            warnings.append(
                "No points are added from depth maps (depth_points), because the run starts from "
                "splats (start_splats)."
            )
    if supervises and (count := _points_to_add(resolved)):
        # With few splats in total, those that start on walls are missing on the subject.
        most = config.max_splats // SPLATS_A_POINT if config.depth_points < 0 else None
        added = depth_points(photos, priors.views, count=count, seed=config.seed, most=most)
        known = photos.scene.points
        points = known.with_more(added)
        among = "random ones" if known.made_up else f"{number(len(known))} of SfM"
        count = count_text(len(added), "point was", "points were")
        why += f" {count} added from the maps to {among}."
    return DepthSetup(
        targets=DepthTargets(priors.views, train=photos.train, views=facts.views_of_point),
        supervises=supervises,
        weights=weights,
        why=why,
        points=points,
        table=priors.table,
        warnings=tuple(warnings),
    )


def depth_option_set(config: TrainConfig) -> str:
    """The option that requires depth maps; empty if none does."""
    if config.depth_mode is Switch.ON:
        return "`--depth-mode on`"
    return f"`--depth-points {config.depth_points}`" if config.depth_points > 0 else ""


def _weight_text(first: float, last: float) -> str:
    if first == last:
        return f"The depth loss has a weight of {first:.3g}."
    return f"The depth loss has a weight of {first:.3g} at first and {last:.3g} at the end."


def _points_to_add(config: TrainConfig) -> int:
    """Most points to add: 0 for existing splats, and automatically only with a depth loss."""
    if config.start_splats is not None:
        return 0
    if config.depth_points >= 0:
        return config.depth_points
    return MOST_ADDED if max(config.depth_weight, config.depth_weight_final) > 0 else 0


_SURE = 0.5
"""Least confidence of a pixel."""
_AGREE = 0.05
"""Largest relative difference to the depth in another view."""
_OTHERS = 4
"""Number of other views, those with the nearest optical axes, that a point is checked in."""
_HOLE = 2.0
"""Least distance of a hole from all points, in grid cells."""


def depth_points(
    photos: Photos,
    priors: Sequence[Prior | None],
    *,
    count: int,
    seed: int,
    most: int | None = None,
) -> PointCloud:
    """Back-project points where SfM has none and two aligned depth maps agree.

    Pixels of a regular grid in each training view are back-projected. A point is kept if it is
    farther than two grid cells from all SfM points, and if the depth in a neighbouring view agrees
    within 5 %; points outside the frames of all neighbouring views are dropped.

    Args:
        photos: The capture; colours come from its photos.
        priors: By index of the view; only aligned ones are used.
        count: Target number of points, which sets the grid; more are thinned at random.
        seed: Seed of the thinning.
        most: Most points, on the same grid; None: `count`.

    Returns:
        0 to `count` points, COLMAP world units.
    """
    cameras = photos.scene.cameras
    used = [i for i in photos.train if (p := priors[i]) is not None and p.aligned]
    if count <= 0 or len(used) < 2:
        return PointCloud(points=np.zeros((0, 3)), colors=np.zeros((0, 3), np.uint8))
    # Four candidates per point, because the checks reject many.
    pixels = sum(int(cameras.widths[i]) * int(cameras.heights[i]) for i in used)
    stride = max(1, int(np.sqrt(pixels / (4 * count))))
    known = NearestPoints(photos.scene.points.points, queries=2 * count)
    parts = [_from_view(photos, priors, used, i, stride, known) for i in used]
    points = np.concatenate([part[0] for part in parts])
    colors = np.concatenate([part[1] for part in parts])
    count = count if most is None else min(count, most)
    if len(points) > count:
        chosen = np.sort(np.random.default_rng(seed).choice(len(points), count, replace=False))
        points, colors = points[chosen], colors[chosen]
    return PointCloud(points=points, colors=colors)


def _from_view(
    photos: Photos,
    priors: Sequence[Prior | None],
    used: list[int],
    index: int,
    stride: int,
    known: NearestPoints,
) -> tuple[np.ndarray, np.ndarray]:
    """Points, [P, 3] world units, and colours, [P, 3] uint8, of one view."""
    cameras, prior = photos.scene.cameras, priors[index]
    assert prior is not None
    rows = np.arange(stride // 2, prior.inverse_depth.shape[0], stride)
    columns = np.arange(stride // 2, prior.inverse_depth.shape[1], stride)
    v, u = (a.ravel() for a in np.meshgrid(rows, columns, indexing="ij"))
    inverse = prior.inverse_depth[v, u].astype(np.float64)
    sure = (prior.confidence[v, u] >= _SURE) & (inverse > 0)
    u, v, depth = u[sure], v[sure], 1 / inverse[sure]
    pixels = np.stack([u + 0.5, v + 0.5, np.ones(len(u))], axis=1)
    rays = pixels @ np.linalg.inv(cameras.Ks[index]).T
    viewmat = cameras.viewmats[index]
    points = (rays * depth[:, None] - viewmat[:3, 3]) @ viewmat[:3, :3]
    cell = stride * depth / cameras.Ks[index, 0, 0]
    keep = _far_from(known, points, _HOLE * cell)
    keep &= _confirmed(cameras, priors, _neighbours(cameras, used, index), points)
    return points[keep], photos.image(index)[v[keep], u[keep]]


def _far_from(known: NearestPoints, points: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """[P] bool: no known point is within `radius` [P]."""
    if len(known) == 0 or len(points) == 0:
        return np.ones(len(points), bool)
    return known.distances(points, 1)[:, 0] > radius


def _neighbours(cameras: Cameras, used: list[int], index: int) -> list[int]:
    """Other views with the optical axes nearest to that of view `index`."""
    axes = cameras.viewmats[:, 2, :3]
    others = [i for i in used if i != index]
    return sorted(others, key=lambda i: -float(axes[i] @ axes[index]))[:_OTHERS]


def _confirmed(
    cameras: Cameras, priors: Sequence[Prior | None], others: list[int], points: np.ndarray
) -> np.ndarray:
    """[P] bool: the depth of the point agrees in one of the other views."""
    confirmed = np.zeros(len(points), bool)
    for i in others:
        prior = priors[i]
        assert prior is not None
        x, y, z = cameras.viewmats[i, :3, :3] @ points.T + cameras.viewmats[i, :3, 3:]
        front = z > 0
        z = np.where(front, z, 1.0)
        K, (height, width) = cameras.Ks[i], prior.inverse_depth.shape
        u, v = K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]
        inside = front & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        at = np.where(inside, v, 0).astype(np.int64), np.where(inside, u, 0).astype(np.int64)
        agrees = np.abs(prior.inverse_depth[at] * z - 1) < _AGREE
        confirmed |= inside & (prior.confidence[at] >= _SURE) & agrees
    return confirmed
