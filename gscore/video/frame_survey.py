"""Frame survey: time, sharpness and camera motion of every frame of a video.

Displacements of blocks are found by phase correlation (Kuglin and Hines 1975) with a picture some
frames back, so that camera shake does not add up. A camera that circles a subject moves far with
little displacement, but the blocks become less similar, which lowers their peaks.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import Cancelled
from .source import Video

_SHARP_SIDE = 1280
"""Longer side in pixels at which sharpness is measured, fine enough for blur of a pixel."""
_REDUCED = 4
"""Downscaling of pictures that are compared for motion."""
_SIMILAR = 0.2
"""Mean pixel difference below which a frame is a repetition."""


@dataclass(frozen=True, kw_only=True)
class Survey:
    """Measurements of all n frames, in display order."""

    seconds: np.ndarray
    """[n] float64, time since the first frame."""
    travel: np.ndarray
    """[n] float64, camera motion since the first frame, in shares of the longer side; never
    decreases."""
    fine: np.ndarray
    """[n] float64, variance of the Laplacian at 1280 px."""
    coarse: np.ndarray
    """[n] float64, variance of the Laplacian at 320 px, which slight blur does not change."""
    repeated: np.ndarray
    """[n] bool, equal to the frame before."""


def survey(
    video: Video, *, on_frame: Callable[[int], None], cancelled: Callable[[], bool]
) -> Survey:
    """Measure every frame in one pass; memory grows by only 33 bytes per frame.

    Args:
        video: The video; its frames are consumed.
        on_frame: Receives the number of frames done.
        cancelled: Called at every frame; True stops the call.

    Raises:
        Cancelled: `cancelled` returned True.
    """
    size = _look_size(video.facts.width, video.facts.height)
    travel = AccumulatedMotion(size[0] // _REDUCED, size[1] // _REDUCED)
    rows: list[tuple[float, float, float, float, bool]] = []
    before: np.ndarray | None = None
    for count, frame in enumerate(video.frames(), 1):
        if cancelled():
            raise Cancelled("Analysing the video was stopped.")
        grey = _grey(frame, size)
        small = _reduced(grey)
        repeated = before is not None and _similar(grey, before)
        # Repeated frames are skipped, because their reference would be compared with itself.
        way = travel.total if repeated else travel.add(small)
        rows.append((_seconds(frame, count), way, _edges(grey), _edges(small), repeated))
        before = grey
        on_frame(count)
    seconds, ways, fine, coarse, repeated_rows = (np.array(c) for c in zip(*rows, strict=True))
    return Survey(
        seconds=_continuous(seconds),
        travel=np.maximum.accumulate(ways),
        fine=fine,
        coarse=coarse,
        repeated=repeated_rows.astype(bool),
    )


def _continuous(seconds: np.ndarray) -> np.ndarray:
    """[n] times from 0, ascending. Joined recordings restart the time; there the median frame
    interval is used."""
    steps = np.diff(seconds)
    if (steps >= 0).all():
        return seconds - seconds[0]
    forward = steps[steps > 0]
    steps[steps < 0] = np.median(forward) if len(forward) else 0.0
    return np.concatenate([[0.0], np.cumsum(steps)])


def _seconds(frame: Any, count: int) -> float:
    return float(frame.time) if frame.time is not None else (count - 1) / 30


def _look_size(width: int, height: int) -> tuple[int, int]:
    """Size for measurements: longer side at most 1280 px, both a multiple of 4 and at least 256."""
    scale = min(1.0, _SHARP_SIDE / max(width, height))
    least = BLOCK_SIDE * _REDUCED
    wide, high = (
        max(round(side * scale) // _REDUCED * _REDUCED, least) for side in (width, height)
    )
    return wide, high


def _grey(frame: Any, size: tuple[int, int]) -> np.ndarray:
    """Grey frame [h, w] uint8, downscaled to `size` (width, height)."""
    from av.video.reformatter import Interpolation

    made = frame.reformat(
        width=size[0], height=size[1], format="gray", interpolation=Interpolation.AREA
    )
    return made.to_ndarray()


def _reduced(grey: np.ndarray) -> np.ndarray:
    """Means of 4 x 4 pixels."""
    rows = grey.reshape(grey.shape[0] // _REDUCED, _REDUCED, grey.shape[1])
    lines = rows.sum(axis=1, dtype=np.uint16)
    blocks = lines.reshape(lines.shape[0], -1, _REDUCED).sum(axis=2, dtype=np.uint16)
    return (blocks >> 4).astype(np.uint8)


def _edges(grey: np.ndarray) -> float:
    """Variance of the Laplacian (Pech-Pacheco et al. 2000)."""
    values = grey.astype(np.int16)
    middle = values[1:-1, 1:-1] * np.int16(4)
    middle -= values[:-2, 1:-1]
    middle -= values[2:, 1:-1]
    middle -= values[1:-1, :-2]
    middle -= values[1:-1, 2:]
    flat = middle.ravel().astype(np.float32)
    return float(flat @ flat / flat.size - flat.mean() ** 2)


def _similar(grey: np.ndarray, before: np.ndarray) -> bool:
    far = np.maximum(grey, before) - np.minimum(grey, before)
    return float(far.mean()) < _SIMILAR


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
