"""Initialization of a run: the first splats, and the free space around the cameras."""

from dataclasses import replace

from ...config import TrainConfig
from ...formats.joined import joined
from ...scene import Cameras, PointCloud
from ...splats import Splats
from ..model.initial_splats import splats_from_cloud, splats_from_given
from ..model.nearest_points import NearestPoints
from ..model.training_frame import TrainingFrame
from ..photos.sky import sky_splats
from ..photos.view_sampler import Photos
from ..schedule.plan import Plan
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
) -> tuple[Splats, FreeSpace]:
    """What to begin with in the training world, and the space that stays empty there.

    Both look at the same neighbours of points, which take more memory than a model where points are
    many.

    Args:
        config: The options.
        photos: What is trained on.
        frame: The training world.
        plan: Of one model.
        cameras: Those of `photos`, training world.
        cloud: Points, COLMAP world.
        start: Splats to go on with, COLMAP world; None: one a point, and a sky where it is asked.
        count: How many points have to be looked at.

    Raises:
        ConfigError: `start` has more splats than the config allows.
    """
    cloud = replace(cloud, points=frame.similarity.points_to_training(cloud.points))
    near = NearestPoints(cloud.points, asked=count)
    free_space = FreeSpace(
        cameras.centers[list(photos.train)],
        None if cloud.made_up else near,
        share=config.free_space,
    )
    if start is not None:
        return splats_from_given(start, config, frame), free_space
    sky = sky_splats(config, photos, cameras, cloud.points)
    most = max(plan.max_splats - (0 if sky is None else len(sky)), 1)
    first = splats_from_cloud(cloud, near, plan, frame, most=most, seed=config.seed)
    return first if sky is None else joined([first, sky]), free_space
