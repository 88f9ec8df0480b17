"""How much detail the photos of a capture hold at each size."""

from collections.abc import Sequence

import numpy as np

from ..schedule.sizes import SIDES
from .views import Photos

_VIEWS = 12
"""Photos looked at, evenly spread."""
_SIDE = 1024
"""Sides of the middle part of a photo that is looked at, px, at most."""


def detail(photos: Photos, indices: Sequence[int]) -> tuple[float, ...]:
    """Share of the photos' detail that remains where their sides are multiplied by each of `SIDES`.

    Detail is the sum of the amplitudes of a photo's frequencies (after Chen et al. 2025,
    DashGaussian); a photo scaled down keeps those below its own Nyquist frequency. Of
    most photos amplitudes fall with the frequency, and the sum rises about with the side.

    Args:
        photos: The capture; masks are not looked at.
        indices: Views to choose from.

    Returns:
        A share for each of `SIDES`; of photos of one colour, the sides themselves.
    """
    within, whole = np.zeros(len(SIDES)), 0.0
    for index in list(indices)[:: -(-len(indices) // _VIEWS)]:
        amplitudes = np.abs(np.fft.fft2(_middle(photos.image(index))))
        rows, columns = (2 * np.abs(np.fft.fftfreq(n)) for n in amplitudes.shape)
        frequency = np.maximum(rows[:, None], columns)  # 1 is Nyquist's
        within += [amplitudes[frequency <= side].sum() for side in SIDES]
        whole += amplitudes.sum()
    # A flat photo has amplitudes that are rounding errors.
    found = within / whole if whole > 1e-6 else SIDES
    return tuple(float(share) for share in found)


def _middle(image: np.ndarray) -> np.ndarray:
    """Grey values of the middle, mean 0, that fade out towards its borders: Fourier's picture goes
    on beyond them from the other side, and a step there would count as detail."""
    top, left = (max(0, (n - _SIDE) // 2) for n in image.shape[:2])
    grey = image[top : top + _SIDE, left : left + _SIDE].mean(axis=2)
    rows, columns = (np.hanning(n + 2)[1:-1] for n in grey.shape)
    window = rows[:, None] * columns
    return (grey - (grey * window).sum() / window.sum()) * window
