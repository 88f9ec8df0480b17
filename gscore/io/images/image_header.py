"""Image headers of PNG and JPEG: size, transparency and EXIF orientation; standard library."""

import re
import struct
from pathlib import Path
from typing import BinaryIO, NamedTuple

from ..files import open_regular


class ImageInfo(NamedTuple):
    """Size, transparency and orientation from the header of an image file."""

    width: int
    """Pixels as stored."""
    height: int
    """Pixels as stored."""
    has_alpha: bool
    """True if it has transparency."""
    orientation: int = 1
    """EXIF orientation, 1 to 8: rotation and mirroring of the stored picture for display."""

    @property
    def is_sideways(self) -> bool:
        """True if EXIF rotates the stored picture by 90 degrees for display."""
        return self.orientation in (5, 6, 7, 8)

    @property
    def is_flipped(self) -> bool:
        """True if EXIF rotates it by 180 degrees or mirrors it, which keeps its size."""
        return self.orientation in (2, 3, 4)


ORIENTATION = 0x0112
"""EXIF tag."""
_PNG = b"\x89PNG\r\n\x1a\n"
_XMP_TURN = re.compile(rb"tiff:Orientation(?:=\"|>)([0-9])")
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""JPEG markers that start a frame and state its size."""
_LONGEST = 1 << 24
"""Most bytes of a chunk that is read: a damaged length must not allocate gigabytes."""
_LONE = frozenset({0x01, *range(0xD0, 0xD8)})
"""JPEG markers without a length."""


def read_header(path: str | Path) -> ImageInfo | None:
    """Read the header of a PNG or JPEG; None for other, missing and damaged files.

    Raises:
        DatasetError: it is not a regular file.
    """
    try:
        with open_regular(path) as file:
            head = file.read(8)
            if head == _PNG:
                return _png(file)
            if head[:3] == b"\xff\xd8\xff":
                file.seek(2)
                return _jpeg(file)
    except (OSError, struct.error):
        pass
    return None


def _info(width: int, height: int, has_alpha: bool, turn: int) -> ImageInfo | None:
    if not width or not height:
        return None
    return ImageInfo(width, height, has_alpha, turn if 1 <= turn <= 8 else 1)


def _png(file: BinaryIO) -> ImageInfo | None:
    """Read chunks up to the first of pixels: size, transparency, EXIF."""
    width, height, alpha, turn = 0, 0, False, 1
    while True:
        length, kind = struct.unpack(">I4s", file.read(8))
        if kind in (b"IDAT", b"IEND"):
            break
        if kind not in (b"IHDR", b"tRNS", b"eXIf", b"iTXt") or length > _LONGEST:
            file.seek(length + 4, 1)
            continue
        body = file.read(length)
        file.seek(4, 1)
        if kind == b"IHDR":
            width, height, colour = struct.unpack_from(">IIxB", body)
            alpha = alpha or colour in (4, 6)
        elif kind == b"tRNS":
            alpha = True
        elif kind == b"eXIf":
            turn = _exif_turn(body)
        elif turn == 1 and (match := _XMP_TURN.search(body)):
            turn = int(match[1])
    return _info(width, height, alpha, turn)


def _jpeg(file: BinaryIO) -> ImageInfo | None:
    """Read segments up to the frame header: EXIF, size."""
    exif, xmp = 1, 1
    while True:
        (marker,) = struct.unpack(">xB", file.read(2))
        while marker == 0xFF:  # fill bytes
            (marker,) = struct.unpack("B", file.read(1))
        if marker in _LONE:
            continue
        (length,) = struct.unpack(">H", file.read(2))
        if marker in _FRAMES:
            height, width = struct.unpack(">xHH", file.read(5))
            turn = exif if exif != 1 else xmp
            return _info(width, height, False, turn)
        if marker in (0xD9, 0xDA) or length < 2:
            return None
        if marker != 0xE1:
            file.seek(length - 2, 1)
            continue
        body = file.read(length - 2)
        if body.startswith(b"Exif\0\0"):
            exif = _exif_turn(body[6:])
        elif match := _XMP_TURN.search(body):
            xmp = int(match[1])


def _exif_turn(tiff: bytes) -> int:
    """Orientation from the first directory of an EXIF block; 1 if missing."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(tiff[:4])
    if order is None:
        return 1
    try:
        (at,) = struct.unpack_from(order + "I", tiff, 4)
        (count,) = struct.unpack_from(order + "H", tiff, at)
        for i in range(count):
            entry = at + 2 + 12 * i
            tag, kind, number = struct.unpack_from(order + "HHI", tiff, entry)
            if (tag, kind, number) == (ORIENTATION, 3, 1):
                return struct.unpack_from(order + "H", tiff, entry + 8)[0]
    except struct.error:
        pass
    return 1
