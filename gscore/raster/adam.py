"""Native Adam on torch tensors: one step for all parameters of N splats; rows that skip steps."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from torch import Tensor

from ..shared_constants import EPS2D
from . import _native, arguments, header
from .request import Frustum

PENDING_SIZE = header.ADAM_PENDING_SIZE


@dataclass
class Skips:
    """State of rows that skip steps, for lazy Adam (gs_adam_tensor)."""

    visible: Tensor
    """[N] uint8: 1 where a gradient arrived since the row's last step."""
    pending: Tensor
    """[N] uint8: number of pending steps."""
    factors: Tensor
    """[PENDING_SIZE] float64: sums of the pending steps."""
    wait: bool = False
    """No row steps; gradients accumulate for a later call."""


@dataclass
class Slot:
    """A parameter and its Adam moments: tensors [N, ...] float32, contiguous, CPU."""

    value: Tensor
    grad: Tensor
    moment1: Tensor
    moment2: Tensor
    rate: float
    """Learning rate."""
    step: int
    """Number of this step, from 1."""
    skips: Skips | None = None
    """State of lazy Adam; None: every row takes every step."""
    photos: int = 1
    """Number of photos in the gradient: the betas are raised to this power, and `step` counts
    photos. Must be 1 with `skips`."""


def step(slots: Sequence[Slot], radii: Tensor | None, *, threads: int = 0) -> int:
    """One Adam step (Kingma and Ba 2015; beta 0.9 and 0.999, eps 1e-15) of all `slots`, in place.

    Rows with a gradient that is not finite get zero gradients. Results do not depend on `threads`.

    Args:
        slots: Parameters of the same N rows, none empty.
        radii: [N] int32: rows above 0 had a gradient in this step; None: all.
        threads: 0: all cores.

    Returns:
        Number of rows whose gradients were not finite.

    Raises:
        ShapeError: a tensor has a wrong shape, dtype or layout.
    """
    count = len(slots[0].value)
    structs = [_struct(slot, count) for slot in slots]
    return _native.adam_step(structs, count, radii, threads)


def catch_up(
    slot: Slot,
    params: Mapping[str, Tensor],
    view: Frustum | None = None,
    *,
    eps2d: float = EPS2D,
    out: Tensor | None = None,
    threads: int = 0,
) -> None:
    """Apply the pending steps of rows (sync of lazy Adam).

    Args:
        slot: With `skips`; `step` is the number of its last step.
        params: Raw `means` [N, 3] and `scales` [N, 3] of the splats, for the test against `view`.
        view: Only rows that this camera may draw; None: all.
        eps2d: Screen-space dilation of that camera, px^2.
        out: Output with the shape of `slot.value`; None: in place.
        threads: 0: all cores.

    Raises:
        ShapeError: a tensor has a wrong shape, dtype or layout.
    """
    count = len(slot.value)
    _native.adam_catch_up(
        _struct(slot, count),
        arguments.placed_splats(params["means"], params["scales"], count),
        view,
        eps2d=eps2d,
        out=out,
        shape=tuple(slot.value.shape),
        threads=threads,
    )


def _struct(slot: Slot, count: int) -> header.AdamTensorStruct:
    arrays = {
        "value": slot.value,
        "grad": slot.grad,
        "moment1": slot.moment1,
        "moment2": slot.moment2,
    }
    struct = arguments.adam_tensor(arrays, count=count, rate=slot.rate, number=slot.step)
    struct.photos = slot.photos
    skips = slot.skips
    if skips is not None:
        arguments.allow_lazy_rows(
            struct,
            count=count,
            visible=skips.visible,
            pending=skips.pending,
            factors=skips.factors,
            mode=header.ADAM_WAIT if skips.wait else header.ADAM_VISIBLE,
        )
    return struct
