"""PNG files of kinds that Pillow cannot write, and with wrong headers."""

import struct
import zlib

import numpy as np


def chunk(kind: bytes, data: bytes) -> bytes:
    """One chunk with its checksum."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(
    values: np.ndarray, *, height: int | None = None, key: tuple[int, ...] = (), packed: bytes = b""
) -> bytes:
    """A PNG of 8 or 16 bits.

    Args:
        values: [H, W], [H, W, 2], [H, W, 3] or [H, W, 4] uint8 or uint16.
        height: Stated in the header; None: the true one.
        key: The transparent colour.
        packed: The compressed pixels; empty: those of `values`.
    """
    colour = {1: 0, 2: 4, 3: 2, 4: 6}[1 if values.ndim == 2 else values.shape[2]]
    rows = b"".join(b"\0" + row.astype(values.dtype.newbyteorder(">")).tobytes() for row in values)
    depth = 8 * values.dtype.itemsize
    stated = values.shape[0] if height is None else height
    head = struct.pack(">IIBBBBB", values.shape[1], stated, depth, colour, 0, 0, 0)
    out = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head)
    if key:
        out += chunk(b"tRNS", struct.pack(f">{len(key)}H", *key))
    return out + chunk(b"IDAT", packed or zlib.compress(rows)) + chunk(b"IEND", b"")
