"""Packed bytes: gzip and zstd of a known size, checked before memory is allocated."""

import zlib
from typing import Any

from ..errors import FormatError
from ..extras import need

_MOST_RATIO = 1032
"""Of unpacked to packed bytes, which deflate cannot exceed. A stream of zstd can, as of colours
that are all zero, but no file of splats does."""
_SLACK = 1 << 16


def gunzip_exactly(what: str, raw: bytes | memoryview, size: int, *, at_least: int) -> bytes:
    """The first `size` bytes within gzip, or fewer where it holds fewer, but `at_least` those.

    Args:
        what: The beginning of errors, "a.spz is a damaged SPZ file".
        raw: The compressed bytes.
        size: Bytes wanted.
        at_least: Bytes without which it is damaged.

    Raises:
        FormatError: it holds less, or is damaged.
    """
    check_ratio(what, len(raw), at_least)
    try:
        found = zlib.decompressobj(31).decompress(raw, max(size, 1))
    except zlib.error as error:
        raise FormatError(
            f"{what}: what gzip packed is corrupt ({error}). Copy or export it again."
        ) from error
    if len(found) < at_least:
        raise FormatError(
            f"{what}: it holds {len(found)} bytes, expected {at_least}. Copy or export it again."
        )
    return found[:size]


def gzip_quickly(parts: list[bytes]) -> bytes:
    """One gzip stream of all parts, at the level that costs seconds and not minutes."""
    packer = zlib.compressobj(_GZIP_LEVEL, zlib.DEFLATED, 31)
    return b"".join([*(packer.compress(part) for part in parts), packer.flush()])


_GZIP_LEVEL = 3
_ZSTD_LEVEL = 3


def unzstd_exactly(what: str, raw: memoryview, size: int) -> memoryview:
    """The `size` bytes that a zstd stream holds; `check_ratio` has looked at them.

    Raises:
        FormatError: it holds another number of bytes, or is damaged.
        BackendError: the package zstandard is not installed.
    """
    zstandard = _zstandard()
    try:
        with zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(raw) as reader:
            found = reader.read(size + 1)
    except (zstandard.ZstdError, MemoryError) as error:
        raise FormatError(
            f"{what}: what zstd packed is corrupt ({error}). Copy or export it again."
        ) from error
    if len(found) != size:
        raise FormatError(f"{what}: a stream does not hold {size} bytes. Copy or export it again.")
    return memoryview(found)


def zstd_quickly(part: bytes) -> bytes:
    """One zstd stream.

    Raises:
        BackendError: the package zstandard is not installed.
    """
    return _zstandard().ZstdCompressor(level=_ZSTD_LEVEL, threads=0).compress(part)


def _zstandard() -> Any:
    return need("zstandard", "SPZ of version 4")


def check_ratio(what: str, packed: int, size: int) -> None:
    """FormatError for a size that a file of so many packed bytes does not hold."""
    if size > _MOST_RATIO * packed + _SLACK:
        raise FormatError(
            f"{what}: its header announces {size} bytes, which {packed} packed ones cannot hold. "
            f"Copy or export it again."
        )
