"""No double backward: an error if gradients are differentiated a second time."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ..errors import GsError


class _Once(torch.autograd.Function):
    """Passes gradients on; differentiating them raises."""

    @staticmethod
    def forward(ctx: Any, what: str, count: int, *tensors: Tensor) -> tuple[Tensor, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx.what = what
        return tuple(t.view_as(t) for t in tensors[:count])

    @staticmethod
    def backward(ctx: Any, *v_outputs: Tensor) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        raise GsError(
            f"{ctx.what} has first derivatives only, and a second one was requested. Leave out "
            "create_graph=True, or detach its gradients before they are differentiated."
        )


def no_double_backward(
    what: str, grads: Sequence[Tensor | None], inputs: Sequence[Tensor]
) -> tuple[Tensor | None, ...]:
    """Wrap the `grads` returned by a backward pass, so that differentiating them raises.

    `torch.autograd.function.once_differentiable` is not enough: it checks the incoming gradients
    only; if these are constants, like those of a sum, the results would count as constant in the
    inputs too.

    Args:
        what: Name of the function.
        grads: Gradients, or None.
        inputs: All tensors that they depend on, including the incoming gradients.
    """
    if not torch.is_grad_enabled():  # no graph of this backward pass is recorded
        return tuple(grads)
    given = [g for g in grads if g is not None]
    found = iter(_Once.apply(what, len(given), *given, *inputs))  # pyright: ignore[reportArgumentType]
    return tuple(None if g is None else next(found) for g in grads)
