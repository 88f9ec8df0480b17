"""Camera motion since the start of a video, from the motion and change of its frames.

Displacements of blocks are found by phase correlation (Kuglin and Hines 1975) with a picture some
frames back, so that camera shake does not add up. A camera that circles a subject moves far with
little displacement, but the blocks become less similar, which lowers their peaks.
"""

from dataclasses import dataclass, replace

import numpy as np

BLOCK_SIDE = 64
"""Side of a block, pixels."""
_STEP = 0.05
"""Displacement after which the reference picture is replaced, share of the longer side."""
_TRUSTED = 0.25
"""Least height of a block's peak; 1 for equal pictures, up to 0.22 for unrelated ones."""
_ENOUGH = 0.25
"""Share of the blocks with texture that must be trusted."""
_SLACK = 0.05
"""Variation of peak heights between pictures of the same view."""
_TURN = 0.15
"""Motion for completely dissimilar blocks, share of the longer side. A sixth of a right angle
around a person is then 5 %, as much as it displaces a wall."""
_TEXTURE = 3.0
"""Least standard deviation of a textured block; less is noise."""
_FINEST = 0.30
"""Highest frequency that blurred pictures have in common, cycles per pixel."""
_LOST = 0.05
"""Motion assumed for pictures that cannot be compared, share of the longer side."""
_NOISE = 2300.0
"""Squared magnitude of a block's frequency for noise with a deviation of two grey values."""
_STILL = 0.6
"""Displacement below which it is noise, pixels."""


@dataclass(frozen=True)
class _Picture:
    spectra: np.ndarray
    """[blocks, 64, 33] complex64."""
    textured: np.ndarray
    """[blocks] bool."""
    travel: float = 0.0


@dataclass(frozen=True, kw_only=True)
class _Match:
    """Comparison of two pictures."""

    shift: float | None
    """Mean displacement of the trusted blocks, pixels; None: too few are."""
    height: float
    """Mean height of the peaks of all blocks with texture."""


class AccumulatedMotion:
    """Accumulated camera motion, in shares of the longer side of the picture."""

    def __init__(self, width: int, height: int) -> None:
        """Start a video with pictures of this size, px; both sides at least 64."""
        self._corners = _corners(width, height)
        self._longer = max(width, height)
        window = np.hanning(BLOCK_SIDE + 2)[1:-1].astype(np.float32)
        self._window = window[:, None] * window
        fy, fx = np.fft.fftfreq(BLOCK_SIDE)[:, None], np.fft.rfftfreq(BLOCK_SIDE)
        weight = np.exp(-((fx**2 + fy**2) / _FINEST**2) * 2)
        weight[0, 0] = 0
        self._weight = weight.astype(np.float32)
        self._twice = np.full(weight.shape, 2, np.float32)
        self._twice[:, [0, -1]] = 1  # the other columns count for both halves of the spectrum
        self._reference: _Picture | None = None
        self._before: _Picture | None = None
        self.total = 0.0
        """Motion up to the last picture; never decreases."""

    def add(self, grey: np.ndarray) -> float:
        """Add the next picture and return the motion up to it.

        Args:
            grey: [H, W] uint8.
        """
        picture = self._picture(grey)
        if self._reference is None or self._before is None:
            self._reference = self._before = picture
            return 0.0
        near = self._compare(self._before, picture)
        base, far = self._reference, self._compare(self._reference, picture)
        if far.shift is None:
            base, far = self._before, near
        moved = self._motion(far, near)
        followed = far.shift is not None and base is self._reference and moved <= _STEP
        self.total = max(base.travel + moved, self.total)
        self._before = replace(picture, travel=self.total)
        if not followed:
            self._reference = self._before
        return self.total

    def _picture(self, grey: np.ndarray) -> _Picture:
        blocks = np.stack([grey[y : y + BLOCK_SIDE, x : x + BLOCK_SIDE] for x, y in self._corners])
        blocks = blocks.astype(np.float32)
        blocks -= blocks.mean(axis=(1, 2), keepdims=True)
        return _Picture(
            spectra=np.fft.rfft2(blocks * self._window).astype(np.complex64),
            textured=blocks.std(axis=(1, 2)) > _TEXTURE,
        )

    def _motion(self, far: _Match, near: _Match) -> float:
        """Motion from the reference to a picture, in shares of the longer side.

        Args:
            far: Comparison with the reference.
            near: Comparison with the previous picture, which measures the effect of noise.
        """
        if far.shift is None:
            return _LOST
        turned = _TURN * max(near.height - far.height - _SLACK, 0.0)
        return max(far.shift / self._longer if far.shift >= _STILL else 0.0, turned)

    def _compare(self, before: _Picture, after: _Picture) -> _Match:
        textured = before.textured | after.textured
        if not textured.any():
            return _Match(shift=0.0, height=1.0)
        one, other = before.spectra[textured], after.spectra[textured]
        cross = other * one.conj()
        strength = np.abs(cross)
        # Only frequencies above the noise have a meaningful phase.
        cross *= self._weight / (strength + _NOISE)
        whole = (self._weight * self._twice * strength / (strength + _NOISE)).sum(axis=(1, 2))
        peaks = np.fft.irfft2(cross, s=(BLOCK_SIDE, BLOCK_SIDE)).reshape(len(one), -1)
        peaks *= (BLOCK_SIDE * BLOCK_SIDE / np.maximum(whole, 1e-9))[:, None]
        positions = peaks.argmax(axis=1)
        heights = peaks[np.arange(len(one)), positions]
        trusted = heights > _TRUSTED
        height = float(heights.mean())
        if trusted.mean() < _ENOUGH:
            return _Match(shift=None, height=height)
        y, x = np.divmod(positions[trusted], BLOCK_SIDE)
        y, x = (np.where(v > BLOCK_SIDE // 2, v - BLOCK_SIDE, v) for v in (y, x))
        return _Match(shift=float(np.hypot(x, y).mean()), height=height)


def _corners(width: int, height: int) -> list[tuple[int, int]]:
    """Upper left corners of the blocks, spread over the picture."""
    xs, ys = (
        np.linspace(0, side - BLOCK_SIDE, max(1, round(side / BLOCK_SIDE))).round().astype(int)
        for side in (width, height)
    )
    return [(int(x), int(y)) for y in ys for x in xs]
