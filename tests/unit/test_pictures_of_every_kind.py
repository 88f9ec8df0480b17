"""Pictures of every kind, read as intended or refused with a message; oracle: numbers by hand."""

import io
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscore.errors import FormatError
from gscore.io.images.pillow_images import MOST_PIXELS
from gscore.io.images.png import write_png
from gscore.io.images.read_image import mask_assumption, read_image, read_info, read_mask
from gscore.io.images.truncated_images import missing_blocks

from .png_files import png
from .tiff_files import tiff

RAMP = np.arange(48, dtype=np.float64).reshape(6, 8) / 47
"""[6, 8] from black to white."""
BYTES = np.rint(RAMP * 255)
ORDERS = ("<", ">")


def grey(path: Path) -> np.ndarray:
    image = read_image(path)
    assert image.shape == (6, 8, 3) and image.dtype == np.uint8
    assert (image == image[..., :1]).all()
    return image[..., 0].astype(float)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("kind", "white"), [("u1", 255), ("u2", 65535), ("f4", 1.0)])
@pytest.mark.parametrize("photometric", [0, 1])
def test_grey_tiff(order: str, kind: str, white: float, photometric: int, tmp_path: Path) -> None:
    """Oracle: the ramp; inverted values where zero is white."""
    meant = RAMP if photometric else 1 - RAMP
    values = meant * white if kind == "f4" else np.rint(meant * white)
    (tmp_path / "a.tif").write_bytes(tiff(values.astype(order + kind), photometric=photometric))
    try:
        found = grey(tmp_path / "a.tif")
    except FormatError as error:  # a kind unknown to Pillow
        assert (order, kind, photometric) == (">", "u2", 0) and "is not supported" in str(error)
    else:
        np.testing.assert_allclose(found, BYTES, atol=0.51)


@pytest.mark.parametrize("order", ORDERS)
def test_colour_tiff_of_16_bits(order: str, tmp_path: Path) -> None:
    """Oracle: the ramp in three channels, within the step of Pillow's truncation."""
    values = np.rint(np.dstack([RAMP, RAMP[::-1], RAMP * 0.5]) * 65535)
    (tmp_path / "a.tif").write_bytes(tiff(values.astype(order + "u2"), photometric=2))
    np.testing.assert_allclose(read_image(tmp_path / "a.tif"), values / 257, atol=1.01)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("i2", RAMP * 65535 - 32768),
        ("i4", RAMP * 255),
        ("u4", RAMP * 255),
        ("i4", RAMP * 1e6),
        ("f4", RAMP * 255),
        ("f4", RAMP - 0.5),
        ("f4", RAMP * np.nan),
        ("f8", RAMP),
        ("f2", RAMP),
    ],
)
def test_numbers_whose_white_is_unknown(
    order: str, kind: str, values: np.ndarray, tmp_path: Path
) -> None:
    """Oracle: a refusal by name; the pictures would be black, clipped or wrapped."""
    (tmp_path / "a.tif").write_bytes(tiff(values.astype(order + kind)))
    with pytest.raises(FormatError, match=r"a\.tif (has|cannot be read)"):
        read_image(tmp_path / "a.tif")


def test_floats_of_several_channels_are_refused(tmp_path: Path) -> None:
    """Oracle: a kind unknown to Pillow; the sentence lists the supported ones."""
    values = np.dstack([RAMP] * 3).astype("<f4")
    (tmp_path / "a.tif").write_bytes(tiff(values, photometric=2))
    with pytest.raises(
        FormatError, match=r"a\.tif cannot be read .*TIFF with 8 or 16 bits or grey"
    ):
        read_image(tmp_path / "a.tif")


@pytest.mark.parametrize("scale", [1, 255, 4095])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_few_bits_in_16(scale: int, channels: int, tmp_path: Path) -> None:
    """Oracle: a refusal of 1, 8 or 12 unscaled bits, which would be black."""
    values = np.repeat(np.rint(RAMP * scale)[..., None], channels, axis=2).astype(np.uint16)
    values[..., 3:] = 65535
    (tmp_path / "a.png").write_bytes(png(values[..., 0] if channels == 1 else values))
    with pytest.raises(FormatError, match=r"a\.png has 16 bits .* so that white is 65535"):
        read_image(tmp_path / "a.png")


