"""Training start: the first splats, the frozen ones around them, and what keeps spaces empty."""

from dataclasses import replace
from typing import NamedTuple

from ...config import TrainConfig
from ...formats.joined import joined
from ...scene import Cameras
from ...splats import Splats
from ..analysis.analysis import Analysis
from ..guide.mesh_views import MeshFreeSpace
from ..model.initial_splats import splats_from_points, splats_from_start
from ..model.nearest_points import NearestPoints
from ..model.training_frame import TrainingFrame
from ..photos.sky import sky_radius, sky_splats
from ..photos.sky_search import thinned
from ..region.frozen_splats import FrozenSplats, split_frozen
from ..schedule.plan import Plan
from ..strategy.free_path import FreePath, FreeSpace
from ..strategy.free_sky import FreeSky
from ..strategy.pruning import Pruner


class TrainingStart(NamedTuple):
    """Start of a training."""

    first: Splats
    """The first splats of each model, training frame."""
    frozen: FrozenSplats | None
    """Splats around the region, drawn with the trained ones; None: none."""
    pruner: Pruner
    """Pruning in addition to that of the strategy."""
    cut_degree: int
    """SH degree of the start splats before it was cut to that of the config."""


def training_start(
    config: TrainConfig,
    analysis: Analysis,
    frame: TrainingFrame,
    plan: Plan,
    cameras: Cameras,
    *,
    count: int,
) -> TrainingStart:
    """Create the first splats and the spaces that stay empty.

    Args:
        config: The options.
        analysis: The capture.
        frame: The training frame.
        plan: Plan of one model.
        cameras: Cameras of the capture, training frame.
        count: Number of splats at the start.

    Raises:
        ConfigError: more start splats than the config allows, or none in the region.
    """
    photos, start, frozen = analysis.photos, analysis.start, None
    if analysis.region is not None and start is not None:
        start, frozen = split_frozen(start, analysis.region, config, frame)
    cloud = analysis.cloud
    cloud = replace(cloud, points=frame.similarity.points_to_training(cloud.points))
    # One k-d tree for all uses, because for many points it is larger than a model.
    near = NearestPoints(cloud.points, queries=count)
    surfaces, train = None if cloud.made_up else near, list(photos.train)
    around = FreeSpace(cameras.centers[train], surfaces, share=config.free_space)
    path = FreePath(cameras, train, surfaces, share=config.free_space)
    sky = behind = None
    if analysis.sky is not None:
        # The capture's own points, because a resumed run has no others.
        points = thinned(photos.scene.points.points)
        far = sky_radius(cameras, train, frame.similarity.points_to_training(points))
        behind = FreeSky(analysis.sky, cameras, *far)
        sky = sky_splats(config, analysis.sky, cameras, *far) if start is None else None
    if start is not None:
        first = splats_from_start(start, config, frame)
    else:
        first = splats_from_points(
            cloud,
            extent=frame.extent,
            opacity=plan.init_opacity,
            scale=plan.init_scale,
            max_splats=max(plan.max_splats - (0 if sky is None else len(sky)), 1),
            seed=config.seed,
            near=near,
        )
        first = first if sky is None else joined([first, sky])
    guided = None
    if analysis.guide.free:
        guided = MeshFreeSpace(analysis.guide.free, photos.scene.cameras, frame.similarity)
    masks_hide = photos.mask_mode == "ignore"
    pruner = Pruner(config, around, path, masks_hide=masks_hide, sky=behind, guided=guided)
    cut_degree = max(0 if start is None else start.sh_degree, first.sh_degree)
    return TrainingStart(first, frozen, pruner, cut_degree)
