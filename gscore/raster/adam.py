"""Native Adam on torch tensors: one step for all parameters of N splats; rows that skip steps."""

import ctypes as ct
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from torch import Tensor

from ..shared_constants import EPS2D
from . import _native, arguments, header
from .buffers import FLOAT64, INT32, UINT8, address, optional
from .request import Frustum, Settings

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
    count, bad = len(slots[0].value), ct.c_int64(0)
    args = header.AdamStruct(
        count,
        len(slots),
        (header.AdamTensorStruct * len(slots))(*(_struct(slot, count) for slot in slots)),
        optional("radii", radii, (count,), INT32),
        arguments.library_threads(threads),
    )
    _native.raise_status(_native.library().gs_adam_step(ct.byref(args), ct.byref(bad)))
    return bad.value


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
    places = {name: address(name, params[name], (count, 3)) for name in ("means", "scales")}
    seen = None if view is None else arguments.view(view, Settings(eps2d=eps2d), 0)
    status = _native.library().gs_adam_catch_up(
        ct.byref(_struct(slot, count)),
        ct.byref(header.SplatsStruct(count=count, raw=1, **places)),
        None if seen is None else ct.byref(seen),
        optional("out", out, tuple(slot.value.shape)),
        arguments.library_threads(threads),
    )
    _native.raise_status(status)


def _struct(slot: Slot, count: int) -> ct.Structure:
    """gs_adam_tensor"""
    width = tuple(slot.value.shape[1:])
    names = ("value", "grad", "moment1", "moment2")
    struct = header.AdamTensorStruct(
        *(address(name, getattr(slot, name), (count, *width)) for name in names),
        math.prod(width),
        header.ADAM_ALL,
        slot.rate,
        slot.step,
        photos=slot.photos,
    )
    if slot.skips is not None:
        skips, size = slot.skips, (header.ADAM_PENDING_SIZE,)
        struct.mode = header.ADAM_WAIT if skips.wait else header.ADAM_VISIBLE
        struct.visible = address("visible", skips.visible, (count,), UINT8)
        struct.pending = address("pending", skips.pending, (count,), UINT8)
        struct.factors = address("factors", skips.factors, size, FLOAT64)
    return struct
