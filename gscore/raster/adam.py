"""The native Adam on torch tensors: a step of all parameters of N splats; rows that skip steps."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from . import _native
from .calls import check_array

LAGS = _native.ADAM_LAGS


@dataclass
class Skips:
    """Which rows of a tensor skip steps, and what they have to make up for (gs_adam_tensor)."""

    seen: Tensor
    """[N] uint8: 1 where a gradient has come since the row's last step."""
    lag: Tensor
    """[N] uint8: steps skipped."""
    drift: Tensor
    """[LAGS] float64: sums of skipped steps."""
    wait: bool = False
    """No row steps: gradients gather for a later call."""


@dataclass
class Slot:
    """A parameter and what Adam keeps for it: tensors [N, ...] float32, contiguous, CPU."""

    value: Tensor
    grad: Tensor
    moment1: Tensor
    moment2: Tensor
    rate: float
    """Learning rate."""
    step: int
    """Number of this step, from 1."""
    skips: Skips | None = None
    """None: every row takes every step."""


def step(slots: Sequence[Slot], radii: Tensor | None, *, threads: int = 0) -> int:
    """One Adam step (Kingma and Ba 2015; beta 0.9 and 0.999, eps 1e-15) of all `slots`, in place.

    Rows with a gradient that is not finite get zero gradients. Results do not depend on `threads`.

    Args:
        slots: Of the same N rows each, none empty.
        radii: [N] int32: rows above 0 had a gradient in this step; None: all.
        threads: 0: all cores.

    Returns:
        Number of rows whose gradients were not finite.

    Raises:
        ShapeError: a tensor has another shape, dtype or layout than it should.
    """
    count = len(slots[0].value)
    structs = [_struct(slot, count) for slot in slots]
    if radii is not None:
        check_array("radii", radii, (count,), torch.int32)
    address = None if radii is None else radii.data_ptr()
    return _native.adam_step(structs, count, address, threads)


@dataclass(frozen=True)
class Frustum:
    """A camera as `rasterize` takes it."""

    viewmat: Tensor
    K: Tensor
    width: int
    height: int
    near: float
    far: float = 1e10
    eps2d: float = 0.3


def catch_up(
    slot: Slot,
    params: Mapping[str, Tensor],
    view: Frustum | None = None,
    *,
    out: Tensor | None = None,
    threads: int = 0,
) -> None:
    """Let rows that skipped steps make up for them.

    Args:
        slot: With `skips`; `step` is the number of its last step.
        params: Raw `means` [N, 3] and `scales` [N, 3] of the splats, which tell where they are.
        view: Only rows that this camera may draw; None: all.
        out: Where the values go, as `slot.value`; None: in place.
        threads: 0: all cores.

    Raises:
        ShapeError: a tensor has another shape, dtype or layout than it should.
    """
    count = len(slot.value)
    struct = _struct(slot, count)
    if out is not None:
        check_array("out", out, tuple(slot.value.shape), torch.float32)
    means, scales = params["means"], params["scales"]
    check_array("means", means, (count, 3), torch.float32)
    check_array("scales", scales, (count, 3), torch.float32)
    splats = _native.SplatsStruct(
        count=count, means=means.data_ptr(), scales=scales.data_ptr(), raw=1
    )
    camera = None
    if view is not None:
        camera = _native.camera_struct(
            view.viewmat.numpy(), view.K.numpy(), view.width, view.height, view.near, view.far
        )
    _native.adam_catch_up(
        struct,
        splats,
        camera,
        eps2d=0.3 if view is None else view.eps2d,
        out=None if out is None else out.data_ptr(),
        threads=threads,
    )


def _struct(slot: Slot, count: int) -> _native.AdamTensorStruct:
    shape = tuple(slot.value.shape)
    for name in ("value", "grad", "moment1", "moment2"):
        check_array(name, getattr(slot, name), (count, *shape[1:]), torch.float32)
    struct = _native.AdamTensorStruct(
        slot.value.data_ptr(),
        slot.grad.data_ptr(),
        slot.moment1.data_ptr(),
        slot.moment2.data_ptr(),
        math.prod(shape[1:]),
        _native.ADAM_ALL,
        slot.rate,
        slot.step,
    )
    skips = slot.skips
    if skips is not None:
        check_array("seen", skips.seen, (count,), torch.uint8)
        check_array("lag", skips.lag, (count,), torch.uint8)
        check_array("drift", skips.drift, (LAGS,), torch.float64)
        struct.mode = _native.ADAM_WAIT if skips.wait else _native.ADAM_SEEN
        struct.seen, struct.lag = skips.seen.data_ptr(), skips.lag.data_ptr()
        struct.drift = skips.drift.data_ptr()
    return struct
