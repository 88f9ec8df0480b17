"""Step requests: the content of a step, from options, plan, strategy and the view."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ...config import Skip, TrainConfig
from ...engine.base import ENGINE_SKIPS, ShUpdate, StepRequest
from ..schedule.caps import drop_rate_at
from ..schedule.plan import Plan
from ..strategy import Policy
from ..views.model_renderer import ModelRenderer
from ..views.photo_gains import as_color
from ..views.photo_parameters import PhotoParameters
from .loss_terms import LossTerms
from .step_edits import SANITIZE_EVERY
from .training_views import TrainingView


@dataclass(eq=False)
class StepRequests:
    """Requests of a training's steps."""

    config: TrainConfig
    """The options."""
    terms: LossTerms
    """Loss terms."""
    renderer: ModelRenderer
    """Has the views."""
    photo_parameters: PhotoParameters
    """Gains and poses of the photos."""
    names: Sequence[str]
    """Names of the photos."""
    extent: float
    """Camera extent, training units."""
    first_degree: int
    """SH degree of the start splats."""

    def of(
        self,
        training_view: TrainingView,
        plan: Plan,
        strategy: Policy,
        step: int,
        *,
        place: int,
        rate_factor: float,
        drop_rate: float,
    ) -> StepRequest:
        """Return the request of `step`.

        Args:
            training_view: View of the step.
            plan: Plan of the run.
            strategy: Strategy of the run.
            step: Number of the step.
            place: Index of the model.
            rate_factor: Factor of all learning rates.
            drop_rate: Dropout rate at the last step.
        """
        config, photos, gain = self.config, self.photo_parameters, training_view.gain
        count, shown = len(training_view.indices), training_view.background
        means_lr = rate_factor * plan.means_lr_at(step) * math.sqrt(count)
        rates = {name: rate_factor * rate for name, rate in plan.rates_at(step, count).items()}
        others, factor = list(training_view.indices), training_view.factor
        others.remove(training_view.index)
        degree = max(plan.sh_degree_at(step), self.first_degree)
        update = ShUpdate.STEP if plan.harmonics_update_at(step, count) else ShUpdate.ACCUMULATE
        return StepRequest(
            step=step,
            photo=training_view.index,
            view=training_view.view,
            others=tuple(self.renderer.view(i, factor) for i in others),
            background=self.renderer.background_before_gain(shown, gain),
            shown_background=shown,
            gain=None if gain is None else as_color(gain),
            antialias=config.antialias,
            sh_degree=degree,
            sh_update=update if degree else ShUpdate.OFF,
            rates=rates | {"means": means_lr},
            seed=config.seed,
            place=place,
            drop_rate=drop_rate_at(drop_rate, step, plan.iterations),
            noise=strategy.noise_at(means_lr),
            terms=self.terms.terms,
            picture_term=self.terms.picture_term(training_view.index, step),
            opacity_reg=strategy.opacity_reg,
            scale_reg=strategy.scale_reg,
            observe=strategy.counters if strategy.observes_at(step) else (),
            learn_gain=photos.gains is not None,
            learn_pose=photos.pose_rate(step / plan.iterations) > 0,
            update_hidden=Skip.UNSEEN_SH in config.without,
            extent=self.extent,
            disable=ENGINE_SKIPS & frozenset(config.without),
            check_finite=self.names[training_view.index] if config.detect_anomaly else "",
            compare=(step - count) % SANITIZE_EVERY == 0,
        )
