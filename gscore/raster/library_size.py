"""Library size check against its ELF header, because Linux maps a truncated library and the process
dies when it reads a missing page."""

import struct
from pathlib import Path
from typing import BinaryIO

_MAGIC, _64_BIT, _LITTLE = b"\x7fELF", 2, 1
_HEAD = struct.Struct("<32xQQ6xHHHH")
"""After 32 bytes: offsets of the segment and section tables; size and number of their entries."""
_SEGMENT = struct.Struct("<8xQ16xQ16x")
"""Offset and size of a segment in the file."""


def bytes_missing(path: Path) -> int:
    """Number of bytes missing at the end of a 64-bit ELF library; 0 for complete ones and other
    formats, which their systems check on loading.

    Format: System V ABI, chapters 4 and 5 ("Object Files", "Program Loading").

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(0)
        return max(_stated(file, size) - size, 0)


def _stated(file: BinaryIO, size: int) -> int:
    """Size of the complete file, from the header and the segments that can be read."""
    head = file.read(_HEAD.size)
    if len(head) < _HEAD.size or not head.startswith(_MAGIC + bytes((_64_BIT, _LITTLE))):
        return 0
    segments, sections, entry, count, of_section, of_sections = _HEAD.unpack(head)
    end = max(sections + of_section * of_sections, segments + entry * count)
    if entry != _SEGMENT.size or segments > size:
        return end
    file.seek(segments)
    table = file.read(entry * count)
    whole = table[: len(table) // entry * entry]
    return max([end, *(begin + length for begin, length in _SEGMENT.iter_unpack(whole))])
