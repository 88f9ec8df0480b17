"""Initial splats of a training, in the training frame."""

from dataclasses import replace

import numpy as np

from ...config import TrainConfig
from ...errors import ConfigError
from ...scene import PointCloud
from ...splats import Splats, cut_degree
from ...text_format import number
from ..schedule.plan import Plan
from .conversion import splats_from_points
from .nearest_points import NearestPoints
from .training_frame import TrainingFrame


def splats_from_cloud(
    cloud: PointCloud,
    near: NearestPoints,
    plan: Plan,
    frame: TrainingFrame,
    *,
    most: int,
    seed: int,
) -> Splats:
    """Create a splat for each point of `cloud` (training frame), thinned to `most` by `seed`;
    `near`: tree of the finite points."""
    return splats_from_points(
        cloud,
        extent=frame.extent,
        opacity=plan.init_opacity,
        scale=plan.init_scale,
        max_splats=most,
        seed=seed,
        near=near,
    )


def splats_from_start(start: Splats, config: TrainConfig, frame: TrainingFrame) -> Splats:
    """Convert start splats from the world to the training frame, cut to the config's SH degree.

    Raises:
        ConfigError: there are none, or more than `max_splats`.
    """
    check_splat_count(start, config)
    start = cut_degree(start, config.sh_degree)
    start = replace(start, shN=np.ascontiguousarray(start.shN))
    if config.start_opacity < 1:
        opacity = config.start_opacity / (1 + np.exp(-start.opacities.astype(np.float64)))
        logits = np.log(opacity) - np.log1p(-opacity)
        start = replace(start, opacities=logits.astype(np.float32))
    return frame.similarity.splats_to_training(start)


def check_splat_count(start: Splats, config: TrainConfig) -> None:
    """Raise ConfigError unless there are 1 to `max_splats` start splats."""
    if not 0 < len(start) <= config.max_splats:
        raise ConfigError(
            f"There are {number(len(start))} start splats, expected 1 to max_splats = "
            f"{number(config.max_splats)}; raise `--max-splats` or start from fewer."
        )
