"""Photo rules: dropout, number of models and plan, as options and photos of a capture decide."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from ...config import TrainConfig
from ...errors import DatasetError
from ...events import Decision
from ...text_format import count_text, number
from ..model.checkpoint_schema import as_float
from ..photos.sky import has_sky
from ..photos.sky_search import thinned
from ..photos.view_sampler import Photos
from ..schedule.caps import drop_rate_of, max_splats_per_model, model_count, opaque_weight_of
from ..schedule.plan import Plan
from .analysis import Analysis

_IN_CELL = (
    "Splats are added only in the block's cell: the start splats cover its surroundings, which "
    "`gscore merge` leaves out."
)


@dataclass(frozen=True, kw_only=True)
class PhotoRules:
    """Decisions on a training before its first step."""

    given: bool
    """The run has start splats."""
    region: bool
    """A region is trained."""
    block: bool
    """The capture is a block, whose cell limits where splats are added."""
    points: int = 0
    """Number of splats of a model at the start."""
    left_out: int = 0
    """Number of points above `max_splats`, which give no splats."""
    known: float | None
    """Share of the unmasked pixels with stereo depth; None: stereo did not run."""
    backdrop: float = 0.0
    """Share of the counted pixels that have the colour of the training's background."""
    drop_rate: float = 0.0
    """Dropout rate at the last step."""
    opaque_weight: float = 0.0
    """Weight of transmittance in the loss."""
    sky: bool = False
    """There are splats for a sky."""
    models: int = 1
    """Number of models that are trained in parallel."""
    by_photos: tuple[Decision, ...] = ()
    """Decisions that the photos led to."""

    def plan(self, config: TrainConfig, photos: Photos, extent: float) -> Plan:
        """Return the plan of a run; cheap.

        Args:
            config: The options, with the length of the run.
            photos: The capture.
            extent: Camera extent, training units.
        """
        cameras = photos.scene.cameras
        return Plan.of(
            config,
            extent=extent,
            points=self.points,
            side=int(min(cameras.widths.min(), cameras.heights.min())),
            pixels=int((cameras.widths * cameras.heights)[list(photos.train)].mean()),
            subject=photos.mask_mode == "composite",
            drops=self.drop_rate > 0,
            sky=self.sky,
            models=self.models,
        )

    def decided(self, config: TrainConfig, photos: Photos) -> "PhotoRules":
        """Return the rules with dropout, models and transmittance by the photos."""
        rate, dropout = drop_rate_of(config, known=self.known, mask_mode=photos.mask_mode)
        weight, opacity = opaque_weight_of(config, backdrop=self.backdrop)
        models, ensemble = 1, None
        if not self.given:
            models, ensemble = model_count(
                config,
                photos=len(photos.train),
                points=photos.scene.points.given,
                mask_mode=photos.mask_mode,
                known=self.known,
            )
        found = tuple(one for one in (opacity, dropout, ensemble) if one is not None)
        return replace(self, drop_rate=rate, opaque_weight=weight, models=models, by_photos=found)

    def restored(
        self, config: TrainConfig, photos: Photos, state: Mapping[str, Any], models: int
    ) -> "PhotoRules":
        """Return the rules of a run with this `state` that started with this number of models.

        Raises:
            ValueError: neither the options nor the photos can have led to that number.
        """
        # Use the stored share, because a resumed run without stereo points skips stereo.
        known = self.known
        if state.get("known") is not None:
            known = as_float("known", state["known"], low=0)
        rules = replace(self, known=known).decided(config, photos)
        if rules.models == models:
            return rules
        # The photos decided the number when the run started, perhaps by an older rule.
        by_photos = config.ensemble_below and models in {1, config.ensemble}
        if self.given or not by_photos:
            raise ValueError(f"it has {models} models, expected {rules.models}")
        kept = tuple(one for one in rules.by_photos if one.topic != "ensemble")
        return replace(rules, models=models, by_photos=kept)

    def decisions(self, *, trained: int, frozen: int) -> list[Decision]:
        """Return the decisions on the region, or the cell in which splats are added, and by the
        photos; `trained` and `frozen`: numbers of splats."""
        text = _IN_CELL if self.block else ""
        if self.region and self.given:
            count = count_text(trained, "splat")
            text = f"{count} in the region; {number(frozen)} around it are frozen."
        elif self.region:
            text = "Only pixels that show the region are trained."
        found = [Decision("region", text)] if text else []
        if self.left_out:
            text = (
                f"{number(self.points)} of {count_text(self.points + self.left_out, 'point')} give "
                "splats, chosen at random: `--max-splats` allows no more."
            )
            found.append(Decision("points", text))
        return [*found, *self.by_photos]


def _with_sky(analysis: Analysis) -> bool:
    """Whether the trained splats include a sky, found in the photos or given."""
    photos, start = analysis.photos, analysis.start
    if start is None:
        return analysis.sky is not None
    if analysis.region is not None:  # outside which splats are frozen
        return False
    points = thinned(photos.scene.points.points)
    return has_sky(start, photos.scene.cameras, list(photos.train), points)


def photo_rules(config: TrainConfig, analysis: Analysis) -> PhotoRules:
    """Decide on a training; DatasetError if it has no photos."""
    photos, start = analysis.photos, analysis.start
    if not photos.train:
        raise DatasetError(
            "The capture has no training photos, because all views are held out for the test; "
            "hold out fewer."
        )
    rules = PhotoRules(
        given=start is not None,
        region=analysis.region is not None,
        block=analysis.block is not None,
        known=analysis.known,
        backdrop=analysis.facts.backdrop,
        sky=_with_sky(analysis),
    ).decided(config, photos)
    cloud = analysis.cloud
    points = min(len(cloud), max_splats_per_model(config, rules.models))
    if start is not None:
        return replace(rules, points=len(start))
    return replace(rules, points=points, left_out=len(cloud) - points)
