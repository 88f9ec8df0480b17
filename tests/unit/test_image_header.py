"""Headers read with the standard library against Pillow."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, PngImagePlugin

from gscore.io.images.image_header import ImageInfo, read_header


def by_pillow(path: Path) -> ImageInfo:
    """Size and orientation by Pillow."""
    with Image.open(path) as image:
        alpha = image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info
        turn = image.getexif().get(0x0112, 1)
        return ImageInfo(image.width, image.height, alpha, turn)


@pytest.fixture
def picture(rng: np.random.Generator) -> Image.Image:
    """Seven by five pixels of noise."""
    return Image.fromarray(rng.integers(0, 256, (5, 7, 4)).astype(np.uint8), "RGBA")


@pytest.mark.parametrize("mode", ["1", "L", "P", "RGB", "RGBA", "LA", "I;16"])
def test_png_modes(mode: str, picture: Image.Image, tmp_path: Path) -> None:
    """Oracle: Pillow."""
    path = tmp_path / "x.png"
    if mode == "I;16":
        Image.fromarray(np.zeros((5, 7), np.uint16)).save(path)
    else:
        picture.convert(mode).save(path)
    assert read_header(path) == by_pillow(path)


def test_png_palette_with_transparency(picture: Image.Image, tmp_path: Path) -> None:
    """Oracle: Pillow."""
    path = tmp_path / "x.png"
    picture.convert("RGB").quantize(8).save(path, transparency=3)
    assert read_header(path) == by_pillow(path)
    assert by_pillow(path).has_alpha


@pytest.mark.parametrize("turn", range(1, 9))
@pytest.mark.parametrize("ending", ["jpg", "png"])
def test_exif(ending: str, turn: int, picture: Image.Image, tmp_path: Path) -> None:
    """Oracle: Pillow, for every value of the tag."""
    exif = Image.Exif()
    exif[0x010F] = "maker"
    exif[0x0112] = turn
    path = tmp_path / f"x.{ending}"
    picture.convert("RGB").save(path, exif=exif)
    assert read_header(path) == by_pillow(path)
    assert by_pillow(path).is_sideways == (turn >= 5)


def test_xmp_turns_where_exif_is_silent(picture: Image.Image, tmp_path: Path) -> None:
    """Oracle: Pillow."""
    xmp = '<x:xmpmeta><rdf:Description tiff:Orientation="6"/></x:xmpmeta>'
    info = PngImagePlugin.PngInfo()
    info.add_itxt("XML:com.adobe.xmp", xmp)
    picture.convert("RGB").save(tmp_path / "x.png", pnginfo=info)
    picture.convert("RGB").save(tmp_path / "x.jpg", xmp=xmp.encode())
    for name in ("x.png", "x.jpg"):
        assert read_header(tmp_path / name) == by_pillow(tmp_path / name)
        assert by_pillow(tmp_path / name).is_sideways


@pytest.mark.parametrize("mode", ["L", "RGB", "CMYK"])
@pytest.mark.parametrize("progressive", [False, True])
def test_jpeg_kinds(mode: str, progressive: bool, picture: Image.Image, tmp_path: Path) -> None:
    """Oracle: Pillow."""
    path = tmp_path / "x.jpg"
    picture.convert(mode).save(path, progressive=progressive)
    assert read_header(path) == by_pillow(path)


def test_other_and_damaged_files_give_nothing(picture: Image.Image, tmp_path: Path) -> None:
    """Oracle: the documented None, for a cut at every place of a file."""
    assert read_header(tmp_path / "none.png") is None
    (tmp_path / "x.tif").write_bytes(b"II*\0 rest")
    assert read_header(tmp_path / "x.tif") is None
    for name in ("x.png", "x.jpg"):
        picture.convert("RGB").save(tmp_path / name)
        data = (tmp_path / name).read_bytes()
        whole = read_header(tmp_path / name)
        for end in range(len(data)):
            (tmp_path / "cut").write_bytes(data[:end])
            assert read_header(tmp_path / "cut") in (None, whole)
