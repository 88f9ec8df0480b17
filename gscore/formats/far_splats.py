"""Far splats and other extreme values, for formats that quantise over all splats."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..morton import distances_from_middle, middle_of
from ..splats import Splats
from ..text_format import count_text

_COARSE = 2.0**-10
"""Smallest reported step, in median distances of splats from their middle: a camera at that
distance with a focal length of 1,000 pixels sees a step as one pixel."""
FAR = 8.0
"""Splats within this many median distances are never moved."""
_NEAR_SHARE = 90.0
"""Percentage of nearest splats that are never moved."""
_FEW = 16
"""No splat of models with fewer splats is moved."""

StepOf = Callable[[np.ndarray, np.ndarray, np.ndarray], float]
"""Returns the step of positions near the middle [3] if all are between low [3] and high [3], world
units."""


def without_far(
    splats: Splats, step_of: StepOf, fine: float, name: str
) -> tuple[Splats, list[str]]:
    """Move splats towards the middle that would make the position steps of all others coarse.

    They are moved along straight lines and shrunk in proportion, so that they look nearly the same
    from the middle. None is moved if the steps are fine with them, or coarse even without them.

    Args:
        splats: The model.
        step_of: Step of the format's positions.
        fine: Step that is fine enough, in median distances of splats from their middle; at least
            twice the format's finest step is used.
        name: Name of the format.

    Returns:
        The splats (`splats` itself if none is moved), and notes on moved splats and coarse steps.
    """
    if not len(splats):
        return splats, []
    middle, (away, usual) = middle_of(splats.means), distances_from_middle(splats.means)
    low, high = (end(splats.means, axis=0).astype(np.float64) for end in (np.min, np.max))

    def step_within(limit: float) -> float:
        return step_of(np.maximum(low, middle - limit), np.minimum(high, middle + limit), middle)

    limit, notes = float(away.max()), []
    least = max(FAR * usual, float(np.percentile(away, _NEAR_SHARE, method="lower")))
    if len(splats) >= _FEW and limit > least:
        target = max(fine * usual, 2 * step_within(least))
        while step_within(limit) > target:
            limit = max(limit / 2, least)
    moved = away > limit
    if moved.any():
        splats = moved_within(splats, moved, away, limit)
        notes.append(
            f"{count_text(int(moved.sum()), 'splat')} up to {away.max():.3g} units away from the "
            f"others were moved to {limit:.3g} units and made smaller, so that the positions of "
            f"all keep steps of {step_within(limit):.2g} units in {name}. Remove far splats first, "
            f"with gscore convert --box or --sphere."
        )
    if len(splats) >= _FEW and step_within(limit) > _COARSE * usual:
        notes.append(
            f"{name} rounds the positions of these splats to {step_within(limit):.2g} units, which "
            f"is coarse for splats {usual:.2g} units around their middle: they are too far from "
            f"the origin or from each other. Move them to the origin, with gscore convert --move, "
            f"or write a PLY."
        )
    return splats, notes


def moved_within(splats: Splats, moved: np.ndarray, away: np.ndarray, limit: float) -> Splats:
    """Splats moved towards the middle and shrunk in proportion.

    Args:
        splats: The model.
        moved: [N] bool, splats to move.
        away: [N], as from `distances_from_middle`.
        limit: New distance along their farthest axis, world units.
    """
    middle = middle_of(splats.means)
    share = limit / away[moved, None]
    means, scales = splats.means.copy(), splats.scales.copy()
    means[moved] = middle + (means[moved] - middle) * share
    scales[moved] += np.log(share).astype(np.float32)
    return replace(splats, means=means, scales=scales)


def cut_extremes(splats: Splats, field: str, most: float) -> tuple[Splats, int]:
    """The splats with one parameter clipped to -`most` to `most`, and the number of changed
    splats."""
    values = getattr(splats, field)
    if values.max(initial=0.0) <= most and values.min(initial=0.0) >= -most:
        return splats, 0
    beyond = (np.abs(values) > most).any(axis=tuple(range(1, values.ndim)))
    return replace(splats, **{field: np.clip(values, -most, most)}), int(beyond.sum())
