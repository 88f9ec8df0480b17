"""PLY elements of any file as structured numpy arrays; one-line errors for broken files."""

import io
import logging
import re
import struct
from codecs import BOM_UTF8
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import BackendError, ConfigError, DatasetError, FormatError
from ...quoting import brief, quoted
from ..files import open_regular, reason
from ..unsupported_formats import describe_unsupported

_log = logging.getLogger(__name__)

HEADER_LIMIT = 1 << 20
"""Most bytes of a header; known programs write a few thousand."""
HEADER_END = re.compile(rb"[\r\n]end_header(?:\r\n|[\r\n])")
"""Last line of a header, with the line end before it."""
_REMARK = re.compile(rb"(?<=[\r\n])(?:comment|obj_info)(?:[ \t][^\r\n]*)?(?:\r\n|[\r\n])")
"""Comment line of a header."""
_MOST_DIGITS = 18
"""Most digits of a row count."""
_ASCII = bytes(byte if byte < 128 else ord("?") for byte in range(256))


def read_elements(path: Path) -> dict[str, np.ndarray]:
    """Elements of a PLY file, ASCII or binary of either byte order.

    Args:
        path: The file.

    Returns:
        Structured arrays by element name; they may be memory-mapped, so copy what you keep.

    Raises:
        DatasetError: the file is missing or cannot be opened.
        FormatError: it is not a PLY file, or truncated or corrupt.
    """
    header, end = _check_header(path)
    try:
        import plyfile
    except ImportError as error:
        raise BackendError(
            "Reading PLY files needs the package plyfile: pip install plyfile"
        ) from error
    try:
        with _PlainHeader(path.open("rb", buffering=0), header, end) as file:
            data = plyfile.PlyData.read(file, mmap="c")
        _warn_of_rest(path, data, end)
        return {element.name: np.asarray(element.data) for element in data.elements}
    # Errors of plyfile, numpy and mmap on damaged input, found with mutated files.
    except (
        plyfile.PlyParseError,
        ValueError,
        TypeError,
        KeyError,
        IndexError,
        OverflowError,
        MemoryError,
        RuntimeError,
        StopIteration,
        struct.error,
        OSError,
    ) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0].rstrip(".")
        raise _corrupt(path, brief(reason)) from error


def header_bytes(lines: list[str]) -> bytes:
    """PLY header with these lines between `ply` and `end_header`; other characters than ASCII as
    Python's escapes.

    Raises:
        ConfigError: it is longer than readers accept.
    """
    text = "\n".join(["ply", *lines, "end_header\n"]).encode("ascii", "backslashreplace")
    if len(text) > HEADER_LIMIT:
        raise ConfigError(
            f"The header of the PLY would have {len(text)} bytes, at most {HEADER_LIMIT} allowed. "
            f"Shorten its comments."
        )
    return text


def columns(table: np.ndarray, names: list[str]) -> np.ndarray:
    """Named properties of an element as [N, len(names)] float32; too large values become infinite.

    Raises:
        FormatError: a property is a list.
    """
    assert table.dtype.names is not None
    if not names:
        return np.zeros((len(table), 0), np.float32)
    plain = np.dtype("<f4")
    if all(table.dtype[k] == plain for k in range(len(table.dtype.names))):
        # A gather over rows reads the file once; a loop over columns reads it len(names) times.
        rows = table.view(plain).reshape(len(table), len(table.dtype.names))
        at = [table.dtype.names.index(name) for name in names]
        if at == list(range(at[0], at[0] + len(at))):  # a slice copies ten times faster
            return np.array(rows[:, at[0] : at[0] + len(at)])
        return rows[:, at]
    out = np.zeros((len(table), len(names)), np.float32)
    for k, name in enumerate(names):
        if table.dtype[name].kind == "O":
            raise FormatError(f"Property {name} is a list, expected one number per vertex.")
        with np.errstate(over="ignore"):  # too large for float32: infinite
            out[:, k] = table[name]
    return out


class _PlainHeader(io.BufferedReader):
    """PLY file, from the word ply on, with a header reduced for plyfile, which parses it one byte
    at a time: without comments, and with question marks for bytes that are not ASCII."""

    def __init__(self, raw: io.FileIO, header: bytes, end: int) -> None:
        super().__init__(raw)
        self.seek(end)
        self._header = io.BytesIO(_REMARK.sub(b"", header).translate(_ASCII))

    def read(self, size: int | None = -1, /) -> bytes:
        """Read from the reduced header, then from the file."""
        head = self._header.read(size)
        if size is None or size < 0:
            return head + super().read()
        return head if len(head) == size else head + super().read(size - len(head))


def _check_header(path: Path) -> tuple[bytes, int]:
    """Refuse files that are not PLY, and row counts too large for the file, before allocating.

    Returns:
        The header without a byte order mark, and the offset of its end in the file.
    """
    try:
        with open_regular(path) as file:
            head = file.read(HEADER_LIMIT)
        size = path.stat().st_size
    except (OSError, ValueError) as error:
        raise DatasetError(f"Cannot read {brief(path)}: {reason(error)}") from error
    start = len(BOM_UTF8) if head.startswith(BOM_UTF8) else 0
    if not head.startswith((b"ply\n", b"ply\r"), start):
        raise FormatError(
            describe_unsupported(path)
            or f"{path} is not a PLY file: it does not start with the word 'ply'. Choose the "
            f"point_cloud.ply that a 3D Gaussian Splatting trainer wrote."
        )
    found = HEADER_END.search(head)
    if found is None:
        raise _corrupt(path, "its header has no end_header")
    for line in head[: found.start()].splitlines():
        words = line.split()
        is_element = len(words) == 3 and words[0] == b"element"
        if is_element and not (words[2].isdigit() and len(words[2]) <= _MOST_DIGITS):
            stated = words[2].decode("ascii", "replace")
            raise _corrupt(path, f"its header announces {quoted(stated)} rows")
        if is_element and int(words[2]) > size:  # every row takes at least one byte
            name = brief(words[1].decode("ascii", "replace"))
            rows = int(words[2])
            raise _corrupt(path, f"its header announces {rows} rows of {name} in {size} bytes")
    return head[start : found.end()], found.end()


def _warn_of_rest(path: Path, data: Any, end: int) -> None:
    """Warn of data after the last row; the header ends at byte `end`. Binary rows with lists are
    not checked, because they have no fixed size."""
    tables = [np.asarray(element.data) for element in data.elements]
    if data.text:
        with path.open("rb") as file:
            file.seek(end)
            lines = sum(1 for line in file if line.strip())
        if lines > (rows := sum(map(len, tables))):
            _log.warning(
                "%s: %d lines after the last row its header announces are not read; if the file "
                "was cut or joined, export it again.",
                path,
                lines - rows,
            )
        return
    if any(table.dtype.hasobject for table in tables):
        return
    rest = path.stat().st_size - end - sum(table.nbytes for table in tables)
    if rest > 0:
        _log.warning(
            "%s: %d bytes after the last row its header announces are not read; if the file was "
            "cut or joined, export it again.",
            path,
            rest,
        )


def _corrupt(path: Path, reason: str) -> FormatError:
    return FormatError(
        f"{path} is a truncated or corrupt PLY file: {reason}. Copy or export it again."
    )
