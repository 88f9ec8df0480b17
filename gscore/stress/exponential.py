"""S21, exponential: the exponential function of the blending loops."""

from collections.abc import Iterator

import numpy as np

from ..raster import _native
from ..text_format import count_text
from .case import EmptyTestError, Measure, case

_LOWEST = -40.0
_BLOCK = 1 << 22


@case("S21", "exp2", needs=())
def exponential(full: bool) -> Iterator[Measure]:
    """Oracle: exp2 in float64; all float32 in [-40, 0] in the full suite, else one in 997 and the
    neighbourhoods of the seams of the range reduction, monotonic within one ulp."""
    last = int(np.array(_LOWEST, np.float32).view(np.uint32))
    first = int(np.array(-0.0, np.float32).view(np.uint32))
    step = 1 if full else 997
    worst = disorder = 0.0
    count = 0
    for start in range(first, last + 1, _BLOCK * step):
        bits = np.arange(start, min(start + _BLOCK * step, last + 1), step, dtype=np.int64)
        x = bits.astype(np.uint32).view(np.float32)
        y = _native.exp2(x)
        worst = np.maximum(worst, np.abs(y / np.exp2(x.astype(np.float64)) - 1).max())
        disorder = np.maximum(disorder, _disorder(y))
        count += len(x)
    for seam in np.arange(-39.5, 0, 0.5):
        near = np.array(seam, np.float32).view(np.int32) + np.arange(-2000, 2000, dtype=np.int32)
        x = near.astype(np.uint32).view(np.float32)
        y = _native.exp2(x)
        worst = np.maximum(worst, np.abs(y / np.exp2(x.astype(np.float64)) - 1).max())
        disorder = np.maximum(disorder, _disorder(y))
    if not worst > 0 or count < 1_000_000:
        raise EmptyTestError("nothing was measured")
    yield Measure("relative error", float(worst), 2.5e-7, count_text(count, "value"))
    yield Measure("order, ulp", float(disorder), 1.0)


def _disorder(y: np.ndarray) -> float:
    """Largest increase, in units of the last place, of values that should decrease."""
    rise = y[1:] - y[:-1]
    return float(np.maximum(0.0, (rise / np.spacing(y[:-1])).max()))
