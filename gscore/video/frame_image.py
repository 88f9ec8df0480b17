"""Frame image: a video frame as an upright photo with square pixels, 8-bit sRGB."""

from typing import Any

import numpy as np

from .source import VideoFacts
from .tone_mapping import to_screen

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
