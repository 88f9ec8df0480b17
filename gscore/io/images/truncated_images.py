"""Truncated images: detection of missing data, which decoders ignore silently.

Decoders refuse files that are cut off. But they silently pad files whose data end early in a valid
way: a PNG with fewer rows than its header states becomes black at the bottom, a JPEG grey, and an
uncompressed TIFF shows the bytes that follow.
"""

import struct
import zlib
from pathlib import Path
from typing import Any

from ..files import open_regular
from .jpeg_scan import missing_blocks

_PIECE = 1 << 20
"""Bytes decompressed at a time."""
_PASSES = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2))
_INTERLACED = (*_PASSES, (0, 1, 1, 2))
"""First column and row, and steps, of the passes of Adam7."""
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Channels by colour type of a PNG."""
_TIFF_PLAIN, _TIFF_COLOURS = 1, (0, 1, 2, 3)
"""Tag values of no compression, and of colour types with a known row size."""


def truncation_reason(path: Path, image: Any) -> str:
    """Reason why a picture lacks pixels, as part of a message; empty if it is complete.

    Args:
        path: Its file.
        image: The picture as PIL.Image.Image, loaded.
    """
    if image.format == "PNG":
        return _png(path, image)
    if image.format in ("JPEG", "MPO"):  # MPO: several JPEGs in a file, as phones write them
        # libjpeg leaves missing data grey; the blocks are counted only if the last pixel is grey.
        last = _last_pixel(image)
        missing = missing_blocks(path) if all(v in (127, 128) for v in last) else 0
        return f"it is cut short, {missing} of its blocks are missing" if missing else ""
    if image.format == "TIFF":
        return _tiff(image)
    return ""


def _last_pixel(image: Any) -> tuple[float, ...]:
    value = image.getpixel((image.width - 1, image.height - 1))
    return value if isinstance(value, tuple) else (value,)


def _png(path: Path, image: Any) -> str:
    # Missing pixels are 0, so only pictures whose last pixel is 0 are checked.
    if any(_last_pixel(image)) and not image.info.get("interlace"):
        return ""
    try:
        there, whole = _png_bytes(path)
    except (OSError, struct.error, zlib.error, KeyError):
        return "it is damaged"
    return f"it is cut short, {there} of {whole} bytes of its pixels are there" * (there < whole)


def _png_bytes(path: Path) -> tuple[int, int]:
    """Decompressed bytes of a PNG's pixels, and the number that its header requires."""
    whole, there, packed = 0, 0, zlib.decompressobj()
    with open_regular(path) as file:
        file.seek(8)
        while True:
            length, kind = struct.unpack(">I4s", file.read(8))
            if kind == b"IHDR":
                whole = _png_size(*struct.unpack(">IIBBxxB", file.read(length)))
            elif kind == b"IDAT":
                data = file.read(length)
                while data and there < whole:
                    there += len(packed.decompress(data, _PIECE))
                    data = packed.unconsumed_tail
            elif kind == b"IEND":
                return there + len(packed.flush()), whole
            else:
                file.seek(length, 1)
            file.seek(4, 1)


def _png_size(width: int, height: int, depth: int, colour: int, interlace: int) -> int:
    """Bytes of the filtered rows of a PNG."""
    bits = depth * _CHANNELS[colour]
    total = 0
    for left, top, across, down in _INTERLACED if interlace else ((0, 0, 1, 1),):
        columns = max(0, -((left - width) // across))
        rows = max(0, -((top - height) // down))
        total += rows * (1 + (columns * bits + 7) // 8) if columns else 0
    return total


def _tiff(image: Any) -> str:
    """Reason if uncompressed strips or tiles have fewer bytes than the picture."""
    tags = image.tag_v2
    stated = tags.get(279) or tags.get(325)
    if tags.get(259, 1) != _TIFF_PLAIN or tags.get(262) not in _TIFF_COLOURS or not stated:
        return ""
    bits, samples = tags.get(258, (1,)), tags.get(277, 1)
    whole = (image.width * (sum(bits) if len(bits) == samples else bits[0] * samples) + 7) // 8
    whole *= image.height
    there = sum(stated)
    return f"it is cut short, {there} of {whole} bytes of its pixels are there" * (there < whole)
