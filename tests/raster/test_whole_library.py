"""Truncated libraries, detected before the system maps them."""

import random
import sys
from pathlib import Path

import pytest

from gscore.raster import native_library
from gscore.raster.shared_library import bytes_missing

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the format is that of Linux")


@pytest.fixture(scope="module")
def whole() -> bytes:
    """The library that is in use."""
    return native_library.library_path().read_bytes()


def test_a_whole_library_misses_nothing(whole: bytes, tmp_path: Path) -> None:
    """Oracle: libraries that work, this one also with appended bytes."""
    import _ctypes

    (tmp_path / "more.so").write_bytes(whole + b"more")
    for path in (native_library.library_path(), tmp_path / "more.so", Path(_ctypes.__file__)):
        assert bytes_missing(path) == 0


def test_missing_bytes_are_counted(whole: bytes, tmp_path: Path) -> None:
    """Oracle: the number of bytes cut off, as long as the header is whole."""
    path, numbers = tmp_path / "cut.so", random.Random(7)
    for length in [64, len(whole) - 1, *(numbers.randrange(64, len(whole)) for _ in range(30))]:
        path.write_bytes(whole[:length])
        assert bytes_missing(path) == len(whole) - length


def test_headers_of_noise_are_survived(whole: bytes, tmp_path: Path) -> None:
    """Oracle: some number, without an error, for any bytes after those of the format."""
    path, numbers = tmp_path / "noise.so", random.Random(8)
    for length in range(0, 200, 3):
        path.write_bytes(whole[:16] + numbers.randbytes(length))
        assert bytes_missing(path) >= 0
