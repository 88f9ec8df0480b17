"""Depth maps in every file format, and files that are none."""

import sys
import unicodedata

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from gscore.depth.maps import DepthKind, MapFolder, read_map, sample, stem, to_inverse
from gscore.errors import BackendError, DatasetError, FormatError
from tests.unit.png_files import chunk


def _write_exr(path, channels):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))


@pytest.fixture
def ramp():
    """[5, 7] uint16 of all sizes of numbers."""
    return np.linspace(0, 65535, 35).round().astype(np.uint16).reshape(5, 7)


def test_16_bit_png(tmp_path, ramp):
    """Oracle: value / 65536, as the official loader divides."""
    Image.fromarray(ramp).save(tmp_path / "a.png")
    assert np.array_equal(read_map(tmp_path / "a.png"), (ramp / 65536).astype(np.float32))


def test_8_bit_png(tmp_path, ramp):
    """Oracle: the same divisor, so that scales of official tools fit maps of 8 bits."""
    grey = (ramp >> 8).astype(np.uint8)
    Image.fromarray(grey).save(tmp_path / "a.png")
    Image.fromarray(np.repeat(grey[..., None], 3, 2)).save(tmp_path / "b.png")
    Image.fromarray(np.repeat(grey[..., None], 4, 2), "RGBA").save(tmp_path / "c.png")
    Image.fromarray(np.dstack([grey, grey]), "LA").save(tmp_path / "d.png")
    for name in "abcd":
        assert np.array_equal(read_map(tmp_path / f"{name}.png"), grey.astype(np.float32) / 65536)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.uint16, np.int32])
def test_npy_and_tiff(tmp_path, dtype, ramp):
    """Oracle: the saved numbers; arrays may also have sides of 1."""
    values = (ramp % 1000).astype(dtype)
    np.save(tmp_path / "a.npy", values)
    np.save(tmp_path / "b.npy", values[None, ..., None])
    for name in "ab":
        back = read_map(tmp_path / f"{name}.npy")
        assert back.dtype == np.float32 and np.array_equal(back, values.astype(np.float32))
    if dtype in (np.float32, np.uint16, np.int32):
        Image.fromarray(values).save(tmp_path / "a.tif")
        assert np.array_equal(read_map(tmp_path / "a.tif"), values.astype(np.float32))


@pytest.mark.parametrize(
    "names",
    [
        ["Z"],
        ["R", "G", "B", "Z"],
        ["ViewLayer.Depth.Z", "ViewLayer.Combined.R", "ViewLayer.Normal.Z"],
        ["Depth.V"],
        ["Y"],
        ["depth"],
        ["anything"],
    ],
)
@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_exr_channels(tmp_path, names, dtype, ramp):
    """Oracle: depth in the channel used by Blender and others, other numbers elsewhere."""
    depth = (ramp / 4096).astype(dtype)
    depth[0, 0] = 1e10 if dtype == np.float32 else np.inf  # no surface
    right = next((n for n in names if "epth" in n), None)
    right = right or ("Z" if "Z" in names else names[0])
    channels = {n: depth if n == right else np.full_like(depth, 7) for n in names}
    _write_exr(tmp_path / "a.exr", channels)
    back = read_map(tmp_path / "a.exr")
    assert np.isnan(back[0, 0])
    assert np.array_equal(back.ravel()[1:], depth.ravel()[1:].astype(np.float32))


def test_exr_in_equal_colours(tmp_path):
    """Oracle: one map from equal R, G and B; none from three different ones."""
    depth = np.linspace(1, 2, 12, dtype=np.float32).reshape(3, 4)
    _write_exr(tmp_path / "a.exr", dict.fromkeys("RGB", depth))
    assert np.array_equal(read_map(tmp_path / "a.exr"), depth)
    _write_exr(tmp_path / "b.exr", {"R": depth, "G": depth + 1, "B": depth})
    with pytest.raises(FormatError, match=r"channels B, G, R.*expected a depth channel Z"):
        read_map(tmp_path / "b.exr")


def test_exr_without_the_package(tmp_path, monkeypatch):
    """Oracle: an error with the package to install and the alternatives."""
    (tmp_path / "a.exr").write_bytes(b"v/1\x01")
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(BackendError, match=r'pip install "gscore\[depth\]". Or save .* NPY'):
        read_map(tmp_path / "a.exr")


@pytest.mark.parametrize("ending", [".png", ".npy", ".exr", ".tif"])
@pytest.mark.parametrize("content", [b"", b"rubbish", b"\x89PNG\r\n\x1a\n123"])
def test_damaged_files(tmp_path, ending, content):
    """Oracle: a FormatError with the name of the file."""
    path = tmp_path / f"map{ending}"
    path.write_bytes(content)
    with pytest.raises(FormatError, match=rf"map\{ending}"):
        read_map(path)


def test_truncated_files(tmp_path, ramp):
    """Oracle: a FormatError for the first half of good files."""
    big = np.tile(ramp, (20, 20))
    Image.fromarray(big).save(tmp_path / "a.png")
    np.save(tmp_path / "a.npy", big)
    _write_exr(tmp_path / "a.exr", {"Z": big.astype(np.float32)})
    for path in sorted(tmp_path.iterdir()):
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        with pytest.raises(FormatError, match=path.name):
            read_map(path)


