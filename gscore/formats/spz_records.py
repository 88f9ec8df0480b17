"""SPZ records of vendors, a type, a length and that number of bytes; and decompression.

Source: extensions/ of github.com/nianticlabs/spz. Only the record of the axes is used, because it
changes the meaning of the numbers; the default is right-up-back. Others are skipped.
"""

import logging
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError
from ..extras import need

_RECORD = struct.Struct("<II")
_AXES = 0xADBE0003
"""Type of the record of the axes: one number, see `_axes_matrix`."""
_MOST_AXES, _USUAL = 16, 4

_log = logging.getLogger(__name__)


def placement(path: Path, records: memoryview) -> np.ndarray | None:
    """[4, 4] from a file's axes to right-down-front; None for the default axes. Skipped records are
    logged as warnings."""
    matrix = None
    while len(records) >= _RECORD.size:
        kind, size = _RECORD.unpack_from(records)
        content, records = records[_RECORD.size :][:size], records[_RECORD.size + size :]
        code = int.from_bytes(content, "little") if len(content) == 4 else 0
        if kind == _AXES and 0 < code <= _MOST_AXES:
            matrix = None if code == _USUAL else _axes_matrix(code)
            continue
        _log.warning("%s: its extension %#010x of %d bytes is not read.", path, kind, size)
    return matrix


def _axes_matrix(code: int) -> np.ndarray:
    """[4, 4] to right-down-front from the axes with this number. Bits of the number less one: 0: x
    is right, not left; 1: up, not down; 2: front, not back; 3: z is vertical, not y."""
    bits = code - 1
    vertical, forward = (2, 1) if bits & 8 else (1, 2)
    out = np.zeros((4, 4))
    out[0, 0] = 1 if bits & 1 else -1
    out[1, vertical] = -1 if bits & 2 else 1
    out[2, forward] = 1 if bits & 4 else -1
    out[3, 3] = 1
    return out


_MOST_RATIO = 1032
"""Largest ratio of unpacked to packed bytes: the limit of deflate. A zstd stream can exceed it, for
example all-zero colours, but no file of splats does."""
_SLACK = 1 << 16


def gunzip_exactly(what: str, raw: bytes | memoryview, size: int, *, at_least: int) -> bytes:
    """Unpack up to `size` bytes of gzip, but at least `at_least`.

    Args:
        what: Start of messages, "a.spz is a damaged SPZ file".
        raw: The compressed bytes.
        size: Most bytes to unpack.
        at_least: Least bytes; fewer raise an error.

    Raises:
        FormatError: it has fewer bytes, or is damaged.
    """
    check_ratio(what, len(raw), at_least)
    try:
        content = zlib.decompressobj(31).decompress(raw, max(size, 1))
    except zlib.error as error:
        raise FormatError(
            f"{what}: its gzip data are corrupt ({error}). Copy or export it again."
        ) from error
    if len(content) < at_least:
        raise FormatError(
            f"{what}: it has {len(content)} bytes, expected {at_least}. Copy or export it again."
        )
    return content[:size]


def gzip_quickly(parts: list[bytes]) -> bytes:
    """One gzip stream of all parts, at a level that takes seconds instead of minutes."""
    packer = zlib.compressobj(_GZIP_LEVEL, zlib.DEFLATED, 31)
    return b"".join([*(packer.compress(part) for part in parts), packer.flush()])


_GZIP_LEVEL = 3
_ZSTD_LEVEL = 3


def unzstd_exactly(what: str, raw: memoryview, size: int) -> memoryview:
    """Unpack a zstd stream of `size` bytes, already checked by `check_ratio`.

    Raises:
        FormatError: it has another number of bytes, or is damaged.
        BackendError: the package zstandard is not installed.
    """
    zstandard = _zstandard()
    try:
        with zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(raw) as reader:
            content = reader.read(size + 1)
    except (zstandard.ZstdError, MemoryError) as error:
        raise FormatError(
            f"{what}: its zstd data are corrupt ({error}). Copy or export it again."
        ) from error
    if len(content) != size:
        raise FormatError(
            f"{what}: a stream does not contain {size} bytes. Copy or export it again."
        )
    return memoryview(content)


def zstd_quickly(part: bytes) -> bytes:
    """One zstd stream.

    Raises:
        BackendError: the package zstandard is not installed.
    """
    return _zstandard().ZstdCompressor(level=_ZSTD_LEVEL, threads=0).compress(part)


def _zstandard() -> Any:
    return need("zstandard", "SPZ of version 4")


def check_ratio(what: str, packed: int, size: int) -> None:
    """Raise FormatError if `size` is too large for `packed` bytes."""
    if size > _MOST_RATIO * packed + _SLACK:
        raise FormatError(
            f"{what}: its header announces {size} bytes, which {packed} packed ones cannot "
            f"contain. Copy or export it again."
        )
