"""Training start: the first splats, the frozen ones around them, and what keeps spaces empty."""

from typing import NamedTuple

from ...config import TrainConfig
from ...scene import Cameras
from ...splats import Splats
from ..analysis.analysis import Analysis
from ..guide.mesh_free_space import MeshFreeSpace
from ..model.training_frame import TrainingFrame
from ..region.frozen_splats import FrozenSplats, split_frozen
from ..schedule.plan import Plan
from ..strategy.initialization import initial_splats
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
    cloud = photos.scene.points if analysis.points is None else analysis.points
    first, (around, path) = initial_splats(
        config, photos, frame, plan, cameras, cloud, start=start, count=count
    )
    guided = None
    if analysis.guide.free:
        guided = MeshFreeSpace(analysis.guide.free, photos.scene.cameras, frame.similarity)
    pruner = Pruner(config, around, path, masks_hide=photos.mask_mode == "ignore", guided=guided)
    cut_degree = max(0 if start is None else start.sh_degree, first.sh_degree)
    return TrainingStart(first, frozen, pruner, cut_degree)
