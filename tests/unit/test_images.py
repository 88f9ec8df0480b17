"""Images read and written; oracles: Pillow and exact averages."""

import io
import struct
import warnings
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscore.errors import DatasetError, FormatError, GsError, ShapeError
from gscore.io.images.pillow_images import pillow
from gscore.io.images.png import write_png
from gscore.io.images.read_image import read_image, read_info, read_mask, reduce, resize


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3), (6, 1, 4), (1, 1, 3), (40, 300, 3)])
def test_png_is_read_by_pillow(
    shape: tuple[int, ...], tmp_path: Path, rng: np.random.Generator
) -> None:
    """Oracle: the same bytes from our PNG in Pillow and in our reader."""
    image = rng.integers(0, 256, shape).astype(np.uint8)
    write_png(tmp_path / "x.png", image)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "x.png")), image)
    ours = read_image(tmp_path / "x.png")
    expected = np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image
    np.testing.assert_array_equal(ours, expected)


@pytest.mark.parametrize(
    "bad", [np.zeros((2, 2, 2), np.uint8), np.zeros((2, 2)), np.zeros((0, 3, 3), np.uint8)]
)
def test_png_refuses(bad: np.ndarray, tmp_path: Path) -> None:
    """Oracle: the documented shapes."""
    with pytest.raises(ShapeError, match="a PNG takes"):
        write_png(tmp_path / "x.png", bad)
    assert not (tmp_path / "x.png").exists()


@pytest.mark.parametrize(
    ("mode", "channels"),
    [("L", 3), ("1", 3), ("P", 3), ("CMYK", 3), ("LA", 4), ("RGBA", 4), ("I;16", 3)],
)
def test_modes(mode: str, channels: int, tmp_path: Path, rng: np.random.Generator) -> None:
    """Oracle: Pillow's own conversion (16 bit: the high byte, within rounding)."""
    if mode == "I;16":
        wide = rng.integers(0, 65536, (6, 8)).astype(np.uint16)
        source = Image.fromarray(wide)
        expected = np.repeat((wide / 257)[..., None], 3, axis=2)
    else:
        base = Image.fromarray(rng.integers(0, 256, (6, 8, 4)).astype(np.uint8), "RGBA")
        source = base.convert(mode) if mode != "P" else base.convert("RGB").quantize(16)
        expected = np.asarray(source.convert("RGBA" if channels == 4 else "RGB"), float)
    path = tmp_path / ("x.tif" if mode in ("CMYK", "I;16") else "x.png")
    source.save(path)
    image = read_image(path)
    assert image.shape == (6, 8, channels)
    assert image.dtype == np.uint8 and image.flags.c_contiguous
    np.testing.assert_allclose(image, expected, atol=0.51)
    assert read_info(path)[:3] == (8, 6, channels == 4)


def test_palette_with_transparency(tmp_path: Path) -> None:
    """Oracle: the colour and alpha written by hand."""
    image = Image.new("P", (3, 2), 1)
    image.putpalette([0, 0, 0, 10, 200, 30])
    image.putpixel((0, 0), 0)
    image.save(tmp_path / "x.png", transparency=0)
    read = read_image(tmp_path / "x.png")
    assert read_info(tmp_path / "x.png").has_alpha
    assert read[0, 0, 3] == 0
    assert read[1, 1].tolist() == [10, 200, 30, 255]


def test_exif_is_ignored_unless_asked(tmp_path: Path) -> None:
    """Oracle: pixels as stored, as in COLMAP; orientation 6 means 'turn clockwise to show'."""
    stored = np.zeros((16, 32, 3), np.uint8)
    stored[:, :16] = 250
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(stored).save(tmp_path / "x.jpg", exif=exif, quality=95)
    assert read_info(tmp_path / "x.jpg") == (32, 16, False, 6)
    assert read_image(tmp_path / "x.jpg").shape == (16, 32, 3)
    upright = read_image(tmp_path / "x.jpg", upright=True)
    assert upright.shape == (32, 16, 3)
    assert upright[:14].mean() > 230 and upright[18:].mean() < 20


