"""Damaged COLMAP models: one of our errors or a model, no other exception."""

import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from gscore.errors import FormatError, GsError
from gscore.io.colmap.folder import read_model, write_model

_FILES = ["cameras", "images", "points3D"]


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("name", _FILES)
def test_damaged(
    name: str, binary: bool, make_capture: Callable, mutations: Callable, tmp_path: Path
) -> None:
    """Oracle: the documented errors, naming the folder, for every damaged copy of each file."""
    write_model(make_capture(write=False).model, tmp_path, binary=binary)
    path = tmp_path / f"{name}{'.bin' if binary else '.txt'}"
    refused = 0
    for raw in mutations(path.read_bytes()):
        path.write_bytes(raw)
        try:
            read_model(tmp_path)
        except GsError as error:
            assert str(tmp_path) in str(error)
            refused += 1
    assert refused > 20


@pytest.mark.parametrize("name", _FILES)
def test_every_truncation(name: str, make_capture: Callable, tmp_path: Path) -> None:
    """Oracle: a binary file cut anywhere is refused, with file, place, expected value and
    advice."""
    write_model(make_capture(write=False, views=3, points=2).model, tmp_path)
    path = tmp_path / f"{name}.bin"
    good = path.read_bytes()
    for cut in range(len(good)):
        path.write_bytes(good[:cut])
        with pytest.raises(FormatError) as caught:
            read_model(tmp_path)
        message = str(caught.value)
        assert path.name in message and "at byte" in message and "are left" in message


@pytest.mark.parametrize("name", _FILES)
def test_huge_counts_allocate_nothing(name: str, make_capture: Callable, tmp_path: Path) -> None:
    """Oracle: an immediate refusal of a count of 2^60 records, without allocation."""
    write_model(make_capture(write=False).model, tmp_path)
    path = tmp_path / f"{name}.bin"
    path.write_bytes(struct.pack("<Q", 2**60) + path.read_bytes()[8:])
    with pytest.raises(FormatError, match=rf"{name}\.bin is truncated or corrupt: a list of \d+ "):
        read_model(tmp_path)


@pytest.mark.parametrize("name", _FILES)
def test_trailing_bytes_warn(
    name: str, make_capture: Callable, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Oracle: the number of appended bytes; no warning about the original file."""
    write_model(make_capture(write=False).model, tmp_path)
    read_model(tmp_path)
    assert not caplog.text
    path = tmp_path / f"{name}.bin"
    path.write_bytes(path.read_bytes() + bytes(7))
    read_model(tmp_path)
    assert f"{name}.bin: 7 bytes after the last record it announces" in caplog.text


def test_unknown_binary_camera_model(make_capture: Callable, tmp_path: Path) -> None:
    """Oracle: the sentence, with the id and the known models."""
    write_model(make_capture(write=False).model, tmp_path)
    path = tmp_path / "cameras.bin"
    raw = bytearray(path.read_bytes())
    raw[12:16] = struct.pack("<i", 99)
    path.write_bytes(raw)
    with pytest.raises(
        FormatError, match=r"camera 1 has the unknown camera model id 99, known are"
    ):
        read_model(tmp_path)


def test_name_that_is_no_text(make_capture: Callable, tmp_path: Path) -> None:
    """Oracle: the sentence, with the file and the bytes."""
    write_model(make_capture(write=False).model, tmp_path)
    path = tmp_path / "images.bin"
    path.write_bytes(path.read_bytes().replace(b"view_03.png", b"view_\xff3.png"))
    with pytest.raises(FormatError, match=r"images\.bin: an image name .* is not UTF-8"):
        read_model(tmp_path)
