"""Setup of depth supervision: from a capture's depth maps to targets, points and a report."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...config import DataConfig, Switch, TrainConfig
from ...datasets import Dataset
from ...depth import load_priors
from ...errors import ConfigError
from ...scene import PointCloud
from ...text_format import count_words, number
from ..schedule.caps import MOST_ADDED, SPLATS_A_POINT
from .loss import with_weights
from .points import depth_points
from .rule import coverage, decide
from .targets import DepthTargets


@dataclass(frozen=True, kw_only=True)
class DepthSetup:
    """The depth of a run."""

    targets: DepthTargets | None = None
    """All maps that could be read, for the report; None: there are none."""
    supervises: bool = False
    """Whether they enter the loss."""
    why: str = ""
    """Sentences that say so, why, and how much."""
    weights: tuple[float, float] = (0.0, 0.0)
    """Of the depth loss at the first and the last step, as options or `auto` have them; 0, 0: it
    is not used."""
    points: PointCloud | None = None
    """Points to start from, those of the capture and more; None: those of the capture."""
    table: list[dict[str, Any]] = field(default_factory=list)
    """The fit of each view, see `gscore.depth.Priors`."""
    warnings: tuple[str, ...] = ()
    """Sentences for the user."""

    @property
    def decision(self) -> str:
        """`why`, unless it is a warning already."""
        return "" if self.why in self.warnings else self.why

    @property
    def loss_targets(self) -> DepthTargets | None:
        """The maps if they enter the loss."""
        return self.targets if self.supervises else None


def prepare_depth(
    data: DataConfig,
    config: TrainConfig,
    photos: Dataset,
    *,
    on_progress: Callable[[int, int], None] | None = None,
) -> DepthSetup:
    """Read and align the maps that `data` names, and decide what to do with them.

    Raises:
        GsError: maps or their scales are missing or damaged.
        ConfigError: depth is asked for and no maps are named.
    """
    if not data.depths:
        if asked := depth_option_set(config):
            raise ConfigError(
                f"{asked} takes depth maps, but no folder of these is named. gscore depth "
                f"{data.source} makes them in its folder depths; give that with -d depths."
            )
        return DepthSetup()
    facts = coverage(photos.scene, photos.train)
    wanted, _ = decide(config.depth_mode, facts, usable=len(photos.train))
    priors = load_priors(data, photos, together=wanted, on_progress=on_progress)
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
        why += f" {_weight_words(*weights)}"
        if config.start_splats is not None and config.depth_points > 0:
            warnings.append(
                "No points are added from depth maps (depth_points), because the run starts from "
                "splats that are there already (start_splats)."
            )
    if supervises and (count := _points_wanted(resolved)):
        # Splats that start on walls are missing on the subject where few are allowed.
        most = config.max_splats // SPLATS_A_POINT if config.depth_points < 0 else None
        added = depth_points(photos, priors.views, count=count, seed=config.seed, most=most)
        known = photos.scene.points
        points = known.with_more(added)
        among = "random ones" if known.made_up else f"{number(len(known))} of SfM"
        count = count_words(len(added), "point was", "points were")
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
    """The option that takes depth maps in any case; empty where none does."""
    if config.depth_mode is Switch.ON:
        return "--depth-mode on"
    return f"--depth-points {config.depth_points}" if config.depth_points > 0 else ""


def _weight_words(first: float, last: float) -> str:
    if first == last:
        return f"The depth loss has a weight of {first:.3g}."
    return f"The depth loss has a weight of {first:.3g} at first and {last:.3g} at the end."


def _points_wanted(config: TrainConfig) -> int:
    """Most points to add: none to splats that are there already, nor by itself without a loss."""
    if config.start_splats is not None:
        return 0
    if config.depth_points >= 0:
        return config.depth_points
    return MOST_ADDED if max(config.depth_weight, config.depth_weight_final) > 0 else 0
