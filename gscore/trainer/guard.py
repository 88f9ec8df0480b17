"""Guards against numbers that are not finite."""

import math

import torch

from ..errors import GsError
from .model import Model


def zero_bad_rows(model: Model) -> int:
    """Zero the gradients of splats that have any gradient which is not finite.

    The constant colour stands for all coefficients: their gradients are its gradient times basis
    functions of the direction, which are finite where the gradient of the mean is.

    Returns:
        Number of such splats; 0 in all but broken cases, which a plain sum finds out quickly.
    """
    names = ("means", "quats", "scales", "opacities", "sh0")
    grads = [g for name in names if (g := model.params[name].grad) is not None]
    if all(math.isfinite(float(g.sum())) for g in grads):
        return 0
    bad = torch.zeros(len(model), dtype=torch.bool)
    for grad in grads:
        bad |= ~torch.isfinite(grad).reshape(len(model), -1).all(dim=1)
    for p in model.params.values():
        if p.grad is not None:
            p.grad[bad] = 0
    return int(bad.sum())


def assert_finite(model: Model, loss: float, *, step: int, view: str) -> None:
    """Raise GsError if the loss or any gradient is not finite, and say which."""
    if not math.isfinite(loss):
        raise GsError(f"Step {step}, view {view}: the loss is {loss}.")
    for name, p in model.params.items():
        if p.grad is None:
            continue
        bad = int((~torch.isfinite(p.grad)).reshape(len(model), -1).any(dim=1).sum())
        if bad:
            raise GsError(
                f"Step {step}, view {view}: the gradient of {name} is not finite for {bad} of "
                f"{len(model)} splats."
            )
