"""Viewport text over a 3D view, with a shadow; pixels of the drawn region."""

import blf

SIZE = 11.0
"""Font size in pixels at interface scale 1."""
_FONT = 0


def width_of(text: str, scale: float) -> float:
    """Width of a text at an interface scale, pixels."""
    blf.size(_FONT, SIZE * scale)
    return blf.dimensions(_FONT, text)[0]


def write(
    text: str, x: float, y: float, scale: float, color: tuple[float, float, float, float]
) -> None:
    """Draw a text at a position."""
    blf.size(_FONT, SIZE * scale)
    blf.color(_FONT, *color)
    blf.enable(_FONT, blf.SHADOW)
    blf.shadow(_FONT, 3, 0.0, 0.0, 0.0, 0.8)
    blf.position(_FONT, x, y, 0)
    blf.draw(_FONT, text)
    blf.disable(_FONT, blf.SHADOW)
