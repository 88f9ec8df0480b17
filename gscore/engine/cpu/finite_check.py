"""Finite check of loss and gradients; `CpuModel.step` skips rows that are not finite."""

import math
from typing import TYPE_CHECKING

import torch

from ...errors import GsError
from ...text_format import count_text

if TYPE_CHECKING:
    from .model import CpuModel


def assert_finite(model: "CpuModel", loss: float, *, step: int, view: str) -> None:
    """Raise GsError naming the loss or the first gradient that is not finite."""
    if not math.isfinite(loss):
        raise GsError(f"Step {step}, view {view}: the loss is {loss}.")
    for name, grad in model.grads.items():
        bad = int((~torch.isfinite(grad)).reshape(len(model), -1).any(dim=1).sum())
        if bad:
            raise GsError(
                f"Step {step}, view {view}: the gradient of {name} is not finite for {bad} of "
                f"{count_text(len(model), 'splat')}."
            )
