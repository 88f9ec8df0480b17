"""How far a camera has gone since the beginning of a video, as its pictures move.

Displacements of blocks are found by phase correlation (Kuglin and Hines 1975) with a picture some
frames back, so that the trembling of a hand does not add up.
"""

from dataclasses import dataclass, replace

import numpy as np

BLOCK_SIDE = 64
"""Pixels of a block."""
_STEP = 0.05
"""Of the longer side: the displacement after which a new picture is compared with."""
_TRUSTED = 0.25
"""Least height of a block's peak; 1 for equal pictures, up to 0.22 for unrelated ones."""
_ENOUGH = 0.25
"""Share of the blocks with texture that must be trusted."""
_TEXTURE = 3.0
"""Standard deviation of a block that has some; less is noise."""
_FINEST = 0.30
"""Cycles a pixel beyond which blurred pictures have nothing to compare."""
_LOST = 0.05
"""Of the longer side, taken where pictures cannot be compared: they have moved far, or are new."""
_NOISE = 2300.0
"""Squared strength of a frequency of a block in which noise deviates by two grey values."""
_STILL = 0.6
"""Pixels: less is noise."""


@dataclass(frozen=True)
class _Picture:
    spectra: np.ndarray
    """[blocks, 64, 33] complex64."""
    textured: np.ndarray
    """[blocks] bool."""
    travel: float = 0.0


class Travel:
    """The way so far, in shares of the longer side of the picture."""

    def __init__(self, width: int, height: int) -> None:
        """Begin with pictures of this size; both sides at least 64."""
        self._corners = _corners(width, height)
        self._longer = max(width, height)
        window = np.hanning(BLOCK_SIDE + 2)[1:-1].astype(np.float32)
        self._window = window[:, None] * window
        fy, fx = np.fft.fftfreq(BLOCK_SIDE)[:, None], np.fft.rfftfreq(BLOCK_SIDE)
        weight = np.exp(-((fx**2 + fy**2) / _FINEST**2) * 2)
        weight[0, 0] = 0
        self._weight = weight.astype(np.float32)
        self._twice = np.full(weight.shape, 2, np.float32)
        self._twice[:, [0, -1]] = 1  # the other columns stand for two halves of the spectrum
        self._reference: _Picture | None = None
        self._before: _Picture | None = None
        self.so_far = 0.0
        """Of the last picture; never falls."""

    def add(self, grey: np.ndarray) -> float:
        """Go on with the next picture; the way up to it.

        Args:
            grey: [H, W] uint8.
        """
        picture = self._picture(grey)
        if self._reference is None or self._before is None:
            self._reference = self._before = picture
            return 0.0
        base, moved = self._reference, self._moved(self._reference, picture)
        if moved is None:
            base, moved = self._before, self._moved(self._before, picture)
        followed = moved is not None and base is self._reference and moved <= _STEP
        self.so_far = max(base.travel + (_LOST if moved is None else moved), self.so_far)
        self._before = replace(picture, travel=self.so_far)
        if not followed:
            self._reference = self._before
        return self.so_far

    def _picture(self, grey: np.ndarray) -> _Picture:
        blocks = np.stack([grey[y : y + BLOCK_SIDE, x : x + BLOCK_SIDE] for x, y in self._corners])
        blocks = blocks.astype(np.float32)
        blocks -= blocks.mean(axis=(1, 2), keepdims=True)
        return _Picture(
            spectra=np.fft.rfft2(blocks * self._window).astype(np.complex64),
            textured=blocks.std(axis=(1, 2)) > _TEXTURE,
        )

    def _moved(self, before: _Picture, after: _Picture) -> float | None:
        """Mean displacement of the trusted blocks, in shares; None: too few are."""
        textured = before.textured | after.textured
        if not textured.any():
            return 0.0
        one, other = before.spectra[textured], after.spectra[textured]
        cross = other * one.conj()
        strength = np.abs(cross)
        # Only frequencies above the noise have a phase worth comparing.
        cross *= self._weight / (strength + _NOISE)
        whole = (self._weight * self._twice * strength / (strength + _NOISE)).sum(axis=(1, 2))
        peaks = np.fft.irfft2(cross, s=(BLOCK_SIDE, BLOCK_SIDE)).reshape(len(one), -1)
        peaks *= (BLOCK_SIDE * BLOCK_SIDE / whole)[:, None]
        places = peaks.argmax(axis=1)
        trusted = peaks[np.arange(len(one)), places] > _TRUSTED
        if trusted.mean() < _ENOUGH:
            return None
        y, x = np.divmod(places[trusted], BLOCK_SIDE)
        y, x = (np.where(v > BLOCK_SIDE // 2, v - BLOCK_SIDE, v) for v in (y, x))
        far = float(np.hypot(x, y).mean())
        return far / self._longer if far >= _STILL else 0.0


def _corners(width: int, height: int) -> list[tuple[int, int]]:
    """Upper left corners of the blocks, spread over the picture."""
    xs, ys = (
        np.linspace(0, side - BLOCK_SIDE, max(1, round(side / BLOCK_SIDE))).round().astype(int)
        for side in (width, height)
    )
    return [(int(x), int(y)) for y in ys for x in xs]