def test_pictures_that_are_no_maps(tmp_path, ramp):
    """Oracle: errors with the kind of the picture and the expected one."""
    colours = np.dstack([ramp >> 8, ramp >> 9, ramp >> 10]).astype(np.uint8)
    Image.fromarray(colours).save(tmp_path / "a.png")
    with pytest.raises(FormatError, match="coloured picture of depth"):
        read_map(tmp_path / "a.png")
    Image.fromarray(colours).convert("P").save(tmp_path / "b.png")
    with pytest.raises(FormatError, match="mode 'P'"):
        read_map(tmp_path / "b.png")
    np.save(tmp_path / "c.npy", np.zeros((4, 5, 3), np.float32))
    with pytest.raises(FormatError, match=r"\[4, 5, 3\]"):
        read_map(tmp_path / "c.npy")
    np.save(tmp_path / "d.npy", np.array([["a"]]))
    with pytest.raises(FormatError, match="not an array of numbers"):
        read_map(tmp_path / "d.npy")
    with pytest.raises(DatasetError, match="no depth map"):
        read_map(tmp_path / "e.npy")


def test_16_bit_colour_png_is_refused(tmp_path):
    """Oracle: a PNG of three channels of 16 bits, which would lose 8."""
    import struct
    import zlib

    head = struct.pack(">IIBBBBB", 2, 1, 16, 2, 0, 0, 0)
    data = zlib.compress(b"\0" + bytes(range(12)))
    png = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
    (tmp_path / "a.png").write_bytes(png)
    with pytest.raises(FormatError, match="16 bits per channel"):
        read_map(tmp_path / "a.png")


def test_not_finite_is_unknown(tmp_path):
    """Oracle: NaN for NaN, infinities and Blender's 1e10."""
    np.save(tmp_path / "a.npy", np.array([[1, np.nan, np.inf], [-np.inf, 1e10, -2]], np.float32))
    back = read_map(tmp_path / "a.npy")
    assert np.isnan(back).tolist() == [[False, True, True], [True, True, False]]


def test_to_inverse():
    """Oracle: 1 / depth; 0 and below is unknown depth, 0 unknown inverse depth."""
    values = np.array([[0.0, 2.0, -1.0, np.nan]], np.float32)
    depth = to_inverse(values, DepthKind.DEPTH)[0]
    assert depth[1] == 0.5 and np.isnan(depth[[0, 2, 3]]).all()
    inverse = to_inverse(values, DepthKind.INVERSE)[0]
    assert inverse[1] == 2 and inverse[2] == -1 and np.isnan(inverse[[0, 3]]).all()


def test_sample():
    """Oracle: exact interpolation of an affine map; borders repeat; unknown spreads one pixel."""
    rows, columns = np.mgrid[:6, :9].astype(np.float32)
    values = 3 * columns - 2 * rows
    x, y = np.array([0.25, 7.5, -3.0, 20.0]), np.array([4.75, 0.5, 1.0, 9.0])
    expected = 3 * np.clip(x, 0, 8) - 2 * np.clip(y, 0, 5)
    assert sample(values, x, y) == pytest.approx(expected)
    values[2, 2] = np.nan
    found = sample(values, np.array([1.5, 3.5]), np.array([2.0, 2.0]))
    assert np.isnan(found[0]) and found[1] == pytest.approx(3 * 3.5 - 4)
    assert sample(np.full((1, 1), 7.0), np.zeros(1), np.zeros(1)) == 7


def test_finding_maps(tmp_path):
    """Oracle: the names that official tools and renderers use for maps, folders included."""
    folder = tmp_path / "depths"
    for name in (
        "a.png",
        "sub/b.NPY",
        "c.jpg.png",
        "d.exr",
        "d.npy",
        "contact_sheet.png",
        ".e.png",
    ):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")
    maps = MapFolder(folder)
    assert len(maps) == 5
    found = {n: maps.find(n) for n in ("a.jpg", "sub/b.jpg", "c.jpg", "d.png", "b.jpg", "e.png")}
    names = {n: p.relative_to(folder).as_posix() if p else None for n, p in found.items()}
    assert names == {
        "a.jpg": "a.png",
        "sub/b.jpg": "sub/b.NPY",
        "c.jpg": "c.jpg.png",
        "d.png": "d.npy",
        "b.jpg": None,
        "e.png": None,
    }
    assert maps.find("contact_sheet.jpg") is None
    assert stem("x/y.z.png") == "x/y.z"
    with pytest.raises(DatasetError, match=r"no folder .*gscore depth.*--depths"):
        MapFolder(tmp_path / "nowhere")


@pytest.mark.filterwarnings("error")
def test_numbers_beyond_float32_are_unknown(tmp_path):
    """Oracle: NaN, without a numpy warning."""
    np.save(tmp_path / "a.npy", np.array([[1e200, -1e200], [2.0, np.inf]]))
    back = read_map(tmp_path / "a.npy")
    assert back[1, 0] == 2 and np.isnan(back).sum() == 3


def test_advice_about_a_broken_map_is_not_about_photos(tmp_path):
    """Oracle: the sentence for a picture of depth that is no map."""
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(FormatError, match=r"Copy the file again") as reported:
        read_map(tmp_path / "a.png")
    assert "photo" not in str(reported.value)


@pytest.mark.parametrize(("file", "view"), [("NFD", "NFC"), ("NFC", "NFD")])
def test_accented_names_are_compared_in_nfc(tmp_path, file, view):
    """Oracle: the one existing file, named as macOS or as Linux writes é."""
    path = tmp_path / (unicodedata.normalize(file, "caf\u00e9") + ".png")
    path.touch()
    assert MapFolder(tmp_path).find(unicodedata.normalize(view, "caf\u00e9") + ".jpg") == path
