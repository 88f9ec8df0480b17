"""Refit: colours, opacities and sizes of splats fitted to a viewer's rules."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..errors import GsError
from ..raster.autograd import rasterize
from ..raster.loss import image_loss
from ..raster.reference.rasterize import SplatTensors
from ..raster.request import Frustum
from ..shared_constants import ADAM_EPS
from ..splats import PARAMETERS, Splats
from .picture import drawn_picture
from .rules import ViewerRules

RATES = {"scales": 0.01, "opacities": 0.05, "sh0": 0.01, "shN": 0.001}
"""Learning rates of Adam at the first step, raw parameters; they fall to a tenth."""
_LAST_RATE = 0.1


@dataclass(frozen=True, kw_only=True)
class RefitSettings:
    """Settings of a refit."""

    steps: int
    antialias: bool
    """Whether the splats were trained with opacity compensation."""
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """sRGB."""
    seed: int = 0
    """Seed of the order of the cameras."""
    threads: int = 0
    """0: all cores."""


def tensors_of(splats: Splats) -> SplatTensors:
    """The raw parameters as tensors that share memory with the model."""
    return SplatTensors(*(torch.from_numpy(getattr(splats, name)) for name in PARAMETERS))


def refit(
    splats: Splats,
    views: Sequence[Frustum],
    rules: ViewerRules,
    settings: RefitSettings,
    *,
    on_step: Callable[[int, float], None],
) -> Splats:
    """Fit scales, opacities and SH so that a viewer shows gscore's own pictures of the splats.

    Each step draws a camera by both rules and takes an Adam step down the loss of a training
    between the pictures. Positions, rotations and the number of splats do not change.

    Args:
        splats: The model.
        views: Cameras, at least one.
        rules: Of the viewer.
        settings: Settings.
        on_step: Called after each step with its number, from 1, and the loss; may raise.

    Returns:
        The fitted model.

    Raises:
        GsError: The loss is not finite.
    """
    given = tensors_of(splats)
    fitted = {name: getattr(given, name).clone().requires_grad_() for name in RATES}
    groups = [{"params": [fitted[name]], "lr": rate} for name, rate in RATES.items()]
    adam = torch.optim.Adam(groups, eps=ADAM_EPS)
    fall = torch.optim.lr_scheduler.ExponentialLR(adam, _LAST_RATE ** (1 / settings.steps))
    order = np.random.default_rng(settings.seed)
    rounds: list[int] = []
    for step in range(1, settings.steps + 1):
        rounds = rounds or order.permutation(len(views)).tolist()
        view = views[rounds.pop()]
        target = _own_picture(given, view, settings)
        picture = drawn_picture(
            given._replace(**fitted), view, rules, settings.background, threads=settings.threads
        )
        loss = image_loss(picture.clamp(max=1), target, threads=settings.threads).loss
        adam.zero_grad()
        loss.backward()
        adam.step()
        fall.step()
        value = loss.item()
        if not math.isfinite(value):
            raise GsError(f"The loss of step {step} of the refit is not finite.")
        on_step(step, value)
    found = {name: value.detach().numpy() for name, value in fitted.items()}
    return Splats(means=splats.means, quats=splats.quats, **found)


def _own_picture(splats: SplatTensors, view: Frustum, settings: RefitSettings) -> Tensor:
    """[H, W, 3] uint8, gscore's own picture."""
    with torch.no_grad():
        rgb = rasterize(
            *splats,
            torch.as_tensor(view.viewmat, dtype=torch.float32, device="cpu"),
            torch.as_tensor(view.K, dtype=torch.float32, device="cpu"),
            view.width,
            view.height,
            raw=True,
            background=settings.background,
            near=view.near,
            antialias=settings.antialias,
            threads=settings.threads,
        ).rgb
        return (rgb.clamp(0, 1) * 255).round().to(torch.uint8)
