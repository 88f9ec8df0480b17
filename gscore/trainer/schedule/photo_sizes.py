"""Photo sizes of the coarse-to-fine start, and the steps at which they change."""

import math


def _side(stage: int) -> float:
    """The side, as a share of the full one, at which the next larger photos come: between two
    powers of the root of 2."""
    return 2.0 ** -(stage / 2 + 0.25)


def photo_size_stages(coarse: float) -> tuple[float, ...]:
    """When photos become larger, as shares of the time that they take to reach full size.

    Entry k is when their sides are divided by 2^(k / 2) and no more; the last entry is below the
    first size. The number of pixels rises with the square of the time.

    Args:
        coarse: What the sides are divided by at first, at least 1.
    """
    count = round(2 * math.log2(coarse))
    if count == 0:
        return ()
    least = coarse**-2
    sides = map(_side, range(count))
    return tuple(math.sqrt(max(side**2 - least, 0.0) / (1 - least)) for side in sides)
