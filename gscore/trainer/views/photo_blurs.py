"""Photo blurs: the blur of each training photo beyond the usual one, measured with the model.

Photos of a moving camera are blurred, each by another amount. Splats that match all of them are
soft; if the render of a blurred photo is blurred as the photo is, they stay sharp. The blur of a
photo is a Gaussian, whose covariance is fitted to the sharp render of its view. What all photos
have in common is part of the scene, so the median over the photos is subtracted.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch

from ...engine.base import Color
from ...events import Decision
from ...quoting import first_few
from ...raster.blur import blur_image
from ...shared_constants import BLUR_MAX
from ...text_format import count_text
from ..model.checkpoint_schema import as_int
from .photo_adam import checked_array

_NAME = "blur"
"""Prefix of the arrays in checkpoints."""
_FEWEST = 8
"""Photos from which the usual one is known."""
_LEAST = 1.0
"""Standard deviation of the least blur that is used, px at the size of the step. Less costs more
PSNR than it gains: sharp photos measure up to 0.8 px apart."""
_SURE, _LIKELY = 0.08, 0.02
"""Shares of the squared differences of photo and sharp render that a blur explains: from the first
on it is used, below the second of all photos there are no further measures. Sharp photos have up
to 0.05."""
_WIDEST = 0.05
"""Longest standard deviation, in longer sides of the picture. Beyond, the photo is no blurred view
of the scene: its camera is wrong, or the render is empty."""
_ITERATIONS = 12
"""Most Gauss-Newton iterations of a fit."""
_PRECISE = 0.05
"""Change of the covariance at which a fit ends, relative, and in px^2 below 1 px^2."""
_WRONG = 0.1
"""Difference of photo and render at which a pixel has half the weight: it shows something else."""
_NAMED = 8
"""Photos that the decision names."""
_INNER = slice(1, -1)
"""Pixels with neighbours on both sides."""


class BlurFit(NamedTuple):
    """Blur of a photo relative to the sharp render of its view."""

    covariance: np.ndarray
    """[3] float64: xx, xy, yy of the Gaussian; to first order if it explains little, and negative
    if the photo is the sharper one."""
    explained: float
    """Share of the squared differences that the blur explains; 0 for a sharper photo."""


class PhotoBlurs:
    """Blurs of the training photos; 0 until they are measured, and of held-out photos."""

    def __init__(self, train: Sequence[int], sides: np.ndarray) -> None:
        """Create the blurs of views `train`; `sides` [V]: longer sides of all photos, px."""
        self.train = list(train)
        self._sides = sides
        self._value = np.zeros((len(sides), 3))
        """xx, xy, yy in squares of the longer side."""
        self._last = 0
        """Step after which the blurs were measured; 0: they were not."""
        self._likely = False
        """Whether any photo may have been blurred."""

    @property
    def blurred(self) -> dict[int, float]:
        """Standard deviations along the longer axis, px at full size, of the photos whose blur is
        used there."""
        found = {i: float(np.sqrt(_largest(self._value[i])) * self._sides[i]) for i in self.train}
        return {index: deviation for index, deviation in found.items() if deviation >= _LEAST}

    def of(self, index: int, side: int) -> Color | None:
        """Covariance xx, xy, yy, px^2, of the blur of photo `index` with this longer side; None:
        sharp."""
        covariance = self._value[index] * side**2
        if _largest(covariance) < _LEAST**2:
            return None
        xx, xy, yy = _limited(covariance, BLUR_MAX).tolist()
        return (xx, xy, yy)

    def due(self, planned: Sequence[int], step: int) -> bool:
        """Return whether to measure the photos after `step`, by the steps planned for that."""
        if len(self.train) < _FEWEST or not any(self._last < one <= step for one in planned):
            return False
        return self._likely or self._last < planned[0]

    def note(self, found: Mapping[int, BlurFit], step: int) -> None:
        """Replace the blurs by those measured after `step`, of each training photo, in squares of
        its longer side."""
        usual = np.median([fit.covariance for fit in found.values()], axis=0)
        for index, fit in found.items():
            is_sure = fit.explained > _SURE
            self._value[index] = _positive(fit.covariance - usual) if is_sure else 0.0
        self._likely = any(fit.explained > _LIKELY for fit in found.values())
        self._last = step

    def decision(self, names: Sequence[str]) -> Decision | None:
        """Sentences on the photos that are blurred; None: there are none."""
        blurred = self.blurred
        if not blurred:
            return None
        order = sorted(blurred, key=blurred.__getitem__, reverse=True)
        named = first_few([names[i] for i in order], _NAMED)
        are = count_text(len(blurred), "training photo is", "training photos are")
        return Decision(
            "blur",
            f"{are} more blurred than the others, by up to {blurred[order[0]]:.1f} of "
            f"{self._sides[order[0]]} px (standard deviation): {named}. Renders of them are "
            "blurred alike, so that splats stay sharp. `--no-photo-blur` compares sharp renders "
            "with them.",
        )

    def arrays(self) -> dict[str, np.ndarray]:
        """State by name; no copies."""
        if not self._last:
            return {}
        facts = np.array([self._last, self._likely], np.int64)
        return {f"{_NAME}/value": self._value, f"{_NAME}/facts": facts}

    def restore(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restore the state that `arrays` returned.

        Raises:
            ValueError, KeyError: the arrays are invalid.
        """
        self._value, self._last, self._likely = np.zeros_like(self._value), 0, False
        name = f"{_NAME}/value"
        if name not in arrays:
            return
        value = checked_array(name, arrays, self._value.shape)
        apart = [np.abs(row - _positive(row)).max() > 1e-9 + 1e-6 * row.max() for row in value]
        facts = arrays[f"{_NAME}/facts"].tolist()
        if any(apart) or not isinstance(facts, list) or len(facts) != 2:
            raise ValueError(f"{name} has a covariance that is not one, or there are other facts")
        self._value, self._likely = value, facts[1] == 1
        self._last = as_int(f"{_NAME}/facts", facts[0], low=1)


