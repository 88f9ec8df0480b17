"""File sample: the first and last bytes of a file, for format detection."""

import os
import zlib
from dataclasses import dataclass
from pathlib import Path

from .files import open_regular

_HEAD = 1 << 14
"""Bytes looked at from the start of a file."""
_TAIL = 1 << 16
"""And from its end, where ZIP archives list what they hold."""


@dataclass(frozen=True)
class FileSample:
    """What is looked at of a file."""

    head: bytes
    inflated: bytes
    """The first bytes inside, of gzip; else empty."""
    tail: bytes
    size: int
    ending: str
    """The last suffix of its name, in small letters."""

    def is_zip_of(self, *names: bytes) -> bool:
        """Whether it is a ZIP archive in whose list of files all the words stand."""
        is_zip = self.head.startswith(b"PK\x03\x04")
        return is_zip and all(name in self.head + self.tail for name in names)


def sample_file(path: Path) -> FileSample:
    """Look at a file.

    Raises:
        OSError: it is missing or must not be read.
        DatasetError: it is no regular file.
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
