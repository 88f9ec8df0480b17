"""Through which sizes photos go while a run starts small, and when."""

import math
from collections.abc import Sequence


def _side(stage: int) -> float:
    return 2.0 ** -(stage / 2 + 0.25)


SIDES = tuple(map(_side, range(7)))
"""Sides, as shares of the full ones, at which the next larger photos come: those between two powers
of the root of 2, in between which the sides lie."""


def stages(coarse: float, detail: Sequence[float] | None = None) -> tuple[float, ...]:
    """When photos become larger, as shares of the time that they take to reach full size.

    Entry k is when their sides are divided by 2^(k / 2) and no more; the last entry is below the
    first size. With `detail`, the share of the time that a size gets is what it adds to the detail
    of the sizes before it (after Chen et al. 2025, DashGaussian): photos that are soft spend little
    time at full size.

    Args:
        coarse: What the sides are divided by at first, at least 1.
        detail: Share of the detail that remains at each of `SIDES`; None: does not matter, the
            number of pixels rises with the square of the time.
    """
    count = round(2 * math.log2(coarse))
    if count == 0:
        return ()
    if detail is None:
        least = coarse**-2
        sides = map(_side, range(count))
        return tuple(math.sqrt(max(side**2 - least, 0.0) / (1 - least)) for side in sides)
    first = _at(1 / coarse, detail)
    shares = [_at(_side(k), detail) for k in range(count)]
    return tuple(max(share - first, 0.0) / max(1 - first, 1e-9) for share in shares)


def _at(side: float, detail: Sequence[float]) -> float:
    """Detail that remains at a share of the sides: between two of `SIDES` straight over its
    logarithm, beyond them in proportion."""
    place = -2 * math.log2(side) - 0.5
    if place <= 0:
        return detail[0] + (1 - detail[0]) * min(-2 * place, 1.0)
    if place >= len(SIDES) - 1:
        return detail[-1] * side / SIDES[-1]
    k = int(place)
    return detail[k] + (detail[k + 1] - detail[k]) * (place - k)
