"""Level-of-detail (LOD) file: a header, chunks of raw float32, and an index at the end.

A chunk is its splats' means, quaternions, log scales, logits of opacities, constant SH coefficients
and further ones, one after the other, each as `Splats` holds it, little endian.
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
"""Of the names of such files."""
HEADER_BYTES = 128
"""Before the first chunk."""
_HEADER = re.compile(re.escape(KIND).encode() + rb"\nindex (\d{20}) (\d{20})\n *\n")
_MOST_INDEX = 1 << 30
"""Bytes of an index; those of a thousand million splats have fewer."""
_AGAIN = "Copy the file again, or build it anew with gscore lod."


def lod_header(begin: int, size: int) -> bytes:
    """The header of a file whose index begins at a byte and has so many."""
    text = f"{KIND}\nindex {begin:020} {size:020}\n".encode()
    return text + b" " * (HEADER_BYTES - len(text) - 1) + b"\n"


def is_lod_file(path: Path) -> bool:
    """Whether a file begins as one of levels of detail."""
    try:
        with open_regular(path) as file:
            return file.read(len(KIND) + 1) == f"{KIND}\n".encode()
    except (OSError, ValueError, DatasetError):
        return False


def chunk_bytes(splats: Splats) -> bytes:
    """Splats as a chunk holds them."""
    return b"".join(getattr(splats, name).astype("<f4").tobytes() for name in PARAMETERS)


def chunk_parts(content: bytes | bytearray | memoryview, sh_degree: int) -> dict[str, np.ndarray]:
    """The parameters of a chunk by name, float32, as views of its bytes."""
    count = len(content) // (4 * row_floats(sh_degree))
    values = np.frombuffer(content, "<f4").astype(np.float32, copy=False)
    found, at = {}, 0
    for name, shape in _shapes(sh_degree).items():
        size = count * int(np.prod(shape))
        found[name] = values[at : at + size].reshape(count, *shape)
        at += size
    return found


def _shapes(sh_degree: int) -> dict[str, tuple[int, ...]]:
    rest = SH_REST_BY_DEGREE[sh_degree]
    shapes = ((3,), (4,), (3,), (), (1, 3), (rest, 3))
    return dict(zip(PARAMETERS, shapes, strict=True))


def empty_splats(count: int, sh_degree: int) -> dict[str, np.ndarray]:
    """Room for so many splats, by parameter, float32; what it holds is not said."""
    return {
        name: np.empty((count, *shape), np.float32) for name, shape in _shapes(sh_degree).items()
    }


@dataclass(frozen=True)
class LodFile:
    """An open file of levels of detail; close it, or use it in a `with`."""

    path: Path
    index: LodIndex
    _file: BinaryIO

    def __enter__(self) -> "LodFile":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let the file go."""
        self._file.close()

    @property
    def storage_bytes(self) -> int:
        """Bytes on the disk."""
        return os.fstat(self._file.fileno()).st_size

    def chunk(self, level: int, chunk: int) -> dict[str, np.ndarray]:
        """The parameters of a chunk by name, float32.

        Raises:
            FormatError: its bytes are not those that were written.
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
        """All chunks of a level in their order; raises as `chunk`."""
        for chunk in range(len(self.index.levels[level].counts)):
            yield Splats(**self.chunk(level, chunk))


def lod_chunks_of(path: Path, index: LodIndex) -> LodFile:
    """A file of which only the chunks are written yet, with the index that it will have.

    Raises:
        OSError: it cannot be opened.
    """
    return LodFile(path, index, path.open("rb"))


def open_lod_file(path: str | Path) -> LodFile:
    """Open a file of levels of detail and read its index.

    Raises:
        DatasetError: the file is missing or cannot be read.
        FormatError: it is none, truncated or damaged.
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
                f"{brief(path)} is no file of levels of detail. Make one with gscore lod."
            )
        found = _HEADER.fullmatch(header)
        begin, length = map(int, found.groups()) if found else (0, 0)
        if not found or not 0 < length <= _MOST_INDEX or begin + length != size:
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
        raise FormatError(f"{brief(path)} does not hold what its index lists. {_AGAIN}")
    return index