def test_16_bits_with_transparency(tmp_path: Path) -> None:
    """Oracle: keyed grey, alpha channels, and a keyed colour that loses 8 bits."""
    values = np.rint(RAMP * 65535).astype(np.uint16)
    (tmp_path / "key.png").write_bytes(png(values, key=(int(values[2, 3]),)))
    image = read_image(tmp_path / "key.png")
    assert read_info(tmp_path / "key.png").has_alpha and image.shape == (6, 8, 4)
    assert image[2, 3, 3] == 0 and (image[..., 3] == 0).sum() == 1
    np.testing.assert_array_equal(image[..., 0], BYTES)
    for name, channels in (("la.png", [values, values]), ("rgba.png", [values] * 4)):
        (tmp_path / name).write_bytes(png(np.dstack(channels)))
        image = read_image(tmp_path / name)
        np.testing.assert_allclose(image[..., 3], BYTES, atol=1.01)
    (tmp_path / "colour.png").write_bytes(png(np.dstack([values] * 3), key=(300, 300, 300)))
    with pytest.raises(FormatError, match=r"colour\.png .* one transparent colour"):
        read_image(tmp_path / "colour.png")


@pytest.mark.parametrize(("orientation", "turns"), [(3, 2), (6, -1), (8, 1)])
def test_16_bits_are_turned_too(orientation: int, turns: int, tmp_path: Path) -> None:
    """Oracle: the ramp turned by numpy as EXIF states."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    image = Image.fromarray(np.rint(RAMP * 65535).astype(np.uint16))
    image.save(tmp_path / "a.png", exif=exif)
    found = read_image(tmp_path / "a.png", upright=True)[..., 0]
    np.testing.assert_array_equal(found, np.rot90(BYTES, turns))


@pytest.mark.parametrize(("maxval", "kind"), [(255, "u1"), (1023, ">u2"), (65535, ">u2")])
def test_pnm(maxval: int, kind: str, tmp_path: Path) -> None:
    """Oracle: the ramp over the maximum in the header."""
    values = np.rint(RAMP * maxval).astype(kind)
    head = f"P5 8 6 {maxval}\n".encode()
    (tmp_path / "a.pgm").write_bytes(head + values.tobytes())
    np.testing.assert_allclose(grey(tmp_path / "a.pgm"), BYTES, atol=1)


def test_the_first_of_several_pictures_is_read(tmp_path: Path) -> None:
    """Oracle: the written frames; COLMAP uses the first one too."""
    frames = [Image.new("RGB", (8, 6), color) for color in ("#c00000", "#00c000")]
    for name in ("a.webp", "a.png", "a.tif"):
        options = {"lossless": True} if name == "a.webp" else {}
        frames[0].save(tmp_path / name, save_all=True, append_images=frames[1:], **options)
        image = read_image(tmp_path / name)
        assert image.shape[:2] == (6, 8) and (image[..., :3] == [0xC0, 0, 0]).all()
    frames[0].save(tmp_path / "a.jpg", "MPO", save_all=True, append_images=frames[1:], quality=95)
    np.testing.assert_allclose(read_image(tmp_path / "a.jpg")[0, 0], [0xC0, 0, 0], atol=3)


def test_colour_profiles_change_nothing(tmp_path: Path) -> None:
    """Oracle: the written bytes; values are used unchanged, as in COLMAP and 3DGS."""
    from PIL import ImageCms

    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes()
    image = np.dstack([BYTES] * 3).astype(np.uint8)
    Image.fromarray(image).save(tmp_path / "a.png", icc_profile=profile)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), image)


LABELS = np.zeros((6, 8))
LABELS[2:5, 3:] = 1
KEEP = (LABELS * 255).astype(np.uint8)


def _palette(path: Path) -> None:
    image = Image.fromarray(LABELS.astype(np.uint8)).convert("P")
    image.putpalette([0, 0, 0, 128, 0, 0])  # as label editors colour their first class
    image.save(path)


@pytest.mark.parametrize("top", [1, 2, 128, 254])
def test_masks_of_labels(top: int, tmp_path: Path) -> None:
    """Oracle: yes and no, for any number that means yes, and the sentence about it."""
    write_png(tmp_path / "grey.png", (LABELS * top).astype(np.uint8))
    write_png(tmp_path / "colour.png", np.dstack([(LABELS * top).astype(np.uint8)] * 3))
    (tmp_path / "deep.png").write_bytes(png((LABELS * top).astype(np.uint16)))
    for kind in ("<u2", ">u2", "<i4", ">i4", "<f4", ">f4"):
        (tmp_path / f"{kind[1:]}{ord(kind[0])}.tif").write_bytes(tiff((LABELS * top).astype(kind)))
    for path in sorted(tmp_path.iterdir()):
        np.testing.assert_array_equal(read_mask(path), KEEP, err_msg=path.name)
        assumed = mask_assumption(path)
        if top == 1 and path.name.startswith("f4"):
            assert assumed == ""  # floats from 0 to 1 are unambiguous
        else:
            assert assumed == f"contain only 0 and {top}; {top} is read as white"


def test_masks_of_yes_and_no(tmp_path: Path) -> None:
    """Oracle: the same in unambiguous kinds, and in a palette's colours."""
    Image.fromarray(LABELS > 0).save(tmp_path / "bits.png")
    write_png(tmp_path / "bytes.png", KEEP)
    (tmp_path / "deep.png").write_bytes(png((LABELS * 65535).astype(np.uint16)))
    for path in sorted(tmp_path.iterdir()):
        np.testing.assert_array_equal(read_mask(path), KEEP, err_msg=path.name)
        assert mask_assumption(path) == ""
    _palette(tmp_path / "palette.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "palette.png"), KEEP)
    write_png(tmp_path / "none.png", np.zeros((6, 8), np.uint8))
    write_png(tmp_path / "all.png", np.ones((6, 8), np.uint8))
    assert not read_mask(tmp_path / "none.png").any()
    assert (read_mask(tmp_path / "all.png") == 255).all()


@pytest.mark.parametrize("order", ORDERS)
def test_soft_masks(order: str, tmp_path: Path) -> None:
    """Oracle: the ramp in 16 bits and in floats; numbers out of range are refused."""
    for kind, white in (("u2", 65535), ("f4", 1)):
        (tmp_path / "a.tif").write_bytes(tiff((RAMP * white).astype(order + kind)))
        np.testing.assert_allclose(read_mask(tmp_path / "a.tif"), BYTES, atol=1)
    for kind in ("f4", "i4", "u2"):
        (tmp_path / "b.tif").write_bytes(tiff((RAMP * 255).astype(order + kind)))
        with pytest.raises(FormatError, match=r"b\.tif has"):
            read_mask(tmp_path / "b.tif")


def test_deep_colour_masks(tmp_path: Path) -> None:
    """Oracle: a refusal of 0 and 1 in 16-bit colour, which become 0."""
    (tmp_path / "a.png").write_bytes(png(np.dstack([LABELS] * 3).astype(np.uint16)))
    with pytest.raises(FormatError, match=r"a\.png has 16 bits per channel but is nearly black"):
        read_mask(tmp_path / "a.png")


def noise(height: int = 72, width: int = 96) -> np.ndarray:
    return np.random.default_rng(4).integers(60, 200, (height, width, 3)).astype(np.uint8)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_png_with_fewer_rows(channels: int, tmp_path: Path) -> None:
    """Oracle: 10 of the 72 rows stated in the header, in an otherwise valid file."""
    values = np.dstack([noise()[..., :1]] * channels)[:10].squeeze()
    (tmp_path / "a.png").write_bytes(png(values, height=72))
    for read in (read_image, read_mask):
        with pytest.raises(FormatError, match=r"a\.png .*cut short, \d+ of \d+ bytes"):
            read(tmp_path / "a.png")


def test_png_that_ends_in_black_is_whole(tmp_path: Path) -> None:
    """Oracle: black pixels in the file; one row less is a truncation."""
    values = noise()
    values[40:] = 0
    for kind in ("L", "P", "1", "RGB", "RGBA", "LA", "I;16"):
        image = Image.fromarray(values)
        if kind == "I;16":
            image = Image.fromarray((values[..., 0] * np.uint16(257)).astype(np.uint16))
        else:
            image = image.convert(kind)
        image.save(tmp_path / "a.png")
        assert read_image(tmp_path / "a.png").shape[:2] == (72, 96)
    (tmp_path / "a.png").write_bytes(png(values[:71], height=72))
    with pytest.raises(FormatError, match="cut short"):
        read_image(tmp_path / "a.png")


def test_interlaced_png(tmp_path: Path) -> None:
    """Oracle: 1 x 1 to 9 x 9 pixels in Adam7's order, written by hand; whole, and one row short."""
    import zlib

    passes = [(0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2)]
    passes.append((0, 1, 1, 2))
    for height, width in ((1, 1), (2, 3), (5, 4), (8, 8), (9, 9)):
        values = noise(height, width)
        rows = [
            b"\0" + row.tobytes()
            for left, top, across, down in passes
            for row in values[top::down, left::across]
            if row.size
        ]
        for keep in (len(rows), len(rows) - 1):
            raw = bytearray(png(values, packed=zlib.compress(b"".join(rows[:keep]))))
            raw[28] = 1  # interlaced
            raw[29:33] = struct.pack(">I", zlib.crc32(raw[12:29]))
            (tmp_path / "a.png").write_bytes(raw)
            if keep == len(rows):
                np.testing.assert_array_equal(read_image(tmp_path / "a.png"), values)
                continue
            with pytest.raises(FormatError, match=r"a\.png cannot be read"):
                read_image(tmp_path / "a.png")


def jpeg(image: np.ndarray, **options: object) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "JPEG", **options)
    return buffer.getvalue()


