"""Any PLY file as named numpy tables, with every broken file turned into one sentence."""

import logging
import struct
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BackendError, DatasetError, FormatError
from .files import open_regular, reason, shown
from .foreign import foreign

_log = logging.getLogger(__name__)

_HEADER_LIMIT = 1 << 20


def read_elements(path: Path) -> dict[str, np.ndarray]:
    """Elements of a PLY file, ASCII or binary of either byte order.

    Args:
        path: The file.

    Returns:
        Structured arrays by element name; they may be mapped from the file, so copy what you keep.

    Raises:
        DatasetError: the file is missing or cannot be opened.
        FormatError: it is no PLY file, or truncated or corrupt.
    """
    _check_header(path)
    try:
        import plyfile
    except ImportError as error:
        raise BackendError(
            "Reading PLY files takes the package plyfile: pip install plyfile"
        ) from error
    try:
        data = plyfile.PlyData.read(str(path), mmap="c")
        _warn_of_rest(path, data)
        return {element.name: np.asarray(element.data) for element in data.elements}
    # What plyfile, numpy and mmap raise on damaged input, by experiment with mutated files.
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
        raise _corrupt(path, reason) from error


def columns(table: np.ndarray, names: list[str]) -> np.ndarray:
    """The named properties of an element as [N, len(names)] float32; too large ones are infinite.

    Raises:
        FormatError: a property is a list.
    """
    assert table.dtype.names is not None
    if not names:
        return np.zeros((len(table), 0), np.float32)
    plain = np.dtype("<f4")
    if all(table.dtype[k] == plain for k in range(len(table.dtype.names))):
        # One gather over rows reads the file once; column after column reads it len(names) times.
        rows = table.view(plain).reshape(len(table), len(table.dtype.names))
        at = [table.dtype.names.index(name) for name in names]
        if at == list(range(at[0], at[0] + len(at))):  # a slice copies ten times faster
            return np.array(rows[:, at[0] : at[0] + len(at)])
        return rows[:, at]
    out = np.zeros((len(table), len(names)), np.float32)
    for k, name in enumerate(names):
        if table.dtype[name].kind == "O":
            raise FormatError(f"Property {name} is a list, expected one number a vertex.")
        with np.errstate(over="ignore"):  # too large for float32: infinite
            out[:, k] = table[name]
    return out


def _check_header(path: Path) -> None:
    """Refuse what is no PLY, and counts that the file cannot hold, before anything is allocated."""
    try:
        with open_regular(path) as file:
            head = file.read(_HEADER_LIMIT)
        size = path.stat().st_size
    except (OSError, ValueError) as error:
        raise DatasetError(f"Cannot read {shown(path)}: {reason(error)}") from error
    if not head.startswith((b"ply\n", b"ply\r")):
        raise FormatError(
            foreign(path)
            or f"{path} is not a PLY file: it does not start with the word 'ply'. Choose the "
            f"point_cloud.ply that a 3D Gaussian Splatting trainer wrote."
        )
    end = head.find(b"end_header")
    if end < 0:
        raise _corrupt(path, "its header has no end_header")
    for line in head[:end].splitlines():
        words = line.split()
        is_element = len(words) == 3 and words[0] == b"element"
        if is_element and not words[2].isdigit():
            stated = words[2].decode("ascii", "replace")
            raise _corrupt(path, f"its header announces {stated!r} rows")
        if is_element and int(words[2]) > size:  # every row takes at least one byte
            name = words[1].decode("ascii", "replace")
            rows = int(words[2])
            raise _corrupt(path, f"its header announces {rows} rows of {name} in {size} bytes")


def _warn_of_rest(path: Path, data: Any) -> None:
    """Tell of bytes that belong to no row; text, and rows of lists, have no fixed size."""
    tables = [np.asarray(element.data) for element in data.elements]
    if data.text or any(table.dtype.hasobject for table in tables):
        return
    with path.open("rb") as file:
        head = file.read(_HEADER_LIMIT)
    at = head.index(b"end_header") + len(b"end_header")
    at += 2 if head[at : at + 2] == b"\r\n" else 1
    rest = path.stat().st_size - at - sum(table.nbytes for table in tables)
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
