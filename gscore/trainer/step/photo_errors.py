"""Photo errors: the last error of each training photo, and the photos that fit far worse."""

import math
from collections.abc import Sequence

import numpy as np

from ...quoting import brief, first_few
from ...robust import SIGMA_PER_MEDIAN
from ...text_format import count_text

_FEWEST = 12
"""Photos of which outliers are named."""
_STEPS = 10
"""Steps per photo after which the errors of two of them may be compared."""
_FAR, _DEVIATIONS = 5.0, 5.0
"""Distance from the median PSNR down to an outlier: dB, and standard deviations by the median
deviation. Two of plush's 59 photos are, by 13 and 15 dB, of horse's and southbuilding's none."""
_MOST_SHARE = 0.3
"""Share of the photos above which there is no usual one to compare with."""
_NAMED = 3


class PhotoErrors:
    """Mean squared error of each photo in its last step."""

    def __init__(self) -> None:
        self._last: dict[int, float] = {}

    def note(self, indices: Sequence[int], mse: float) -> None:
        """Add a step; the error of several photos together belongs to none."""
        if len(indices) == 1 and math.isfinite(mse):
            self._last[indices[0]] = mse

    def outliers(self, names: Sequence[str], train: Sequence[int], steps: int) -> str:
        """A sentence on the training photos that fit far worse than the others.

        Args:
            names: Names of all photos.
            train: Indices of the training photos.
            steps: Steps taken.

        Returns:
            The sentence; empty if there are none, or too few photos or steps for a comparison.
        """
        count = len(train)
        if count < _FEWEST or steps < _STEPS * count or not set(train) <= self._last.keys():
            return ""
        psnr = -10 * np.log10(np.maximum([self._last[i] for i in train], 1e-10))
        middle = float(np.median(psnr))
        spread = SIGMA_PER_MEDIAN * float(np.median(abs(psnr - middle)))
        order = np.argsort(psnr, kind="stable")
        worst = order[: int((psnr < middle - max(_FAR, _DEVIATIONS * spread)).sum())]
        if not 0 < len(worst) <= max(_MOST_SHARE * count, 1):
            return ""
        named = [f"{brief(names[train[int(i)]])} ({psnr[i]:.1f} dB)" for i in worst]
        several = len(worst) > _NAMED
        hint = " SfM may have confused two sides of a symmetric object." if several else ""
        fits = count_text(len(worst), "training photo fits", "training photos fit")
        return (
            f"{fits} far worse than the others, whose median is {middle:.1f} dB: "
            f"{first_few(named, _NAMED)}. Blur, a wrong camera, other light or something that "
            f"moved harms the model; training without may be better.{hint}"
        )