def test_masks(tmp_path: Path) -> None:
    """Oracle: values written by hand; 0/1 labels are stretched, varying alpha has precedence."""
    soft = np.array([[0, 100], [200, 255]], np.uint8)
    Image.fromarray(soft).save(tmp_path / "soft.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "soft.png"), soft)
    Image.fromarray((soft > 150).astype(np.uint8)).save(tmp_path / "labels.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "labels.png"), [[0, 0], [255, 255]])
    Image.fromarray(soft > 150).save(tmp_path / "bits.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "bits.png"), [[0, 0], [255, 255]])
    rgba = np.dstack([np.full((2, 2, 3), 255, np.uint8), soft])
    Image.fromarray(rgba).save(tmp_path / "alpha.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "alpha.png"), soft)


@pytest.mark.parametrize(("width", "height"), [(12, 8), (6, 4), (3, 2), (1, 1)])
def test_whole_factors_are_exact_means(width: int, height: int, rng: np.random.Generator) -> None:
    """Oracle: the mean of the covered pixels, computed by reshaping."""
    image = rng.integers(0, 256, (8, 12, 3)).astype(np.uint8)
    blocks = image.reshape(height, 8 // height, width, 12 // width, 3).astype(float)
    small = resize(image, width, height)
    assert small.flags.c_contiguous
    np.testing.assert_allclose(small, blocks.mean(axis=(1, 3)), atol=0.6)


def test_other_factors_keep_positions() -> None:
    """Oracle: a linear ramp, which stays the same function of the pixel-centre position in [0,
    1]."""
    ramp = np.tile(np.rint((np.arange(101) + 0.5) / 101 * 250), (67, 1)).astype(np.uint8)
    small = resize(ramp, 37, 29)
    expected = (np.arange(37) + 0.5) / 37 * 250
    np.testing.assert_allclose(small[:, 2:-2], np.tile(expected, (29, 1))[:, 2:-2], atol=1)


def test_no_ringing() -> None:
    """Oracle: an edge between two values, which stays between them."""
    edge = np.where(np.arange(100) < 53, 40, 200).astype(np.uint8)
    small = resize(np.tile(edge, (100, 1)), 37, 41)
    assert small.min() == 40 and small.max() == 200


def test_hidden_colors_do_not_bleed() -> None:
    """Oracle: half-transparent red from red next to transparent green."""
    image = np.zeros((2, 2, 4), np.uint8)
    image[:, 0] = [255, 0, 0, 255]
    image[:, 1] = [0, 255, 0, 0]
    assert resize(image, 1, 1)[0, 0].tolist() == [255, 0, 0, 128]


def test_resize_refuses_to_enlarge() -> None:
    """Oracle: the documented limits."""
    with pytest.raises(ShapeError, match="resize takes"):
        resize(np.zeros((4, 4), np.uint8), 5, 4)


def test_reduce_averages_blocks(rng: np.random.Generator) -> None:
    """Oracle: means of blocks; the last ones are narrower."""
    image = rng.integers(0, 256, (7, 10)).astype(np.uint8)
    small = reduce(image, 3)
    assert small.shape == (3, 4)
    for row in range(3):
        for column in range(4):
            block = image[3 * row : 3 * row + 3, 3 * column : 3 * column + 3]
            assert abs(small[row, column] - block.mean()) <= 0.7


@pytest.mark.filterwarnings("ignore::UserWarning")  # Pillow warns about damaged TIFF
@pytest.mark.parametrize("kind", ["PNG", "JPEG", "TIFF", "BMP", "WEBP"])
def test_hostile(kind: str, mutations: Callable[[bytes], Iterator[bytes]], tmp_path: Path) -> None:
    """Oracle: an image or one of our errors, for a damaged file; no other exception."""
    buffer = io.BytesIO()
    ramp = (np.mgrid[0:24, 0:16].sum(axis=0) * 6).astype(np.uint8)
    Image.fromarray(np.dstack([ramp] * 3)).save(buffer, kind)
    path, refused = tmp_path / "x.img", 0
    for raw in mutations(buffer.getvalue()):
        path.write_bytes(raw)
        try:
            read_info(path)
            assert read_image(path).dtype == np.uint8
        except GsError as error:
            assert str(path) in str(error)
            refused += 1
    assert refused > 20


def test_huge_size_is_refused(tmp_path: Path) -> None:
    """Oracle: a header of 60000 x 60000 pixels without data."""
    head = struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0)
    chunk = struct.pack(">I", 13) + b"IHDR" + head + struct.pack(">I", zlib.crc32(b"IHDR" + head))
    (tmp_path / "x.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunk)
    with pytest.raises(FormatError, match="cannot be read as an image"):
        read_image(tmp_path / "x.png")


def test_large_photos_are_no_reason_to_warn(tmp_path: Path) -> None:
    """Oracle: 175 megapixels, within Pillow's limit and above the half from which it warns."""
    head = struct.pack(">IIBBBBB", 14000, 12500, 8, 2, 0, 0, 0)
    chunk = struct.pack(">I", 13) + b"IHDR" + head + struct.pack(">I", zlib.crc32(b"IHDR" + head))
    (tmp_path / "x.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunk)
    with warnings.catch_warnings(record=True) as reported:
        warnings.simplefilter("always")
        pillow.cache_clear()
        with pytest.raises(FormatError, match="cannot be read as an image"):
            read_image(tmp_path / "x.png")
    pillow.cache_clear()
    assert not reported


def test_messages(tmp_path: Path) -> None:
    """Oracle: the error, its place and a remedy."""
    with pytest.raises(DatasetError, match=r"There is no image .*none\.png"):
        read_image(tmp_path / "none.png")
    (tmp_path / "text.png").write_text("hello")
    with pytest.raises(FormatError, match=r"text\.png cannot be read as an image.*Copy the file"):
        read_image(tmp_path / "text.png")
