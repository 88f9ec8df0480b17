"""Duplicate photos: detection of copies of one photo."""

import contextlib
from collections.abc import Callable
from pathlib import Path

from ..io.files import open_regular

_PIECE = 1 << 16
"""Bytes that are compared at the beginning, in the middle and at the end of files of one size."""


def find_duplicates(paths: list[Path], cancelled: Callable[[], bool]) -> list[tuple[int, int]]:
    """Pairs of indices, the first photo and its copy; files that cannot be read are none.

    Files of equal size are compared by three pieces, which of compressed photos tell as much as the
    whole.
    """
    by_size: dict[int, list[int]] = {}
    for i, path in enumerate(paths):
        by_size.setdefault(_size(path), []).append(i)
    found = []
    for size, alike in by_size.items():
        seen: dict[bytes, int] = {}
        for i in alike if len(alike) > 1 and size > 0 else ():
            if cancelled():
                return []
            with contextlib.suppress(OSError):
                first = seen.setdefault(_pieces(paths[i], size), i)
                if first != i:
                    found.append((first, i))
    return sorted(found)


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _pieces(path: Path, size: int) -> bytes:
    with open_regular(path) as file:
        out = file.read(_PIECE)
        for at in (size // 2, max(0, size - _PIECE)):
            file.seek(at)
            out += file.read(_PIECE)
    return out
