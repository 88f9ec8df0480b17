"""How each photo was exposed: gains by channel that are learnt beside the splats.

A neutral picture times its photo's gain is what is compared with the photo. Values are encoded
(sRGB), where a change of exposure by s stops is a gain of about 2^(s / 2.2), and white balance a
gain by channel. A gain is kept as three numbers, see `_BASIS`: Adam then moves the exposure of a
photo, the one thing that differs most, along one axis.
"""

from collections.abc import Sequence

import numpy as np
import torch

from ..rows.stored import whole

Color = tuple[float, float, float]

_BASIS = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, -1.0], [-0.5, 1.0, -0.5]])
"""Rows: ln gain of R, G and B by exposure, by warmth and by green; orthogonal."""
_BETAS, _EPS = (0.9, 0.999), 1e-15
_KEYS = ("value", "moment1", "moment2")


def gain_rate_at(first: float, last: float, step: int, iterations: int) -> float:
    """Learning rate at `step`: from the first to the last, exponentially; 0 where one is 0."""
    if first <= 0 or last <= 0:
        return 0.0
    return first * (last / first) ** min(step / iterations, 1.0)


class PhotoGains:
    """The gains of the training photos; held-out photos keep a gain of one.

    Their geometric mean over the training photos is one after every step: else the splats could
    become darker and all gains larger, and new views would have no exposure of their own.
    """

    def __init__(self, train: Sequence[int], log_gains: np.ndarray) -> None:
        """Begin with `log_gains`, [V, 3] float64: ln gain of R, G, B of all views; those of `train`
        are learnt, the others not used."""
        self._train = list(train)
        values = np.zeros_like(log_gains)
        values[self._train] = log_gains[self._train] @ np.linalg.inv(_BASIS)
        self._state = {key: np.zeros_like(values) for key in _KEYS}
        self._state["value"] = values
        self._steps = np.zeros(len(values), np.int64)
        self._centre()

    @property
    def log_gains(self) -> np.ndarray:
        """[V, 3] float64: ln gain of R, G, B of each view."""
        return self._state["value"] @ _BASIS

    def of(self, index: int) -> torch.Tensor:
        """[3] float32: the gain of view `index`."""
        return torch.from_numpy(np.exp(self._state["value"][index] @ _BASIS).astype(np.float32))

    def learn(self, index: int, v_log_gain: Sequence[float], rate: float) -> None:
        """A step of Adam (Kingma and Ba 2015) for the gain of one photo; then all are centred.

        Args:
            index: Of a training view.
            v_log_gain: Derivative of the loss in ln gain of R, G, B; not learnt from unless finite.
            rate: Learning rate.
        """
        grad = _BASIS @ np.asarray(v_log_gain, np.float64)
        if not np.isfinite(grad).all():
            return
        self._steps[index] += 1
        moments = []
        for key, beta, sample in zip(_KEYS[1:], _BETAS, (grad, grad * grad), strict=True):
            kept = self._state[key][index]
            kept += (1 - beta) * (sample - kept)
            moments.append(kept / (1 - beta ** int(self._steps[index])))
        self._state["value"][index] -= rate * moments[0] / (np.sqrt(moments[1]) + _EPS)
        self._centre()

    def tensors(self) -> dict[str, torch.Tensor]:
        """All that the next step depends on, by name; no copies."""
        found = {f"gain/{key}": torch.from_numpy(self._state[key]) for key in _KEYS}
        return found | {"gain/steps": torch.from_numpy(self._steps)}

    @staticmethod
    def are_in(tensors: dict[str, torch.Tensor]) -> bool:
        """Whether a checkpoint has gains."""
        return "gain/value" in tensors

    @classmethod
    def restored(
        cls, train: Sequence[int], views: int, tensors: dict[str, torch.Tensor]
    ) -> "PhotoGains":
        """Those that `tensors` returned, of so many views.

        Raises:
            ValueError, KeyError: they are not what that returns.
        """
        out = cls(train, np.zeros((views, 3)))
        for key in _KEYS:
            found = tensors[f"gain/{key}"].numpy()
            if found.shape != (views, 3) or found.dtype != np.float64:
                raise ValueError(f"gain/{key} is {found.dtype} {found.shape}")
            if not np.isfinite(found).all():
                raise ValueError(f"gain/{key} is not finite")
            out._state[key] = found.copy()
        steps = tensors["gain/steps"].tolist()
        if len(steps) != views:
            raise ValueError(f"gain/steps has {len(steps)} entries")
        out._steps = np.array([whole("gain/steps", count) for count in steps], np.int64)
        return out

    def _centre(self) -> None:
        value = self._state["value"]
        value[self._train] -= value[self._train].mean(axis=0)


def behind(background: Color, gain: torch.Tensor) -> Color:
    """The colour that looks like `background` once it is multiplied by a gain [3].

    Where photos are laid over a background (`composite`), their exposure is not its own: splats are
    drawn over this colour instead.
    """
    r, g, b = (colour / by for colour, by in zip(background, gain.tolist(), strict=True))
    return (r, g, b)


def without_background(
    v_log_gain: Color,
    background: Color,
    gain: torch.Tensor,
    v_rgb: torch.Tensor,
    alpha: torch.Tensor,
) -> Color:
    """The derivative in ln gain where `behind` moves with the gain, so that what shows of the
    background stays as it is.

    Args:
        v_log_gain: The derivative for a colour behind the splats that stays.
        background: The colour that shows.
        gain: [3].
        v_rgb: [H, W, 3] gradient in the neutral picture.
        alpha: [H, W] opacity of the picture.
    """
    if not any(background):
        return v_log_gain
    through = torch.mv(v_rgb.reshape(-1, 3).t(), (1 - alpha).flatten()).tolist()
    parts = zip(v_log_gain, through, background, gain.tolist(), strict=True)
    r, g, b = (whole - t * colour / by for whole, t, colour, by in parts)
    return (r, g, b)
