"""Values of splats that passes show: albedo, shadow, and number; no bpy."""

from collections.abc import Callable, Sequence

import numpy as np

from .. import attributes
from ..core import sh0_to_rgb
from ..srgb import decode
from .mesh_copies import FrozenMesh
from .model import decoded, surface_of
from .relight import shade
from .scene import Placed

ALBEDO, SHADOW, NUMBER = "albedo", "shadow", "number"
"""Names of the values."""


def values_of(name: str, placed: Sequence[Placed]) -> np.ndarray:
    """The values of the splats of a model, in its order.

    Args:
        name: ALBEDO: [N, 3] float32, linear Rec. 709; 0 where it is not known. SHADOW: [N, 3]
            float32, factor of the color by shadows; 1: none. NUMBER: [N] int32, index in the
            object, before filters; -1 for holdouts.
        placed: The objects.
    """
    return np.concatenate([_VALUES[name](one) for one in placed])


def _column(placed: Placed, name: str) -> np.ndarray:
    """An attribute of the drawn splats."""
    column = placed.frozen.columns[name]
    return column if placed.filters is None else column[placed.frozen.kept(placed.filters)]


def _numbers(placed: Placed) -> np.ndarray:
    count = len(placed.frozen.vertices)
    numbers = np.arange(count, dtype=np.int32)
    if placed.filters is not None:
        numbers = numbers[placed.frozen.kept(placed.filters)]
    return np.full_like(numbers, -1) if placed.holdout else numbers


def _albedo(placed: Placed) -> np.ndarray:
    found = np.zeros((len(_numbers(placed)), 3), np.float32)
    frozen = placed.frozen
    if placed.holdout or not (isinstance(frozen, FrozenMesh) and frozen.can_be_relit):
        return found
    light = _column(placed, attributes.CAPTURED)
    color = decode(sh0_to_rgb(_column(placed, attributes.BASE)[:, :3]))
    return np.divide(color, light, out=found, where=light > 0)


def _shadow(placed: Placed) -> np.ndarray:
    how = placed.relighting
    if how is None or placed.holdout:
        return np.ones((len(_numbers(placed)), 3), np.float32)
    captured = decoded(placed)[1]
    return shade(captured.means, *surface_of(placed, captured), how)


_VALUES: dict[str, Callable[[Placed], np.ndarray]] = {
    ALBEDO: _albedo,
    SHADOW: _shadow,
    NUMBER: _numbers,
}
