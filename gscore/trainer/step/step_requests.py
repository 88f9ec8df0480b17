"""Step requests: the content of a step, from options, plan, strategy and the view."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch

from ...config import Skip, TrainConfig
from ...engine.base import (
    ENGINE_SKIPS,
    EngineInfo,
    Feature,
    PictureTerm,
    ShUpdate,
    StepRequest,
    TermGradients,
    TermKind,
)
from ..analysis.analysis import Analysis
from ..depth.loss import DepthLoss, GuideLoss
from ..schedule.caps import drop_rate_at
from ..schedule.lacking_options import lacking_options, refuse
from ..schedule.plan import Plan
from ..strategy import Policy
from ..views.model_renderer import ModelRenderer
from ..views.photo_parameters import PhotoParameters
from .step_edits import SANITIZE_EVERY
from .training_views import TrainingView


class LossTerms:
    """Terms of the loss of rendered views against photos, depth maps, guide meshes and masks."""

    def __init__(
        self,
        config: TrainConfig,
        analysis: Analysis,
        *,
        opaque_weight: float,
        scale: float,
    ) -> None:
        """Create the terms.

        Args:
            config: The options.
            analysis: The capture: use of its masks, targets of depth maps and of a guide mesh.
            opaque_weight: Weight of transmittance, without masks as opacity.
            scale: Training units per world unit.
        """
        ssim, composite = config.ssim_weight, analysis.photos.mask_mode == "composite"
        depth, surface = analysis.depth, analysis.guide.surface
        weights = {
            TermKind.L1: 1 - ssim,
            TermKind.SSIM: ssim,
            TermKind.MASK_ALPHA: config.alpha_weight if composite else 0.0,
            TermKind.SEE_THROUGH: 0.0 if composite else opaque_weight,
        }
        self.terms = tuple(weights.items())
        """Kinds and weights."""
        self.depth = None if depth is None else DepthLoss(config, depth, scale=scale)
        """The depth loss; None: no depth supervision."""
        self._guide = None
        if surface is not None:
            self._guide = GuideLoss(surface, weight=config.guide_weight, scale=scale)

    @property
    def needs_pictures(self) -> bool:
        """True if any view has a loss of inverse depth."""
        return self.depth is not None or self._guide is not None

    def picture_term(self, index: int, step: int) -> PictureTerm | None:
        """Return the inverse-depth losses of view `index` at `step`, summed; None: there are
        none."""
        losses = [loss for loss in (self.depth, self._guide) if loss is not None]
        terms = [(w, loss) for loss in losses if (w := loss.weight(index, step)) > 0]
        return partial(_sum_of, terms, index) if terms else None


def _sum_of(
    terms: list[tuple[float, GuideLoss]],
    index: int,
    inverse_depth: np.ndarray,
    alpha: np.ndarray,
) -> TermGradients:
    """Compute the weighted sum of losses of view `index`, with its gradients."""
    leaves = [torch.from_numpy(a).requires_grad_() for a in (inverse_depth, alpha)]
    parts = [weight * loss(index, *leaves) for weight, loss in terms]
    term = sum(parts[1:], start=parts[0])
    if not term.requires_grad:
        return TermGradients(term.item(), None, None)
    v_inverse_depth, v_alpha = (
        None if v is None else v.numpy()
        for v in torch.autograd.grad(term, leaves, allow_unused=True)
    )
    return TermGradients(term.item(), v_inverse_depth, v_alpha)


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
            gain=gain,
            antialias=config.antialias,
            blur=photos.blur_of(training_view.index, training_view.view),
            sh_degree=degree,
            sh_update=update if degree else ShUpdate.OFF,
            rates=rates | {"means": means_lr},
            seed=config.seed,
            place=place,
            drop_rate=drop_rate_at(drop_rate, step, plan.iterations),
            noise=strategy.noise_at(means_lr),
            terms=self.terms.terms,
            picture_term=self.terms.picture_term(training_view.index, step),
            surface=config.surface_weight if step > plan.surface_after else 0.0,
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


def check_engine(
    info: EngineInfo,
    config: TrainConfig,
    analysis: Analysis,
    terms: LossTerms,
    *,
    drops: bool,
    frozen: bool,
) -> None:
    """Raise ConfigError, with the options, for what the engine cannot compute.

    Args:
        info: The engine.
        config: The options.
        analysis: The capture.
        terms: Loss terms of the training.
        drops: Whether splats are dropped out.
        frozen: Whether splats around a region are frozen.
    """
    needed = {
        Feature.PICTURE_TERMS: terms.needs_pictures,
        Feature.FROZEN: frozen,
        Feature.MASKS: analysis.photos.mask_mode != "none" or config.transient_masks,
        Feature.DROPOUT: drops,
        Feature.GAINS: analysis.gains is not None,
        Feature.POSES: analysis.pose_check.viewmats is not None,
        Feature.BLUR: config.photo_blur,
    }
    lacking = [kind for kind, weight in terms.terms if weight and kind not in info.terms]
    lacks = [
        *(f"the loss term {kind.name.lower().replace('_', ' ')}" for kind in lacking),
        *(one for one, is_used in needed.items() if is_used and one not in info.features),
        *lacking_options(config, info.features, info.skips),
    ]
    refuse(info, lacks)
