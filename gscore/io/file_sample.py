"""File sample: first and last bytes of a file, for format detection."""

import os
import zlib
from dataclasses import dataclass
from pathlib import Path

from .files import open_regular

_HEAD = 1 << 14
"""Bytes read from the start of a file."""
_TAIL = 1 << 16
"""Bytes read from its end, where ZIP archives list their files."""


@dataclass(frozen=True)
class FileSample:
    """First and last bytes of a file, its size and ending."""

    head: bytes
    inflated: bytes
    """First bytes of gzip's content; else empty."""
    tail: bytes
    size: int
    """Bytes."""
    ending: str
    """Last suffix of its name, lower case."""

    def is_zip_of(self, *names: bytes) -> bool:
        """True if it is a ZIP archive whose file list contains all `names`."""
        is_zip = self.head.startswith(b"PK\x03\x04")
        return is_zip and all(name in self.head + self.tail for name in names)


def sample_file(path: Path) -> FileSample:
    """Read the sample of a file.

    Raises:
        OSError: it is missing or not readable.
        DatasetError: it is not a regular file.
    """
    with open_regular(path) as file:
        head = file.read(_HEAD)
        size = file.seek(0, os.SEEK_END)
        file.seek(max(size - _TAIL, 0))
        tail = file.read(_TAIL)
    inflated = b""
    if head.startswith(b"\x1f\x8b"):
        try:
            inflated = zlib.decompressobj(31).decompress(head, 16)
        except zlib.error:
            inflated = b""
    return FileSample(head, inflated, tail, size, path.suffix.lower())
