"""Setup of depth supervision: from a capture's depth maps to targets, points and a report."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...config import DataConfig, Switch, TrainConfig
from ...datasets import Dataset
from ...depth import load_priors
from ...errors import ConfigError
from ...events import Decision
from ...scene import PointCloud
from ...text_format import count_text, number
from ..schedule.caps import MOST_ADDED, SPLATS_A_POINT
from .loss import with_weights
from .points import depth_points
from .rule import coverage, decide
from .targets import DepthTargets


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