@np.errstate(over="ignore", invalid="ignore")  # of renders that are not finite
def fit_blur(
    render: np.ndarray, photo: np.ndarray, mask: np.ndarray | None, *, threads: int = 0
) -> BlurFit:
    """Fit the Gaussian that makes a sharp render as blurred as its photo.

    Gauss-Newton on the squared differences; the derivative of a blurred picture in the covariance
    is half of its second derivatives (the heat equation). Pixels that differ much count little.

    Args:
        render: [H, W, 3] float32.
        photo: [H, W, 3] float, 0 to 1.
        mask: [H, W] uint8, weight of each pixel, 255 = 1; None: 1 everywhere.
        threads: 0: all cores.
    """
    target = photo[_INNER, _INNER].astype(np.float32)
    far = np.abs(target - render[_INNER, _INNER]).mean(axis=-1, keepdims=True) / _WRONG
    weight = 1 / (1 + far**2)
    if mask is not None:
        weight *= mask[_INNER, _INNER, None] / np.float32(255)
    most = (max(render.shape[:2]) * _WIDEST) ** 2
    first = _gauss_newton_step(render, target, weight)
    if not (np.isfinite(first.step).all() and first.error > 0):
        return BlurFit(np.zeros(3), 0.0)
    explained = first.gain / first.error if first.step[0] + first.step[2] > 0 else 0.0
    if explained < _LIKELY / 2:
        return BlurFit(np.clip(first.step, -most, most), explained)
    found, now = np.zeros(3), first
    for _ in range(_ITERATIONS):
        size = max(found[0] + found[2], 1.0)
        found = _limited(_positive(found + np.clip(now.step, -size, size)), most)
        blurred = blur_image(torch.from_numpy(render), found.tolist(), threads=threads)
        now = _gauss_newton_step(blurred.numpy(), target, weight)
        if np.abs(now.step).max() < _PRECISE * size:
            break
    if _largest(found) > 0.99 * most:
        return BlurFit(np.zeros(3), 0.0)
    return BlurFit(found, 1 - now.error / first.error)


class _Step(NamedTuple):
    """Step of Gauss and Newton."""

    step: np.ndarray
    """[3] change of the covariance."""
    gain: float
    """Decrease of the error by this step, to first order."""
    error: float
    """Sum of the squared differences before it."""


def _gauss_newton_step(render: np.ndarray, target: np.ndarray, weight: np.ndarray) -> _Step:
    """Change of the covariance by which `render` comes closest to `target`, to first order."""
    centre = render[_INNER, _INNER]
    wrong = target - centre
    slopes = [
        (render[_INNER, 2:] - 2 * centre + render[_INNER, :-2]) / 2,
        (render[2:, 2:] - render[2:, :-2] - render[:-2, 2:] + render[:-2, :-2]) / 4,
        (render[2:, _INNER] - 2 * centre + render[:-2, _INNER]) / 2,
    ]
    weighted = [weight * slope for slope in slopes]
    matrix = np.array([[_dot(a, b) for b in slopes] for a in weighted])
    right = np.array([_dot(a, wrong) for a in weighted])
    ridge = 1e-6 * np.trace(matrix) + 1e-12  # flat pictures have no blur
    step = np.linalg.solve(matrix + ridge * np.eye(3), right)
    return _Step(step, float(step @ right), _dot(weight * wrong, wrong))


def _dot(a: np.ndarray, b: np.ndarray) -> float:
    """Sum of products; not by BLAS, whose bits differ between processors."""
    return float(np.einsum("yxc,yxc->y", a, b).sum(dtype=np.float64))


def _positive(covariance: np.ndarray) -> np.ndarray:
    """The nearest positive semidefinite covariance."""
    xx, xy, yy = covariance
    values, vectors = np.linalg.eigh([[xx, xy], [xy, yy]])
    (xx, xy), (_, yy) = (vectors * np.maximum(values, 0)) @ vectors.T
    return np.array([xx, xy, yy])


def _largest(covariance: np.ndarray) -> float:
    """Variance along the longer axis."""
    xx, xy, yy = covariance
    return float((xx + yy) / 2 + np.hypot((xx - yy) / 2, xy))


def _limited(covariance: np.ndarray, most: float) -> np.ndarray:
    """The covariance, scaled down to at most this variance along the longer axis."""
    return covariance * (most / max(_largest(covariance), most))
