"""Initial splats of a training, in the training frame."""

from dataclasses import replace

import numpy as np

from ...config import TrainConfig
from ...errors import ConfigError, DatasetError
from ...scene import PointCloud
from ...sh import rgb_to_sh0
from ...splats import Splats, cut_degree
from ...text_format import number
from .nearest_points import NearestPoints
from .training_frame import TrainingFrame


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


def splats_from_points(
    cloud: PointCloud,
    *,
    extent: float,
    opacity: float,
    scale: float,
    max_splats: int,
    seed: int,
    near: NearestPoints | None = None,
) -> Splats:
    """Create an isotropic splat at each point, with a scale by the distance to its neighbours
    (Kerbl et al. 2023).

    Args:
        cloud: P points in the training frame.
        extent: Camera extent, training units; a hundredth of it is the scale of a single point.
        opacity: Opacity of all splats, in (0, 1).
        scale: Standard deviation in root-mean-square distances to the three nearest neighbours.
        max_splats: Most splats; more points are thinned at random.
        seed: Seed of the thinning.
        near: Tree of the finite points; None: built here.

    Returns:
        At most `max_splats` splats of SH degree 0, training frame.

    Raises:
        DatasetError: no points.
    """
    points, colors = cloud.points, cloud.colors
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        points, colors = points[finite], colors[finite]
    if len(points) == 0:
        raise DatasetError(
            "The capture has no finite 3D points to start from; "
            "run the SfM again so that it writes points3D."
        )
    near = NearestPoints(points, queries=max_splats) if near is None else near
    if len(points) > max_splats:
        rng = np.random.default_rng(seed)
        chosen = np.sort(rng.choice(len(points), max_splats, replace=False))
        points, colors = points[chosen], colors[chosen]
    sizes = _neighbour_distance(points, near, lone=0.01 * extent) * scale
    n = len(points)
    quats = np.zeros((n, 4), np.float32)
    quats[:, 0] = 1
    logit = np.log(opacity / (1 - opacity))
    return Splats(
        means=points.astype(np.float32),
        quats=quats,
        scales=np.repeat(np.log(sizes)[:, None], 3, axis=1).astype(np.float32),
        opacities=np.full(n, logit, np.float32),
        sh0=rgb_to_sh0(colors / 255.0)[:, None, :].astype(np.float32),
        shN=np.zeros((n, 0, 3), np.float32),
    )


def _neighbour_distance(points: np.ndarray, near: NearestPoints, *, lone: float) -> np.ndarray:
    """Return [P] root-mean-square distances of points in `near` to the three nearest others, at
    least sqrt(1e-7); `lone` for a single point."""
    neighbours = min(3, len(near) - 1)
    if neighbours == 0:
        return np.full(len(points), lone)
    distances = near.distances(points, neighbours + 1)
    return np.sqrt(np.maximum((distances[:, 1:] ** 2).mean(axis=1), 1e-7))
