"""Duplicate photos: detection of copies of one photo."""

import contextlib
from collections.abc import Callable
from pathlib import Path

from ..io.files import open_regular

_PIECE = 1 << 16
"""Bytes compared at the beginning, middle and end of files of equal size."""


def find_duplicates(paths: list[Path], cancelled: Callable[[], bool]) -> list[tuple[int, int]]:
    """Pairs of indices, first photo and copy; unreadable files are skipped.

    Files of equal size are compared by three pieces, which is enough for compressed photos.
    """
    by_size: dict[int, list[int]] = {}
    for i, path in enumerate(paths):
        by_size.setdefault(_size(path), []).append(i)
    pairs = []
    for size, candidates in by_size.items():
        known: dict[bytes, int] = {}
        for i in candidates if len(candidates) > 1 and size > 0 else ():
            if cancelled():
                return []
            with contextlib.suppress(OSError):
                first = known.setdefault(_pieces(paths[i], size), i)
                if first != i:
                    pairs.append((first, i))
    return sorted(pairs)


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
