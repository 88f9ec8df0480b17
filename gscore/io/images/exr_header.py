"""OpenEXR header: the size of a picture, checked before memory is allocated."""

import struct
from pathlib import Path

from ..files import open_regular

_MAGIC = 0x01312F76
_LONGEST = 1 << 20
_MOST_PIXELS = 1 << 28
_MOST_CHANNELS = 256


def check_exr_size(path: Path) -> None:
    """Raise ValueError if the header is damaged or states a size too large for a depth map."""
    with open_regular(path) as file:
        raw = file.read(_LONGEST)
    if len(raw) < 8 or struct.unpack_from("<I", raw)[0] != _MAGIC:
        raise ValueError("it does not start with OpenEXR's magic number")
    at, found = 8, False
    while at < len(raw) and raw[at]:
        name, at = _text(raw, at)
        _, at = _text(raw, at)
        if at + 4 > len(raw):
            break
        (size,) = struct.unpack_from("<i", raw, at)
        at += 4
        if size < 0 or at + size > len(raw):
            raise ValueError("its header is damaged")
        if name == b"dataWindow" and size == 16:
            left, top, right, bottom = struct.unpack_from("<4i", raw, at)
            width, height = right - left + 1, bottom - top + 1
            if not (width > 0 and height > 0 and width * height <= _MOST_PIXELS):
                raise ValueError(f"its header states {width} x {height} pixels")
            found = True
        if name == b"channels" and raw[at : at + size].count(b"\0") > 17 * _MOST_CHANNELS:
            raise ValueError("its header states too many channels")
        at += size
    if not found:
        raise ValueError("its header states no size")


def _text(raw: bytes, at: int) -> tuple[bytes, int]:
    end = raw.find(b"\0", at, at + 256)
    if end < 0:
        raise ValueError("its header is damaged")
    return raw[at:end], end + 1
