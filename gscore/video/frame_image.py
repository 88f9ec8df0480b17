"""Frame image: a video frame as an upright photo with square pixels, 8-bit sRGB, from HDR too."""

import functools
from typing import Any

import numpy as np

from .source import VideoFacts

_UNSPECIFIED = 2
"""Code of H.273: no colour matrix is stated."""
_HD = 720
"""Lines from which such video is BT.709, as players assume."""


def upright_rgb(frame: Any, facts: VideoFacts) -> np.ndarray:
    """Frame as [H, W, 3] uint8 sRGB, as a player shows it.

    HDR is tone-mapped by `to_screen`; 10-bit SDR is rounded.

    Args:
        frame: av.VideoFrame.
        facts: Facts of its video.
    """
    from av.video.reformatter import Colorspace, Interpolation

    # Colours are stored at half the resolution; the flags interpolate and round them accurately.
    how = Interpolation.BICUBIC | Interpolation.FULL_CHR_H_INT | Interpolation.ACCURATE_RND
    width, height = square_size(frame.width, frame.height, facts.aspect)
    matrix = None
    if frame.colorspace == _UNSPECIFIED:
        matrix = Colorspace.ITU709 if frame.height >= _HD else Colorspace.ITU601
    made = frame.reformat(
        width=width,
        height=height,
        format="rgb48le" if facts.hdr else "rgb24",
        src_colorspace=matrix,
        interpolation=how,
    ).to_ndarray()
    pixels = to_screen(made, facts.hdr, wide=frame.color_primaries == 9) if facts.hdr else made
    return np.ascontiguousarray(_turned(pixels, *facts.orientation))


def _turned(pixels: np.ndarray, a: int, b: int, c: int, d: int) -> np.ndarray:
    """[H, W, 3] or [W, H, 3], rotated and mirrored by `VideoFacts.orientation`."""
    if b:
        pixels = pixels.transpose(1, 0, 2)
    across, down = a + c, b + d
    return pixels[::down, ::across]


def square_size(width: int, height: int, aspect: float) -> tuple[int, int]:
    """Width and height with square pixels; one side grows, so that no detail is lost."""
    if 0.999 < aspect < 1.001 or not 0.05 < aspect < 20:
        return width, height
    if aspect > 1:
        return round(width * aspect), height
    return width, round(height / aspect)


_WHITE = 203.0
"""Reference (paper) white in HDR, cd/m2."""
_PEAK = 1000.0
"""Peak luminance of the display for HLG, cd/m2."""
_SHOULDER = 0.75
"""Largest value that is not compressed, share of the display range."""
_HEADROOM = 4.0
"""Value that is mapped to the end of the display range, in display whites."""
_TO_BT709 = np.array(
    [
        [1.660491, -0.587641, -0.072850],
        [-0.124550, 1.132900, -0.008349],
        [-0.018151, -0.100579, 1.118730],
    ],
    np.float32,
)
_BT2020_LUMA = np.array([0.2627, 0.6780, 0.0593], np.float32)
_STEPS = 4096
"""Entries of the encoding table; 16 for each of the 256 values."""


def to_screen(pixels: np.ndarray, kind: str, *, wide: bool) -> np.ndarray:
    """Tone-map HDR pixels to [H, W, 3] uint8 sRGB.

    Reference white becomes 0.9 of display white. Three quarters of the range keep their contrast,
    brighter values are compressed, by the brightest channel so that hues stay.

    Args:
        pixels: [H, W, 3] uint16, RGB with the transfer function of `kind`, of full range.
        kind: `HDR (PQ)` or `HDR (HLG)`.
        wide: Whether the primaries are BT.2020's; else BT.709's.
    """
    light = np.take(_decode_table(kind), pixels)
    if "HLG" in kind:
        # The display's OOTF, gamma 1.2 on luminance at 1000 cd/m2.
        luma = light @ _BT2020_LUMA
        light *= (np.maximum(luma, 1e-6) ** 0.2)[..., None] * np.float32(_PEAK / _WHITE)
    if wide:
        light = light @ _TO_BT709.T
    light = np.maximum(light, 0) * np.float32(0.9)
    bright = light.max(axis=2)
    light *= (_compressed(bright) / np.maximum(bright, 1e-6))[..., None]
    index = np.sqrt(np.clip(light, 0, 1)) * (_STEPS - 1) + 0.5
    return np.take(_encode_table(), index.astype(np.int32))


def _compressed(bright: np.ndarray) -> np.ndarray:
    """Identity up to the shoulder, then a curve of equal slope that reaches 1 at the headroom."""
    room = np.float32(1 - _SHOULDER)
    over = np.maximum(bright - np.float32(_SHOULDER), 0) / room
    most = (_HEADROOM - _SHOULDER) / room
    curve = over * (1 + over / np.float32(most**2)) / (1 + over)  # Reinhard et al. 2002, eq. 4
    return np.where(bright > _SHOULDER, _SHOULDER + room * np.minimum(curve, 1), bright)


@functools.cache
def _decode_table(kind: str) -> np.ndarray:
    """[65536] float32: linear light of a 16-bit value; display light in units of reference white
    for PQ, scene light for HLG."""
    value = np.arange(65536, dtype=np.float64) / 65535
    if "PQ" in kind:
        m1, m2, c1, c2, c3 = 0.1593017578125, 78.84375, 0.8359375, 18.8515625, 18.6875
        root = value ** (1 / m2)
        light = (np.maximum(root - c1, 0) / (c2 - c3 * root)) ** (1 / m1) * 10000 / _WHITE
    else:
        a, b, c = 0.17883277, 0.28466892, 0.55991073
        light = np.where(value <= 0.5, value**2 / 3, (np.exp((value - c) / a) + b) / 12)
    return light.astype(np.float32)


@functools.cache
def _encode_table() -> np.ndarray:
    """[4096] uint8 sRGB by the square root of linear light."""
    light = (np.arange(_STEPS) / (_STEPS - 1)) ** 2
    code = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.rint(code * 255).astype(np.uint8)
