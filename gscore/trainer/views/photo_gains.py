"""Photo gains: exposure and white balance of each photo as optimised factors by channel.

The rendered image times the photo's gain is compared with the photo. Values are encoded (sRGB),
where a change of exposure by s stops is a gain of about 2^(s / 2.2), and white balance a gain by
channel. A gain is stored as three coefficients of `_BASIS`, so that Adam changes the exposure, the
largest difference between photos, along one axis.
"""

import math
from collections.abc import Sequence

import numpy as np
import torch

from ...engine.base import Color
from .photo_adam import PhotoAdam, checked_tensor

STOP = math.log(2.0) / 2.2
"""ln of the gain of one stop, in encoded values."""
_BASIS = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, -1.0], [-0.5, 1.0, -0.5]])
"""Rows: ln gain of R, G and B by exposure, by warmth and by green; orthogonal."""
_NAME = "gain"
"""Prefix of the tensors in checkpoints."""


class PhotoGains:
    """Gains of the training photos; those of held-out photos are predicted, see `HeldOutGains`.

    Their geometric mean over the training photos is one after every step: otherwise splats could
    become darker and all gains larger, and the exposure of new views would be undefined.
    """

    def __init__(self, train: Sequence[int], log_gains: np.ndarray) -> None:
        """`log_gains`, [V, 3] float64: initial ln gain of R, G, B of all views; only those of
        `train` are used."""
        self.train = list(train)
        """Training views."""
        self._trained = frozenset(train)
        self._value = np.zeros_like(log_gains)
        self._value[self.train] = log_gains[self.train] @ np.linalg.inv(_BASIS)
        self._adam = PhotoAdam(len(log_gains), 3)
        self._centre()

    def __contains__(self, index: int) -> bool:
        """Return whether view `index` is a training view."""
        return index in self._trained

    @property
    def log_gains(self) -> np.ndarray:
        """[V, 3] float64: ln gain of R, G, B of each view."""
        return self._value @ _BASIS

    def of(self, index: int) -> torch.Tensor:
        """Gain of training view `index`, [3] float32."""
        return torch.from_numpy(np.exp(self._value[index] @ _BASIS).astype(np.float32))

    def learn(self, index: int, v_log_gain: Sequence[float], rate: float) -> None:
        """Adam step for the gain of one photo; then all gains are centred.

        Args:
            index: Training view.
            v_log_gain: Derivative of the loss in ln gain of R, G, B; skipped unless finite.
            rate: Learning rate.
        """
        grad = _BASIS @ np.asarray(v_log_gain, np.float64)
        if np.isfinite(grad).all():
            self._value[index] += self._adam.step(index, grad, rate)
            self._centre()

    def tensors(self) -> dict[str, torch.Tensor]:
        """State tensors by name; no copies."""
        return {f"{_NAME}/value": torch.from_numpy(self._value)} | self._adam.tensors(_NAME)

    @staticmethod
    def are_in(tensors: dict[str, torch.Tensor]) -> bool:
        """Return whether a checkpoint has gains."""
        return f"{_NAME}/value" in tensors

    @classmethod
    def restored(
        cls, train: Sequence[int], views: int, tensors: dict[str, torch.Tensor]
    ) -> "PhotoGains":
        """Restore the gains of `views` photos from the tensors of a checkpoint.

        Raises:
            ValueError, KeyError: the tensors are invalid.
        """
        out = cls(train, np.zeros((views, 3)))
        out._value = checked_tensor(f"{_NAME}/value", tensors, (views, 3))
        out._adam.restore(_NAME, tensors)
        return out

    def _centre(self) -> None:
        self._value[self.train] -= self._value[self.train].mean(axis=0)


def as_color(gain: torch.Tensor) -> Color:
    """A gain [3] as numbers."""
    r, g, b = gain.tolist()
    return (r, g, b)


def background_before_gain(background: Color, gain: torch.Tensor) -> Color:
    """Return the colour that equals `background` after multiplication by a gain [3].

    For photos composited over a background, whose colour does not depend on the exposure: splats
    are rendered over this colour instead.
    """
    r, g, b = (colour / by for colour, by in zip(background, gain.tolist(), strict=True))
    return (r, g, b)
