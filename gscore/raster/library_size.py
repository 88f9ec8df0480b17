"""Library size check: the file is as long as its header states. Linux maps a truncated one, and the
process dies when it reads a missing page."""

import struct
from pathlib import Path
from typing import BinaryIO

_MAGIC, _64_BIT, _LITTLE = b"\x7fELF", 2, 1
_HEAD = struct.Struct("<32xQQ6xHHHH")
"""After 32 bytes: where segments and sections are listed; size and number of their entries."""
_SEGMENT = struct.Struct("<8xQ16xQ16x")
"""Where a segment begins in the file, and how long it is there."""


def bytes_missing(path: Path) -> int:
    """How many bytes a library of 64-bit Linux is shorter than it says; 0 for whole ones and files
    of other kinds, which the systems that load them look over themselves.

    Its format is that of the System V ABI, chapter 4 and 5 ("Object Files", "Program Loading").

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(0)
        return max(_stated(file, size) - size, 0)


def _stated(file: BinaryIO, size: int) -> int:
    """How long the file has to be by what its header and segments say, as far as they are there."""
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
