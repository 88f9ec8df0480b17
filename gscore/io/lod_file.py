"""Level-of-detail (LOD) file: a header, chunks of raw float32, and an index at the end.

A chunk is the means, quats, log scales, opacity logits, sh0 and shN of its splats, one array after
the other as in `Splats`, little endian.
"""

import os
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import DatasetError, FormatError
from ..quoting import brief
from ..splats import PARAMETERS, SH_REST_BY_DEGREE, Splats
from .files import open_regular, reason
from .lod_index import KIND, LodIndex, parse_index, row_floats

LOD_ENDING = ".lod"
"""File ending."""
HEADER_BYTES = 128
"""Bytes before the first chunk."""
_HEADER = re.compile(re.escape(KIND).encode() + rb"\nindex (\d{20}) (\d{20})\n *\n")
_MOST_INDEX = 1 << 30
"""Most bytes of an index; a billion splats need fewer."""
_AGAIN = "Copy the file or build it with gscore lod again."


def lod_header(begin: int, size: int) -> bytes:
    """Header of a file whose index has `size` bytes from offset `begin`."""
    text = f"{KIND}\nindex {begin:020} {size:020}\n".encode()
    return text + b" " * (HEADER_BYTES - len(text) - 1) + b"\n"


def is_lod_file(path: Path) -> bool:
    """True if a file has the header of an LOD file."""
    try:
        with open_regular(path) as file:
            return file.read(len(KIND) + 1) == f"{KIND}\n".encode()
    except (OSError, ValueError, DatasetError):
        return False


def chunk_bytes(splats: Splats) -> bytes:
    """Bytes of a chunk with these splats."""
    return b"".join(getattr(splats, name).astype("<f4").tobytes() for name in PARAMETERS)


def chunk_parts(content: bytes | bytearray | memoryview, sh_degree: int) -> dict[str, np.ndarray]:
    """Parameters of a chunk by name, float32, as views of its bytes."""
    count = len(content) // (4 * row_floats(sh_degree))
    values = np.frombuffer(content, "<f4").astype(np.float32, copy=False)
    parts, at = {}, 0
    for name, shape in _shapes(sh_degree).items():
        size = count * int(np.prod(shape))
        parts[name] = values[at : at + size].reshape(count, *shape)
        at += size
    return parts


def _shapes(sh_degree: int) -> dict[str, tuple[int, ...]]:
    rest = SH_REST_BY_DEGREE[sh_degree]
    shapes = ((3,), (4,), (3,), (), (1, 3), (rest, 3))
    return dict(zip(PARAMETERS, shapes, strict=True))


def empty_splats(count: int, sh_degree: int) -> dict[str, np.ndarray]:
    """Uninitialised float32 arrays for `count` splats, by parameter."""
    return {
        name: np.empty((count, *shape), np.float32) for name, shape in _shapes(sh_degree).items()
    }


@dataclass(frozen=True)
class LodFile:
    """An open LOD file; close it, or use it in a `with`."""

    path: Path
    index: LodIndex
    _file: BinaryIO

    def __enter__(self) -> "LodFile":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def storage_bytes(self) -> int:
        """Size of the file, bytes."""
        return os.fstat(self._file.fileno()).st_size

    def chunk(self, level: int, chunk: int) -> dict[str, np.ndarray]:
        """Parameters of a chunk by name, float32.

        Raises:
            FormatError: its checksum is wrong.
            DatasetError: it cannot be read.
        """
        begin, end = self.index.offsets(level)[chunk : chunk + 2].tolist()
        content = bytearray(end - begin)
        try:
            self._file.seek(HEADER_BYTES + begin)
            read = self._file.readinto(content)  # type: ignore[attr-defined]
        except (OSError, ValueError) as error:
            raise DatasetError(f"Cannot read {brief(self.path)}: {reason(error)}") from error
        if read != len(content) or zlib.crc32(content) != self.index.levels[level].checks[chunk]:
            raise FormatError(
                f"{brief(self.path)}: chunk {chunk} of level {level} is damaged. {_AGAIN}"
            )
        return chunk_parts(content, self.index.sh_degree)

    def chunks(self, level: int) -> Iterator[Splats]:
        """All chunks of a level in order; raises as `chunk`."""
        for chunk in range(len(self.index.levels[level].counts)):
            yield Splats(**self.chunk(level, chunk))


def lod_chunks_of(path: Path, index: LodIndex) -> LodFile:
    """A file with its chunks but not yet its index, which is given.

    Raises:
        OSError: it cannot be opened.
    """
    return LodFile(path, index, path.open("rb"))


def open_lod_file(path: str | Path) -> LodFile:
    """Open an LOD file and read its index.

    Raises:
        DatasetError: the file is missing or cannot be read.
        FormatError: it is not an LOD file, truncated or damaged.
    """
    path = Path(path)
    try:
        file = open_regular(path)
    except (OSError, ValueError) as error:
        raise DatasetError(f"Cannot read {brief(path)}: {reason(error)}") from error
    try:
        return LodFile(path, _read_index(path, file), file)
    except BaseException:
        file.close()
        raise


def _read_index(path: Path, file: BinaryIO) -> LodIndex:
    try:
        size = os.fstat(file.fileno()).st_size
        header = file.read(HEADER_BYTES)
        if not header.startswith(f"{KIND}\n".encode()):
            raise FormatError(
                f"{brief(path)} is not a file of levels of detail. Make one with gscore lod."
            )
        match = _HEADER.fullmatch(header)
        begin, length = map(int, match.groups()) if match else (0, 0)
        if not match or not 0 < length <= _MOST_INDEX or begin + length != size:
            raise FormatError(f"{brief(path)} is truncated or damaged. {_AGAIN}")
        file.seek(begin)
        text = file.read(length)
    except (OSError, ValueError) as error:
        raise DatasetError(f"Cannot read {brief(path)}: {reason(error)}") from error
    try:
        index = parse_index(text)
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, IndexError) as error:
        raise FormatError(f"{brief(path)}: its index is damaged. {_AGAIN}") from error
    if begin != HEADER_BYTES + index.data_bytes:
        raise FormatError(f"{brief(path)} does not match its index. {_AGAIN}")
    return index
