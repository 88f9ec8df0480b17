"""Refit: colours, opacities and sizes of splats fitted to a viewer's rules."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..errors import BackendError, GsError
from ..raster.autograd import rasterize
from ..raster.gpu.choice import CPU, Chosen
from ..raster.gpu.gpu_raster import GpuRaster
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
    device: Chosen = CPU
    """The device that draws, and computes gradients of pictures."""


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
        BackendError: The device failed, and the CPU may not continue.
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
        adam.zero_grad()
        try:
            value = _differentiate(given, fitted, view, rules, settings)
        except BackendError as error:
            if not settings.device.fall_back(error):
                raise
            adam.zero_grad()
            value = _differentiate(given, fitted, view, rules, settings)
        adam.step()
        fall.step()
        if not math.isfinite(value):
            raise GsError(
                f"Step {step} of the refit: the loss is not finite. Check the splats and photos, "
                "or give fewer `--iterations`."
            )
        on_step(step, value)
    found = {name: value.detach().numpy() for name, value in fitted.items()}
    return Splats(means=splats.means, quats=splats.quats, **found)


def _differentiate(
    given: SplatTensors,
    fitted: dict[str, Tensor],
    view: Frustum,
    rules: ViewerRules,
    settings: RefitSettings,
) -> float:
    """Compute the loss of a view and add its gradients to those of `fitted`; returns the loss."""
    threads, device = settings.threads, settings.device.raster()
    target = _own_picture(given, view, settings, device)
    splats, background = given._replace(**fitted), settings.background
    picture = drawn_picture(splats, view, rules, background, threads=threads, device=device)
    loss = image_loss(picture.clamp(max=1), target, threads=threads).loss
    loss.backward()
    return loss.item()


def _own_picture(
    splats: SplatTensors, view: Frustum, settings: RefitSettings, device: GpuRaster | None
) -> Tensor:
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
            device=device,
        ).rgb
        return (rgb.clamp(0, 1) * 255).round().to(torch.uint8)
