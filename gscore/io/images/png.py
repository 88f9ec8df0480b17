"""PNG writer, without an image library."""

import struct
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...errors import ShapeError
from ..files import atomic_write

SIGNED = {"Software": "gscore"}
"""Texts of PNGs made by gscore, which may be overwritten without asking."""
_TYPES = {1: 0, 3: 2, 4: 6}
"""Colour types of the PNG standard, by number of channels."""
_LEVEL = 6


def write_png(path: str | Path, image: np.ndarray, texts: Mapping[str, str] | None = None) -> None:
    """Write a PNG completely or not at all.

    Args:
        path: The file to write; its folder is made.
        image: As for `png_bytes`.
        texts: Texts by keyword, both ASCII.

    Raises:
        ShapeError: another shape or dtype.
        GsError: the file cannot be written.
    """
    atomic_write(path, png_bytes(image, texts))


def png_bytes(
    image: np.ndarray, texts: Mapping[str, str] | None = None, *, packed: bool = True
) -> bytes:
    """A picture as the bytes of a PNG.

    Args:
        image: [H, W], [H, W, 3] or [H, W, 4] uint8; grey, RGB or RGBA (not premultiplied), sRGB. Or
            [H, W] uint16, grey. The top row is first.
        texts: Texts by keyword, both ASCII.
        packed: Compress it, which takes 0.1 s per megapixel; else it is as large as the pixels and
            takes a tenth of the time.

    Raises:
        ShapeError: the array has another shape or dtype, or no pixels.
    """
    shape = image.shape
    channels = 1 if len(shape) == 2 else shape[2] if len(shape) == 3 else 0
    deep = image.dtype == np.uint16 and len(shape) == 2
    if channels not in _TYPES or not (deep or image.dtype == np.uint8) or 0 in shape:
        raise ShapeError(
            f"a PNG takes uint8 [H, W], [H, W, 3] or [H, W, 4] or uint16 [H, W] with pixels, got "
            f"{image.dtype} {list(shape)}."
        )
    height, width = shape[:2]
    size = 2 if deep else channels  # bytes per pixel, 16 bits big endian
    pixels = np.ascontiguousarray(image, ">u2" if deep else None).view(np.uint8)
    pixels = pixels.reshape(height, width, size)
    rows = np.empty((height, width * size + 1), np.uint8)
    rows[:, 0] = packed  # filter "Sub": each byte minus the one of the pixel to the left; else none
    rows[:, 1:] = pixels.reshape(height, -1)
    if packed:
        rows[:, 1 + size :] = (pixels[:, 1:] - pixels[:, :-1]).reshape(height, -1)
    data = zlib.compress(rows.data, _LEVEL if packed else 0)
    head = struct.pack(">IIBBBBB", width, height, 16 if deep else 8, _TYPES[channels], 0, 0, 0)
    notes = [(b"tEXt", f"{key}\0{text}".encode("ascii")) for key, text in (texts or {}).items()]
    out = [b"\x89PNG\r\n\x1a\n"]
    for kind, body in [(b"IHDR", head), *notes, (b"IDAT", data), (b"IEND", b"")]:
        check = struct.pack(">I", zlib.crc32(kind + body))
        out += [struct.pack(">I", len(body)), kind, body, check]
    return b"".join(out)
