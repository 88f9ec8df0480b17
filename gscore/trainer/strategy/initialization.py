"""Initialization of a run: initial splats, and the free space around cameras."""

from dataclasses import replace

from ...config import TrainConfig
from ...formats.joined import joined
from ...scene import Cameras, PointCloud
from ...splats import Splats
from ..model.initial_splats import splats_from_cloud, splats_from_start
from ..model.nearest_points import NearestPoints
from ..model.training_frame import TrainingFrame
from ..photos.sky import sky_splats
from ..photos.view_sampler import Photos
from ..schedule.plan import Plan
from .free_path import FreePath
from .free_space import FreeSpace


def initial_splats(
    config: TrainConfig,
    photos: Photos,
    frame: TrainingFrame,
    plan: Plan,
    cameras: Cameras,
    cloud: PointCloud,
    *,
    start: Splats | None,
    count: int,
) -> tuple[Splats, tuple[FreeSpace, FreePath]]:
    """Create the initial splats and the free space at and between cameras, in the training frame.

    Both use the same k-d tree of the points, which for many points is larger than a model.

    Args:
        config: The options.
        photos: The capture.
        frame: The training frame.
        plan: Plan of one model.
        cameras: Cameras of `photos`, training frame.
        cloud: Points, COLMAP world.
        start: Start splats, COLMAP world; None: one splat per point, and `sky` if enabled.
        count: Approximate number of queries of the tree.

    Raises:
        ConfigError: `start` has more splats than the config allows.
    """
    cloud = replace(cloud, points=frame.similarity.points_to_training(cloud.points))
    near = NearestPoints(cloud.points, queries=count)
    surfaces, train = None if cloud.made_up else near, list(photos.train)
    free = (
        FreeSpace(cameras.centers[train], surfaces, share=config.free_space),
        FreePath(cameras, train, surfaces, share=config.free_space),
    )
    if start is not None:
        return splats_from_start(start, config, frame), free
    sky = sky_splats(config, photos, cameras, cloud.points)
    most = max(plan.max_splats - (0 if sky is None else len(sky)), 1)
    first = splats_from_cloud(cloud, near, plan, frame, most=most, seed=config.seed)
    return first if sky is None else joined([first, sky]), free
