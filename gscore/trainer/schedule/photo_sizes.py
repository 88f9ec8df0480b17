"""Photo sizes of the coarse-to-fine start, and the times at which they change."""

import math


def _side(stage: int) -> float:
    """Relative side at which stage `stage` begins: between two powers of the root of 2."""
    return 2.0 ** -(stage / 2 + 0.25)


def photo_size_stages(coarse: float) -> tuple[float, ...]:
    """Return the times at which photos become larger, relative to the time of full size.

    From entry k on, sides are divided by 2^(k / 2); before the last entry they have the first size.
    The number of pixels rises with the square of the time.

    Args:
        coarse: First divisor of the sides, at least 1.
    """
    count = round(2 * math.log2(coarse))
    if count == 0:
        return ()
    least = coarse**-2
    sides = map(_side, range(count))
    return tuple(math.sqrt(max(side**2 - least, 0.0) / (1 - least)) for side in sides)
