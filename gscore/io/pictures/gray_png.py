"""Grey pictures of 8 bits as PNG, where no library for pictures can be had."""

import struct
import zlib

import numpy as np

from ...errors import ShapeError

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_LEVEL = 6


def gray_png(levels: np.ndarray) -> bytes:
    """A PNG of `levels`, [H, W] uint8, the top row first (PNG 1.2, colour type 0).

    Raises:
        ShapeError: it is no such array, or has no pixels.
    """
    if levels.ndim != 2 or levels.dtype != np.uint8 or not levels.size:
        raise ShapeError(
            f"a grey picture is [H, W] uint8 with pixels, got {levels.dtype} {list(levels.shape)}."
        )
    height, width = levels.shape
    rows = np.zeros((height, width + 1), np.uint8)  # each row begins with its filter: none
    rows[:, 1:] = levels
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), _LEVEL)), (b"IEND", b""))
    return _SIGNATURE + b"".join(_chunk(kind, body) for kind, body in chunks)


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
