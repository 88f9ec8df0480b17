"""Exposure of a photo: the change of its sRGB values by a gain in light.

Light times g^2.4 changes a value v of the sRGB curve, 1.055 L^(1/2.4) - 0.055 (IEC 61966-2-1), to
(v + 0.055) g - 0.055, and of its linear part, below 0.04, to v g^2.4. The exposure of a gain is the
second line below their intersection and the first above it: continuous, monotonic, and black stays
black. csrc/src/exposure.h has the same curve for the loss.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, Self

import numpy as np

from .shared_constants import EXPOSURE_OFFSET, EXPOSURE_POWER


class PhotoExposure(NamedTuple):
    """Change of sRGB values from the mean exposure of a training to that of a photo."""

    gain: np.ndarray
    """[3] float64, R, G, B, above 0."""
    offset: np.ndarray
    """[3] float64; 0, as in files of gains of values: the gain alone, in the dark too."""

    @classmethod
    def of(cls, gain: Sequence[float] | np.ndarray | None) -> Self:
        """Return the exposure of a gain [3] of sRGB values, light times gain^2.4; None: 1."""
        gain = np.ones(3) if gain is None else np.asarray(gain, np.float64)
        return cls(gain, EXPOSURE_OFFSET * (gain - 1.0))

    @property
    def nearest_gain(self) -> np.ndarray:
        """The gain [3] whose exposure is nearest: by least squares over values from 0 to 1, without
        the dark. That of `of` itself."""
        values = np.linspace(0.0, 1.0, 33)[:, None] + EXPOSURE_OFFSET
        changed = (values - EXPOSURE_OFFSET) * self.gain + self.offset + EXPOSURE_OFFSET
        return (values * changed).sum(axis=0) / (values**2).sum(axis=0)

    @property
    def neutral(self) -> bool:
        """Whether nothing changes."""
        return bool((self.gain == 1).all() and not self.offset.any())

    def apply(self, rgb: np.ndarray, alpha: np.ndarray | float = 1.0) -> np.ndarray:
        """Expose values [..., 3], premultiplied by `alpha` [..., 1]; dtype as theirs."""
        if self.neutral:
            return rgb
        steep, dark = self._dark()
        return _two_lines(rgb, alpha, dark, steep, self.gain, self.offset)

    def undo(self, rgb: np.ndarray) -> np.ndarray:
        """Return the values [..., 3] that `apply` changes to these; dtype as theirs."""
        steep, dark = self._dark()
        offset = -self.offset / self.gain
        return _two_lines(rgb, 1.0, dark * steep, 1 / steep, 1 / self.gain, offset)

    def _dark(self) -> tuple[np.ndarray, np.ndarray]:
        """Slope below the intersection of both lines, and its value, [3] each."""
        steep = self.gain**EXPOSURE_POWER
        apart = steep - self.gain
        return steep, np.divide(self.offset, apart, out=np.zeros(3), where=apart != 0)

    def behind(self, background: Sequence[float]) -> tuple[float, float, float]:
        """Return the colour that `apply` changes to `background`: splats are rendered over it for
        photos composited over a background, whose colour does not depend on the exposure."""
        r, g, b = self.undo(np.asarray(background, np.float64)).tolist()
        return (r, g, b)

    def behind_by_log_gain(self, background: Sequence[float]) -> np.ndarray:
        """Return the derivative [3] of `behind` in ln gain."""
        steep, dark = self._dark()
        b = np.asarray(background, np.float64)
        bright = (b + EXPOSURE_OFFSET) / self.gain
        return -np.where(b < dark * steep, EXPOSURE_POWER * b / steep, bright)


def _two_lines(
    rgb: np.ndarray, alpha: np.ndarray | float, edge: Any, below: Any, above: Any, offset: Any
) -> np.ndarray:
    """Values [..., 3] below `alpha` `edge` times `below`, others times `above` plus `alpha`
    `offset`; the last four [3]."""
    edge, below, above, offset = (np.asarray(a, rgb.dtype) for a in (edge, below, above, offset))
    return np.where(rgb < alpha * edge, rgb * below, rgb * above + alpha * offset)


NEUTRAL = PhotoExposure.of(None)
"""The mean exposure of a training."""
