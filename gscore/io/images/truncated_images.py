"""Truncated images: detection of missing data, which decoders ignore silently.

Decoders refuse files that are cut off. But they silently pad files whose data end early in a valid
way: a PNG with fewer rows than its header states becomes black at the bottom, a JPEG grey, and an
uncompressed TIFF shows the bytes that follow.

The blocks of a JPEG are counted from their Huffman codes without decoding (ITU-T T.81): a scan is a
sequence of minimum coded units, each with some blocks of each component; a block is a code with
bits for its mean, then codes with bits for its other coefficients.
"""

import re
import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..files import open_regular, read_bytes

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


_FRAMES = frozenset({0xC0, 0xC1})
"""Frames of one sequential scan; others (progressive, lossless) are not counted."""
_OTHER_FRAMES = frozenset(range(0xC2, 0xD0)) - {0xC4, 0xC8, 0xCC}
_NEXT_MARKER = re.compile(rb"\xff+[^\x00\xd0-\xd7\xff]", re.DOTALL)
_RESTART = re.compile(rb"\xff[\xd0-\xd7]")
_END = b"\xff\xd9"
_CODE = 16
"""Most bits of a code."""


@dataclass(kw_only=True)
class _Jpeg:
    size: tuple[int, int] = (0, 0)
    sampling: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Blocks per MCU across and down, by component."""
    tables: dict[int, list[int]] = field(default_factory=dict)
    """Lookup table by class (DC 0, AC 16) plus number: 256 length + value for each next 16 bits."""
    interval: int = 0
    """MCUs between restart markers; 0: no markers."""


def missing_blocks(path: Path) -> int:
    """Number of MCUs missing at the end of a JPEG of one sequential scan; 0 if it is complete or of
    another kind."""
    try:
        return _missing(read_bytes(path))
    except (IndexError, KeyError, struct.error):  # a damaged header is left to the decoder
        return 0


def with_end_marker(path: Path) -> bytes | None:
    """Bytes of a JPEG of one sequential scan that lacks only its end marker (EOI), with the marker
    added; None for every other file."""
    raw = read_bytes(path).rstrip(b"\xff")
    try:
        at = raw.rindex(b"\xff\xda")  # a byte 0xff within a scan is followed by 0 or a restart
        whole = not _NEXT_MARKER.search(raw, at + 2) and _missing(raw) == 0
    except (IndexError, KeyError, ValueError, struct.error):
        return None
    return raw + _END if whole and (_missing(raw[: raw.rindex(b"\xff\xda") + 16]) > 0) else None


def _missing(raw: bytes) -> int:
    jpeg, at = _Jpeg(), 2
    while True:
        while raw[at + 1] == 0xFF:
            at += 1
        marker = raw[at + 1]
        (length,) = struct.unpack_from(">H", raw, at + 2)
        body, at = raw[at + 4 : at + 2 + length], at + 2 + length
        if marker in _OTHER_FRAMES or marker == 0xD9:
            return 0
        if marker == 0xDA:
            return _missing_in_scan(jpeg, body, raw, at)
        if marker in _FRAMES:
            height, width, count = struct.unpack_from(">xHHB", body)
            jpeg.size = width, height
            parts = struct.iter_unpack("BBB", body[6 : 6 + 3 * count])
            jpeg.sampling = {number: (ratio >> 4, ratio & 15) for number, ratio, _ in parts}
        elif marker == 0xC4:
            _read_tables(body, jpeg.tables)
        elif marker == 0xDD:
            (jpeg.interval,) = struct.unpack(">H", body)


def _read_tables(body: bytes, tables: dict[int, list[int]]) -> None:
    at = 0
    while at < len(body):
        counts, value_at = body[at + 1 : at + 17], at + 17
        table, code = [0] * (1 << _CODE), 0
        for length, count in enumerate(counts, start=1):
            for value in body[value_at : value_at + count]:
                first = code << (_CODE - length)
                filled = 1 << (_CODE - length)
                table[first : first + filled] = [length << 8 | value] * filled
                code += 1
            value_at += count
            code <<= 1
        tables[body[at]] = table[: 1 << _CODE]
        at = value_at


def _missing_in_scan(jpeg: _Jpeg, header: bytes, raw: bytes, start: int) -> int:
    """Number of MCUs missing in the scan whose data begin at `start`."""
    if header[0] != len(jpeg.sampling) or not all(jpeg.size):
        return 0
    blocks: list[tuple[list[int], list[int]]] = []
    for number, chosen in struct.iter_unpack("BB", header[1 : 1 + 2 * header[0]]):
        across, down = jpeg.sampling[number] if header[0] > 1 else (1, 1)
        blocks += [(jpeg.tables[chosen >> 4], jpeg.tables[16 + (chosen & 15)])] * (across * down)
    wide = max(a for a, _ in jpeg.sampling.values()) if header[0] > 1 else 1
    tall = max(d for _, d in jpeg.sampling.values()) if header[0] > 1 else 1
    total = -(-jpeg.size[0] // (8 * wide)) * -(-jpeg.size[1] // (8 * tall))
    found = _NEXT_MARKER.search(raw, start)
    parts = _RESTART.split(raw[start : found.start() if found else len(raw)])
    # Only the last part can be incomplete.
    before = jpeg.interval * (len(parts) - 1)
    expected = min(jpeg.interval or total, total - before)
    present = before + _count(parts[-1].replace(b"\xff\x00", b"\xff"), blocks, expected)
    return max(0, total - present)


def _count(data: bytes, blocks: list[tuple[list[int], list[int]]], most: int) -> int:
    """Number of MCUs in data without stuffing; `most` if a code is damaged, because damage is not
    reported here."""
    end = 8 * len(data)
    data += bytes(4)
    at = 0
    for done in range(most):
        for mean, rest in blocks:
            place = 0
            while place < 64:
                if at >= end:
                    return done
                byte = at >> 3
                ahead = int.from_bytes(data[byte : byte + 4], "big") >> (16 - (at & 7)) & 0xFFFF
                entry = (rest if place else mean)[ahead]
                if not entry:  # the padding bits of the last byte are not a code
                    return done if end - at < 8 else most
                value = entry & 255
                at += (entry >> 8) + (value & 15)
                if place and not value & 15 and value != 0xF0:  # the rest of the block is 0
                    break
                place += (value >> 4) + 1 if place else 1
    return most if at <= end else most - 1
