"""Raw photos and TIFFs that begin with a reduced picture; oracle: the source pixels."""

import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscore.errors import DatasetError, FormatError
from gscore.io.images.raw import RAW_ENDINGS, is_raw
from gscore.io.images.read_image import read_image, read_info
from gscore.sfm.photos import read_photos
from tests.light_changes import encode

from .raw_files import directories, dng, page

ORDERS = ("<", ">")
FULL = np.random.default_rng(2).integers(0, 256, (60, 80, 3)).astype(np.uint8)
SMALL = np.full((15, 20, 3), 90, np.uint8)


@pytest.mark.parametrize(("order", "big"), [("<", False), (">", False), ("<", True)])
@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_the_full_picture_of_a_tiff(
    order: str, old: bool, big: bool, place: int, tmp_path: Path
) -> None:
    """Oracle: the pixels and size of the only picture not marked as reduced."""
    pages = [page(SMALL, reduced=True, old=old) for _ in range(2)]
    pages.insert(place, page(FULL, reduced=False, old=old))
    path = tmp_path / "a.tif"
    path.write_bytes(directories(pages, order, big=big))
    info = read_info(path)
    assert (info.width, info.height) == (80, 60)
    np.testing.assert_array_equal(read_image(path), FULL)


def test_pages_that_are_not_called_reduced(tmp_path: Path) -> None:
    """Oracle: the first of several pages, and the only picture of a file with any mark."""
    for pages in ([page(SMALL), page(FULL)], [page(SMALL, reduced=True)]):
        (tmp_path / "a.tif").write_bytes(directories(pages, "<"))
        np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), SMALL)


@pytest.mark.parametrize("reduced", [True, None])
@pytest.mark.parametrize("big", [False, True])
def test_a_full_picture_below_the_first(reduced: bool | None, big: bool, tmp_path: Path) -> None:
    """Oracle: a refusal by name, when reading its size and its pixels."""
    tags, pixels, _, _ = page(SMALL, reduced=reduced)
    below = page(FULL, reduced=False)[0]
    made = directories([(tags, pixels, below, FULL)], "<", big=big)
    (tmp_path / "a.tif").write_bytes(made)
    for read in (read_info, read_image):
        with pytest.raises(FormatError, match=r"a\.tif begins with a reduced picture"):
            read(tmp_path / "a.tif")


def test_cameras_are_not_searched_by_reduced_pictures(tmp_path: Path) -> None:
    """Oracle: a refusal, because COLMAP reads the first picture of a file."""
    pages = [page(SMALL, reduced=True), page(FULL, reduced=False)]
    (tmp_path / "a.tif").write_bytes(directories(pages, "<"))
    with pytest.raises(DatasetError, match="which COLMAP would read"):
        read_photos(tmp_path, ["a.tif"], on_photo=lambda done: None, cancelled=lambda: False)


def test_damaged_offsets_of_a_bigtiff(tmp_path: Path) -> None:
    """Oracle: a sentence for offsets and numbers of tags beyond those of files."""
    for offset, count in ((2**64 - 1, 1), (16, 2**64 - 1), (2**62, 1)):
        head = struct.pack("<2sHHHQQ", b"II", 43, 8, 0, offset, count)
        (tmp_path / "a.tif").write_bytes(head + bytes(200))
        with pytest.raises(FormatError, match=r"a\.tif cannot be read"):
            read_image(tmp_path / "a.tif")


def _raw_photo(path: Path, *, order: str = "<", turn: int = 1, big: bool = False) -> np.ndarray:
    """A DNG of a grey ramp and an orange patch; its values, 0 to 1, [H, W, 3]."""
    meant = np.repeat(np.linspace(0.05, 0.8, 96)[None, :, None], 64, axis=0).repeat(3, axis=2)
    meant[20:40, 30:60] = (0.6, 0.3, 0.1)
    mosaic = meant[..., 1].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = meant[::2, ::2, 0], meant[1::2, 1::2, 2]
    small = np.full((16, 24, 3), 128, np.uint8)
    values = np.rint(mosaic * 65535).astype(np.uint16)
    path.write_bytes(dng(values, small, order=order, turn=turn, big=big))
    return meant


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("name", ["a.dng", "a.NEF", "a.arw", "a.tif", "a.jpg"])
def test_raw_is_refused_without_rawpy(
    name: str, order: str, big: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the file's name and a remedy; never the preview, for any ending."""
    monkeypatch.setitem(sys.modules, "rawpy", None)
    _raw_photo(tmp_path / name, order=order, big=big)
    for read in (read_info, read_image):
        with pytest.raises(FormatError, match=rf"{name} is a raw photo, .* Convert .* rawpy"):
            read(tmp_path / name)


@pytest.mark.parametrize(
    "head", [b"IIRO\x08\0\0\0", b"IIU\0\x18\0\0\0", b"FUJIFILMCCD-RAW 0201", b"\0\0\0\x18ftypcrx "]
)
def test_raw_photos_that_are_no_tiffs(head: bytes, tmp_path: Path) -> None:
    """Oracle: their first bytes; a JPEG is not raw by its ending."""
    (tmp_path / "a.orf").write_bytes(head + bytes(100))
    assert is_raw(tmp_path / "a.orf")
    Image.new("RGB", (8, 8)).save(tmp_path / "b.dng", "JPEG")
    assert not is_raw(tmp_path / "b.dng") and ".cr2" in RAW_ENDINGS


def test_canon_and_tiffs_without_a_mark(tmp_path: Path) -> None:
    """Oracle: CR2's mark behind the header, and the ending of a TIFF without marks."""
    plain = directories([page(SMALL)], "<")
    (tmp_path / "a.tif").write_bytes(plain[:8] + b"CR\2\0" + plain[12:])
    (tmp_path / "a.nef").write_bytes(plain)
    (tmp_path / "b.tif").write_bytes(plain)
    assert [is_raw(tmp_path / n) for n in ("a.tif", "a.nef", "b.tif")] == [True, True, False]


@pytest.mark.parametrize(("order", "turn"), [("<", 1), (">", 1), ("<", 6), ("<", 3), ("<", 8)])
def test_a_raw_photo_at_full_size(order: str, turn: int, tmp_path: Path) -> None:
    """Oracle: the mosaic's values by sRGB's curve (IEC 61966-2-1), and EXIF's turn."""
    pytest.importorskip("rawpy")
    meant = _raw_photo(tmp_path / "a.dng", order=order, turn=turn)
    info = read_info(tmp_path / "a.dng")
    assert (info.width, info.height, info.is_sideways) == (96, 64, turn in (6, 8))
    assert info.is_flipped == (turn == 3)
    found = read_image(tmp_path / "a.dng")
    inner = (slice(4, 16), slice(8, -8))
    curve = encode(meant)
    np.testing.assert_allclose(found[inner].mean(-1), 255 * curve[inner].mean(-1), atol=3)
    np.testing.assert_allclose(found[30, 45], 255 * curve[30, 45], atol=3)
    shape = (96, 64, 3) if turn in (6, 8) else (64, 96, 3)
    assert read_image(tmp_path / "a.dng", upright=True).shape == shape
