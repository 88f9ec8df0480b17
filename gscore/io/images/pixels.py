"""Pixels as 8-bit arrays: of a picture in any Pillow mode, and of numbers."""

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FormatError

WITH_ALPHA = frozenset({"RGBA", "LA", "PA", "RGBa", "La"})
"""Pillow's modes with opacity."""
_DARKEST = 4096
"""Least maximum of a 16-bit picture; a darker one has unscaled values of 8 or 12 bits."""
_PIXELS_A_STRIP = 1 << 20
_WHITE_IS_ZERO, _PHOTOMETRIC = 0, 262


def as_uint8(values: np.ndarray) -> np.ndarray:
    """Numbers from 0 to 1, clamped, as 0 to 255 uint8."""
    return (np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8)


def has_alpha(image: Any) -> bool:
    """True if a picture (PIL.Image.Image) can be transparent."""
    return image.mode in WITH_ALPHA or "transparency" in image.info


def photo_bytes(path: Path, image: Any, *, deep: bool) -> np.ndarray:
    """A photo as bytes.

    Args:
        path: Its file, for messages.
        image: PIL.Image.Image, loaded.
        deep: Whether its file has 16 bits per channel, of which Pillow keeps 8 for colours.

    Returns:
        [H, W, 3] uint8, or [H, W, 4] with transparency, not premultiplied.

    Raises:
        FormatError: the value of white is unknown.
    """
    if image.mode[0] in "IF":
        values, white = _grey_numbers(path, image)
        grey = _scaled(path, values, white)
        channels = [grey] * 3
        if "transparency" in image.info:
            hidden = np.asarray(image) == image.info["transparency"]
            channels.append(np.where(hidden, 0, 255).astype(np.uint8))
        return np.stack(channels, axis=2)
    pixels = _converted(image, "RGBA" if has_alpha(image) else "RGB")
    if deep:
        _check_deep_colours(path, image, pixels)
    return pixels


def _converted(image: Any, mode: str) -> np.ndarray:
    """[H, W, 3 or 4] uint8 of a picture. Converted in strips, because at once it would take three
    more copies: Pillow's four bytes per pixel, and bytes on their way to numpy."""
    width, height = image.size
    out = np.empty((height, width, len(mode)), np.uint8)
    rows = max(1, _PIXELS_A_STRIP // width)
    for top in range(0, height, rows):
        strip = image.crop((0, top, width, min(top + rows, height)))
        out[top : top + rows] = np.asarray(strip.convert(mode))
    return out


def mask_bytes(path: Path, image: Any, *, deep: bool) -> tuple[np.ndarray, str]:
    """A mask as bytes, 255 = keep, and the assumption about its white value.

    The mask is the alpha channel if that varies, else the brightest channel. If the only values are
    0 and one other, the other is white: 1, 255, 65535, or the index or the colour of a label.

    Returns:
        [H, W] uint8, and the assumption as a part of a message; empty without one.

    Raises:
        FormatError: the value of white is unknown.
    """
    if image.mode[0] in "IF":
        values, white = _grey_numbers(path, image, any_white=True)
    else:
        pixels = photo_bytes(path, image, deep=False)
        values, white = pixels[..., :3].max(axis=2), 255.0
        if pixels.shape[2] == 4 and pixels[..., 3].min() < 255:
            values = pixels[..., 3]
        elif deep and not values.any():
            _check_deep_colours(path, image, pixels)
    top, low = float(values.max()), float(values.min())
    if top > 0 and (low == 0 or top == 1) and bool(((values == 0) | (values == top)).all()):
        return np.where(values > 0, np.uint8(255), np.uint8(0)), _assumed(top, white)
    if white is None:
        raise _unknown_white(path, image, values)
    return _scaled(path, values, white), ""


def _assumed(top: float, white: float | None) -> str:
    return "" if top == white else f"contain only 0 and {top:g}; {top:g} is read as white"


def _grey_numbers(
    path: Path, image: Any, *, any_white: bool = False
) -> tuple[np.ndarray, float | None]:
    """[H, W] values of a grey picture of more than 8 bits, and the value of white; None if it is
    unknown and `any_white` allows that."""
    values = np.asarray(image)
    if image.mode.startswith("I;16") or image.format in ("PNG", "PPM"):
        white: float | None = 65535.0
    elif image.mode == "F" and np.isfinite(values).all() and _within(values, 1):
        white = 1.0
    elif any_white:
        white = None
    else:
        raise _unknown_white(path, image, values)
    tags = getattr(image, "tag_v2", {})
    if white is not None and tags.get(_PHOTOMETRIC) == _WHITE_IS_ZERO:
        values = (white - values).astype(values.dtype)  # Pillow does that for 8 bits only
    return values, white


def _within(values: np.ndarray, most: float) -> bool:
    return bool(values.min() >= 0 and values.max() <= most)


def _scaled(path: Path, values: np.ndarray, white: float | None) -> np.ndarray:
    """Values from 0 to `white` as bytes, rounded."""
    assert white is not None
    if white == 255:
        return np.ascontiguousarray(values)
    if white == 1:
        return np.rint(values * 255).astype(np.uint8)
    top = int(values.max())
    if 0 < top < _DARKEST:
        raise FormatError(
            f"{path} has 16 bits per pixel but no value above {top} of 65535, so it would be "
            f"black. Scale its values so that white is 65535, or save it with 8 bits."
        )
    return ((values.astype(np.uint32) * 255 + 32767) // 65535).astype(np.uint8)


def _unknown_white(path: Path, image: Any, values: np.ndarray) -> FormatError:
    kind = "floating-point" if image.mode == "F" else "32-bit or signed whole"
    return FormatError(
        f"{path} has {kind} numbers from {values.min():g} to {values.max():g}, but the value "
        f"of white is unknown. Save it with 8 or 16 bits without sign, or floats from 0 to 1."
    )


def _check_deep_colours(path: Path, image: Any, pixels: np.ndarray) -> None:
    """Raise FormatError if the 8 of 16 bits that Pillow keeps lose the picture."""
    if int(pixels[..., :3].max()) * 256 < _DARKEST:
        raise FormatError(
            f"{path} has 16 bits per channel but is nearly black: no value reaches "
            f"{_DARKEST} of 65535. Scale its values so that white is 65535, or save it with 8 bits."
        )
    if isinstance(image.info.get("transparency"), tuple):
        raise FormatError(
            f"{path} has 16 bits per channel and one transparent colour, which is not supported. "
            f"Save it with an alpha channel."
        )


def srgb_to_linear(values: np.ndarray) -> np.ndarray:
    """Linear light of sRGB values of any shape, 0 or more (IEC 61966-2-1), in their dtype; the
    curve continues above 1."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