@pytest.mark.parametrize("restart", [0, 5])
@pytest.mark.parametrize("subsampling", [0, 2])
@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("lost", [1, 2])
def test_jpeg_without_its_end_marker(
    lost: int,
    colour: bool,
    subsampling: int,
    restart: int,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Oracle: the whole file without all or half of its end marker: the same pixels and one
    warning. With blocks missing too, and where blocks are not counted (progressive), it is
    refused."""
    image = noise() if colour else noise()[..., 0]
    raw = jpeg(image, subsampling=subsampling, restart_marker_blocks=restart)
    path = tmp_path / "a.jpg"
    path.write_bytes(raw)
    whole = read_image(path)
    path.write_bytes(raw[:-lost])
    for _ in range(2):
        assert (read_image(path) == whole).all()
    assert caplog.text.count("The last bytes of") == 1 and "a.jpg" in caplog.text
    path.write_bytes(raw[: -len(raw) // 3])
    with pytest.raises(FormatError, match=r"a\.jpg cannot be read"):
        read_image(path)
    path.write_bytes(jpeg(image, progressive=True)[:-lost])
    with pytest.raises(FormatError, match=r"a\.jpg cannot be read"):
        read_image(path)


@pytest.mark.parametrize("optimize", [False, True])
@pytest.mark.parametrize("restart", [0, 1, 5])
@pytest.mark.parametrize("subsampling", [0, 1, 2])
@pytest.mark.parametrize("colour", [False, True])
def test_jpeg_with_fewer_rows(
    optimize: bool, restart: int, subsampling: int, colour: bool, tmp_path: Path
) -> None:
    """Oracle: a JPEG of 16 rows with a header of 72, and the whole one of 72 rows, which ends in
    the grey that libjpeg uses for missing data."""
    options = {"optimize": optimize, "subsampling": subsampling, "restart_marker_blocks": restart}
    image = noise()
    image[60:] = 128
    image = image if colour else image[..., 0]
    path = tmp_path / "a.jpg"
    path.write_bytes(jpeg(image, **options))
    assert missing_blocks(path) == 0
    assert (read_image(path)[-1, -1] == 128).all()
    raw = jpeg(image[:16], **options)
    frame = raw.index(b"\xff\xc0") + 5
    path.write_bytes(raw[:frame] + struct.pack(">H", 72) + raw[frame + 2 :])
    wide, tall = (8, 8) if not colour or subsampling == 0 else (16, 16 if subsampling == 2 else 8)
    lacking = -(-96 // wide) * (-(-72 // tall) - 16 // tall)
    assert missing_blocks(path) in (lacking - 1, lacking)  # byte padding may resemble codes
    with pytest.raises(FormatError, match=r"a\.jpg .*cut short, \d+ of its blocks are missing"):
        read_image(path)


@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_files_that_end_early(share: float, tmp_path: Path) -> None:
    """Oracle: the first part of a file of each kind, as left by an interrupted copy."""
    image = Image.fromarray(noise())
    kinds = {"a.png": {}, "a.jpg": {}, "a.webp": {"lossless": True}, "b.webp": {}, "a.bmp": {}}
    kinds |= {"a.tga": {}, "b.tga": {"compression": "tga_rle"}, "a.ppm": {}, "a.tif": {}}
    kinds |= {"b.jpg": {"progressive": True}}
    kinds |= {f"{c}.tif": {"compression": c} for c in ("tiff_lzw", "tiff_adobe_deflate", "jpeg")}
    for name, options in kinds.items():
        path = tmp_path / name
        image.save(path, **options)
        raw = path.read_bytes()
        read_image(path)
        path.write_bytes(raw[: int(share * len(raw))])
        with pytest.raises(FormatError, match=path.name.replace(".", r"\.")):
            read_image(path)
    cut = (tmp_path / "a.jpg").read_bytes() + b"\xff\xd9"  # closed properly
    (tmp_path / "a.jpg").write_bytes(cut)
    with pytest.raises(FormatError, match=r"a\.jpg .*blocks are missing"):
        read_image(tmp_path / "a.jpg")


def test_tiff_with_fewer_bytes_than_pixels(tmp_path: Path) -> None:
    """Oracle: a strip that states 10 of its 72 rows; the bytes after it are no picture."""
    raw = tiff(noise(), photometric=2, stated_bytes=10 * 96 * 3)
    (tmp_path / "a.tif").write_bytes(raw)
    with pytest.raises(FormatError, match=r"a\.tif .*cut short, 2880 of 20736 bytes"):
        read_image(tmp_path / "a.tif")
    (tmp_path / "a.tif").write_bytes(tiff(noise(), photometric=2))
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), noise())


def _bmp(width: int, height: int) -> bytes:
    head = struct.pack("<2sIHHI", b"BM", 54, 0, 0, 54)
    return head + struct.pack("<IiiHHIIiiII", 40, width, height, 1, 24, 0, 0, 0, 0, 0, 0)


def test_absurd_sizes(tmp_path: Path) -> None:
    """Oracle: headers of 60,000 x 60,000 px; a sentence with file, size and limit, and no
    allocation."""
    import tracemalloc

    tiny = jpeg(noise(8, 8))
    frame = tiny.index(b"\xff\xc0") + 5
    absurd = {
        "a.png": png(noise(2, 2)).replace(
            struct.pack(">II", 2, 2), struct.pack(">II", 60000, 60000)
        ),
        "a.jpg": tiny[:frame] + struct.pack(">HH", 60000, 60000) + tiny[frame + 4 :],
        "a.bmp": _bmp(60000, 60000),
        "a.ppm": b"P6 60000 60000 255\n",
        "a.tga": struct.pack("<BBBHHBHHHHBB", 0, 0, 2, 0, 0, 0, 0, 0, 60000, 60000, 24, 0),
        "a.tif": tiff(np.zeros((2, 2, 3), np.uint8), photometric=2),
    }
    raw = bytearray(absurd["a.tif"])
    for tag in (256, 257):
        at = raw.index(struct.pack("<HHI", tag, 4, 1)) + 8
        raw[at : at + 4] = struct.pack("<I", 60000)
    absurd["a.tif"] = bytes(raw)
    sizes = r"(60000 x 60000|3,600,000,000) pixels in \d+ bytes: .* more than 178,956,970"
    tracemalloc.start()
    for name, content in absurd.items():
        path = tmp_path / name
        path.write_bytes(content)
        for read in (read_info, read_image, read_mask):
            with pytest.raises(FormatError, match=rf"{path.name} states a size of {sizes}"):
                read(path)
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()
    assert MOST_PIXELS == 178_956_970


@pytest.mark.parametrize("ending", ["jpg", "png", "tif", "bmp", "ppm", "tga", "webp"])
def test_pictures_beyond_pillows_limit_are_read(
    ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the pixels read below the limit; beyond it Pillow's own limit, which a host may rely
    on, is unchanged, and a picture too large for the memory is refused with numbers."""
    path = tmp_path / f"a.{ending}"
    Image.fromarray(noise(64, 80)).save(path)
    wanted = read_image(path)
    monkeypatch.setattr("gscore.io.images.pillow_images.MOST_PIXELS", 1000)
    monkeypatch.setattr("PIL.Image.MAX_IMAGE_PIXELS", 500)
    np.testing.assert_array_equal(read_image(path), wanted)
    assert read_info(path)[:2] == wanted.shape[1::-1]
    assert Image.MAX_IMAGE_PIXELS == 500
    monkeypatch.setattr("gscore.io.images.pillow_images.available_memory_bytes", lambda: 20_000)
    with pytest.raises(
        FormatError, match=r"pixels, for which .* GB of memory are needed, but 0\.0"
    ):
        read_image(path)


@pytest.mark.parametrize(
    ("ending", "options"), [("png", {}), ("tif", {"compression": "tiff_deflate"})]
)
def test_a_decompression_bomb_is_refused(ending: str, options: dict, tmp_path: Path) -> None:
    """Oracle: 196 million pixels of one colour, in some hundred kilobytes."""
    path, side = tmp_path / f"a.{ending}", 14_000
    Image.new("L", (side, side)).save(path, **options)
    assert path.stat().st_size < 1e6
    for read in (read_info, read_image, read_mask):
        with pytest.raises(FormatError, match="large enough for a photo"):
            read(path)


def test_too_little_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: an allocation that fails while pixels are decoded, reported with the file's name."""
    write_png(tmp_path / "a.png", noise())

    def fails(self: Image.Image) -> None:
        raise MemoryError

    monkeypatch.setattr("PIL.PngImagePlugin.PngImageFile.load", fails)
    with pytest.raises(FormatError, match=r"a\.png does not fit into memory"):
        read_image(tmp_path / "a.png")
