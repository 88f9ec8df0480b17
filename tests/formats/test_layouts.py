"""Bytes written here by hand, from the published layouts and without our writers."""

import gzip
import io
import json
import logging
import re
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import gscore
from gscore.errors import FormatError
from gscore.formats import read_splat_file, write_splat_file
from gscore.formats.axes import UPRIGHT
from gscore.formats.gltf import Gltf
from gscore.io.mesh.files import TriangleMesh
from gscore.io.ply.comments import stated_up
from gscore.sh import SH_C0
from gscore.splats import Splats
from gscore.transforms import transform_splats

HALF = np.sqrt(0.5)
_ONE = np.float32(1)


def _one(**values: object) -> Splats:
    """A splat of degree 0 at the origin, of size 1, half opaque, grey, unrotated."""
    given = {"means": [0, 0, 0], "quats": [1, 0, 0, 0], "scales": [0, 0, 0], "sh0": [0, 0, 0]}
    given |= values
    arrays = {k: np.array([v], np.float32) for k, v in given.items() if k != "shN"}
    arrays["sh0"] = arrays["sh0"].reshape(1, 1, 3)
    rest = np.array(given.get("shN", np.zeros((0, 3))), np.float32)[None]
    return Splats(opacities=np.zeros(1, np.float32), shN=rest, **arrays)


def _spz_body(version: int) -> bytes:
    """Two splats of SH degree 1 with 4 bits of fraction."""
    places = [(1.5, -2.0, 0.25), (-0.0625, 3.0, -4.0)]
    body = b"".join(int(v * 16).to_bytes(3, "little", signed=True) for p in places for v in p)
    body += bytes([255, 51])  # opacities
    body += bytes([128, 0, 255, 90, 128, 166])  # colours
    body += bytes([160, 144, 176, 0, 255, 16])  # sizes
    if version == 2:
        body += bytes([0, 127, 127, 255, 255, 127])
    else:
        # The first: x the largest, y = -sqrt(1/2) 511/511, z = 0, w = 0.
        body += struct.pack("<I", 0 << 30 | (1 << 9 | 511) << 20)
        # The second: w the largest, x = y = 0, z = sqrt(1/2) 73/511.
        body += struct.pack("<I", 3 << 30 | 73)
    return body + bytes(range(128, 137)) + bytes(range(137, 128, -1))


def _check_spz(splats: Splats, version: int) -> None:
    """Expected values by the layout: right-up-back, so y and z change their signs here."""
    np.testing.assert_array_equal(splats.means, [[1.5, 2.0, -0.25], [-0.0625, -3.0, 4.0]])
    alpha = 51 / 255
    assert splats.opacities[0] > 5
    np.testing.assert_allclose(splats.opacities[1], np.log(alpha / (1 - alpha)), rtol=1e-5)
    colors = (np.array([[128, 0, 255], [90, 128, 166]]) / 255 - 0.5) / 0.15
    np.testing.assert_allclose(splats.sh0[:, 0], colors, rtol=1e-5)
    np.testing.assert_array_equal(splats.scales, [[0, -1, 1], [-10, 5.9375, -9]])
    if version == 2:
        first = np.array([0, 127, 127]) / 127.5 - 1
        np.testing.assert_allclose(splats.quats[0, 1:], first * [1, -1, -1], atol=1e-6)
    else:
        np.testing.assert_allclose(splats.quats[0], [0, HALF, HALF, 0], atol=1e-6)
        z = -HALF * 73 / 511
        np.testing.assert_allclose(splats.quats[1], [np.sqrt(1 - z * z), 0, 0, z], atol=1e-6)
    # Degree 1 is -y, z, -x: the first two change sign with y and z. Channels are innermost.
    wanted = np.arange(9).reshape(3, 3) / 128 * [[-1], [-1], [1]]
    np.testing.assert_allclose(splats.shN[0], wanted, atol=1e-7)
    wanted = np.arange(9, 0, -1).reshape(3, 3) / 128 * [[-1], [-1], [1]]
    np.testing.assert_allclose(splats.shN[1], wanted, atol=1e-7)


@pytest.mark.parametrize("version", [2, 3])
def test_spz_in_gzip(version: int, tmp_path: Path) -> None:
    """Oracle: numbers worked out from the layout of github.com/nianticlabs/spz."""
    header = struct.pack("<4sIIBBBB", b"NGSP", version, 2, 1, 4, 1, 0)
    (tmp_path / "a").write_bytes(gzip.compress(header + _spz_body(version)))
    found = read_splat_file(tmp_path / "a")
    assert (found.format, found.layout, found.antialiased) == ("spz", f"SPZ {version}", True)
    _check_spz(found.splats, version)


@pytest.mark.parametrize("extension", [b"", struct.pack("<III", 0xADBE0002, 4, 7)])
def test_spz_in_zstd(extension: bytes, tmp_path: Path) -> None:
    """Oracle: the same, in the streams of version 4, with and without a vendor's record."""
    zstandard = pytest.importorskip("zstandard")
    body, arrays = _spz_body(4), []
    for size in (18, 2, 6, 6, 8, 18):
        arrays.append(body[:size])
        body = body[size:]
    streams = [zstandard.compress(array) for array in arrays]
    flags, start = 2 if extension else 0, 32 + len(extension)
    header = struct.pack("<4sIIBBBBI12x", b"NGSP", 4, 2, 1, 4, flags, 6, start)
    table = b"".join(
        struct.pack("<QQ", len(s), len(a)) for s, a in zip(streams, arrays, strict=True)
    )
    (tmp_path / "a").write_bytes(header + extension + table + b"".join(streams))
    found = read_splat_file(tmp_path / "a")
    assert (found.layout, found.antialiased) == ("SPZ 4", False)
    assert len(found.notes) == bool(extension)
    _check_spz(found.splats, 4)


@pytest.mark.parametrize(
    ("axes", "place"),
    [
        (4, [1, -2, -4]), (6, [1, 2, 4]), (7, [-1, -2, 4]), (1, [-1, 2, -4]),
        (16, [1, -4, 2]), (9, [-1, 4, -2]), (0, [1, -2, -4]), (17, [1, -2, -4]),
    ],
)  # fmt: skip
def test_spz_in_other_axes(axes: int, place: list[float], tmp_path: Path) -> None:
    """Oracle: names of axes in the library, as 16 for right-front-up, turned by hand; an unknown
    number means the usual axes, with a note."""
    header = struct.pack("<4sIIBBBBI12x", b"NGSP", 3, 1, 0, 4, 2, 0, 0)[:16]
    places = b"".join((16 * k).to_bytes(3, "little") for k in (1, 2, 4))
    body = places + bytes([200] + [128] * 6) + struct.pack("<I", 3 << 30)
    record = struct.pack("<III", 0xADBE0003, 4, axes)
    (tmp_path / "a.spz").write_bytes(gzip.compress(header + body + record))
    found = read_splat_file(tmp_path / "a.spz")
    np.testing.assert_array_equal(found.splats.means, [place])
    assert len(found.notes) == (axes in (0, 17))


def test_spz_in_other_axes_is_turned_whole(tmp_path: Path) -> None:
    """Oracle: renders of the model in the axes of a mirrored world."""
    rng = np.random.default_rng(5)
    model = _one(
        means=[0.1, -0.2, 2], quats=rng.normal(size=4), scales=[-1, -2, -3], sh0=[0.5, 0.2, -0.3],
        shN=0.3 * rng.uniform(-1, 1, (24, 3)),
    )  # fmt: skip
    mirrored = np.array([[-1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    usual = np.diag([1.0, -1, -1, 1])
    write_splat_file(tmp_path / "a.spz", transform_splats(model, usual @ np.linalg.inv(mirrored)))
    raw = bytearray(gzip.decompress((tmp_path / "a.spz").read_bytes()))
    raw[14] |= 2
    raw += struct.pack("<III", 0xADBE0003, 4, 15)  # left, front, up
    (tmp_path / "a.spz").write_bytes(gzip.compress(bytes(raw)))
    K = np.array([[60.0, 0, 24], [0, 60, 24], [0, 0, 1]])
    again = gscore.read_splats(tmp_path / "a.spz")
    old, new = (gscore.render(s, K, np.eye(4), 48, 48).rgb for s in (model, again))
    assert old.max() > 0.1 and np.abs(old - new).max() < 0.03


def test_spz_of_degree_4(tmp_path: Path) -> None:
    """Oracle: the bytes, by the layout."""
    header = struct.pack("<4sIIBBBB", b"NGSP", 3, 1, 4, 12, 0, 0)
    body = bytes(9 + 1 + 3 + 3 + 4) + bytes(range(128, 200))
    (tmp_path / "a.spz").write_bytes(gzip.compress(header + body))
    found = read_splat_file(tmp_path / "a.spz")
    assert found.splats.sh_degree == 4 and not found.notes
    np.testing.assert_allclose(np.abs(found.splats.shN[0, 14]), np.arange(42, 45) / 128)
    # x⁴-6x²y²+y⁴ is the same after half a turn about x.
    np.testing.assert_allclose(found.splats.shN[0, 23], np.arange(69, 72) / 128)


def test_spz_as_written(tmp_path: Path) -> None:
    """Oracle: the fields of the header and the bytes of one splat, by the layout."""
    one = _one(
        means=[1, -2, 4], quats=[HALF, 0, HALF, 0], scales=[-2, 0, 1], sh0=[0, 1, -1],
        shN=[[0.5, 0, 0], [0, 0.25, 0], [0, 0, -1]],
    )  # fmt: skip
    write_splat_file(tmp_path / "a.spz", one, antialiased=True)
    raw = gzip.decompress((tmp_path / "a.spz").read_bytes())
    magic, version, count, degree, bits, flags, zero = struct.unpack_from("<4sIIBBBB", raw)
    assert (magic, version, count, degree, flags, zero) == (b"NGSP", 3, 1, 1, 1, 0)
    places = [int.from_bytes(raw[16 + 3 * k : 19 + 3 * k], "little", signed=True) for k in range(3)]
    np.testing.assert_array_equal(np.array(places) / 2**bits, [1, 2, -4])
    assert bits == 20  # 4 units take 22 bits and a sign
    assert raw[25] == 128 and list(raw[26:29]) == [128, 166, 89]
    assert list(raw[29:32]) == [128, 160, 176]
    (word,) = struct.unpack_from("<I", raw, 32)
    # w and y have equal magnitude; the first of x, y, z, w wins. y = -sqrt(1/2), made positive.
    assert word >> 30 == 1 and word & 0x1FF == 511 and word >> 9 & 1 == 1
    assert list(raw[36:]) == [64, 128, 128, 128, 96, 128, 128, 128, 0]


def test_splat(tmp_path: Path) -> None:
    """Oracle: 32 bytes by the layout of github.com/antimatter15/splat, read and written."""
    row = struct.pack("<6f", 1, 2, 3, 1, np.e, 0.5) + bytes([255, 0, 51, 102, 218, 128, 38, 128])
    (tmp_path / "a.splat").write_bytes(row * 2)
    splats = read_splat_file(tmp_path / "a.splat").splats
    assert len(splats) == 2
    np.testing.assert_array_equal(splats.means[0], [1, 2, 3])
    np.testing.assert_allclose(splats.scales[0], [0, 1, np.log(0.5)], atol=1e-6)
    np.testing.assert_allclose(splats.sh0[0, 0] * SH_C0 + 0.5, [1, 0, 0.2], atol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-splats.opacities[0])), 0.4, atol=1e-6)
    np.testing.assert_allclose(splats.quats[0] / 0.703125, [1, 0, -1, 0], atol=1e-6)
    write_splat_file(tmp_path / "b.splat", splats)
    again = (tmp_path / "b.splat").read_bytes()
    assert again[:12] + again[24:28] == row[:12] + row[24:28]
    assert list(again[28:32]) == [219, 128, 37, 128]  # of unit length


def _webp(pixels: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels.astype(np.uint8), "RGBA").save(file, "WEBP", lossless=True, exact=True)
    return file.getvalue()


def _sog_parts() -> dict[str, bytes]:
    """Three splats of SH degree 1 by the published specification; the palette has two rows."""
    texture = lambda *rows: _webp(np.array([*rows, [9, 9, 9, 9]]).reshape(2, 2, 4))  # noqa: E731
    palette = np.full((1, 192, 4), 255)
    palette[0, :6, :3] = np.arange(18).reshape(6, 3)
    meta = {
        "version": 2,
        "count": 3,
        "antialias": True,
        "means": {"mins": [0, -1, 2], "maxs": [1, 1, 2], "files": ["l.webp", "u.webp"]},
        "scales": {"codebook": [k / 10 - 8 for k in range(256)], "files": ["s.webp"]},
        "quats": {"files": ["q.webp"]},
        "sh0": {"codebook": [k / 100 for k in range(256)], "files": ["c.webp"]},
        "shN": {
            "count": 2,
            "bands": 1,
            "codebook": [k / 50 for k in range(256)],
            "files": ["p.webp", "i.webp"],
        },
    }
    return {
        "meta.json": json.dumps(meta).encode(),
        "l.webp": texture([255, 0, 0, 255], [0, 255, 0, 255], [0, 255, 7, 255]),
        "u.webp": texture([255, 0, 0, 255], [0, 255, 0, 255], [128, 127, 9, 255]),
        "s.webp": texture([0, 10, 255, 255], [1, 2, 3, 255], [80, 80, 80, 255]),
        "q.webp": texture([255, 128, 0, 252], [128, 0, 128, 255], [1, 2, 3, 100]),
        "c.webp": texture([0, 100, 255, 51], [1, 2, 3, 0], [4, 5, 6, 255]),
        "p.webp": _webp(palette),
        "i.webp": texture([1, 0, 0, 255], [0, 0, 0, 255], [1, 0, 0, 255]),
    }


def _check_sog(splats: Splats) -> None:
    e = np.e
    np.testing.assert_allclose(splats.means[0], [e - 1, 1 - e, e * e - 1], rtol=1e-5)
    np.testing.assert_allclose(splats.means[1], [0, e - 1, e * e - 1], atol=1e-6)
    middle = np.expm1(128 * 256 / 65535)
    np.testing.assert_allclose(splats.means[2, 0], middle, rtol=1e-5)
    np.testing.assert_allclose(splats.scales[0], [-8, -7, 17.5], atol=1e-5)
    step = np.sqrt(2) * (128 / 255 - 0.5)
    np.testing.assert_allclose(splats.quats[0], [0, HALF, step, -HALF], atol=1e-3)
    np.testing.assert_allclose(splats.quats[1], [step, -HALF, step, HALF], atol=3e-3)
    np.testing.assert_array_equal(splats.quats[2], [1, 0, 0, 0])
    np.testing.assert_allclose(splats.sh0[0, 0], [0, 1, 2.55], atol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-splats.opacities[0])), 0.2, atol=1e-6)
    np.testing.assert_allclose(splats.shN[0], np.arange(9, 18).reshape(3, 3) / 50, atol=1e-6)
    np.testing.assert_allclose(splats.shN[1], np.arange(9).reshape(3, 3) / 50, atol=1e-6)


@pytest.mark.parametrize("packing", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_sog(packing: int, tmp_path: Path) -> None:
    """Oracle: numbers worked out from the specification of version 2, in a ZIP archive."""
    with zipfile.ZipFile(tmp_path / "a", "w", packing) as archive:
        for name, raw in _sog_parts().items():
            archive.writestr(f"scan/{name}", raw)
    found = read_splat_file(tmp_path / "a")
    assert (found.format, found.antialiased) == ("sog", True)
    _check_sog(found.splats)


@pytest.mark.parametrize(
    ("mark", "antialiased"),
    [
        ({"model": "antialiased"}, True),
        ({"model": "2dgs"}, False),
        ({"model": 3}, False),
        ({}, False),
    ],
)
def test_mark_of_splat_transform(mark: dict, antialiased: bool, tmp_path: Path) -> None:
    """Oracle: the words that splat-transform writes; it reads no `antialias`."""
    for name, raw in _sog_parts().items():
        (tmp_path / name).write_bytes(raw)
    meta = json.loads((tmp_path / "meta.json").read_text())
    del meta["antialias"]
    (tmp_path / "meta.json").write_text(json.dumps(meta | mark))
    found = read_splat_file(tmp_path)
    assert found.antialiased == antialiased
    out = tmp_path / "out" / "meta.json"
    write_splat_file(out, found.splats, antialiased=antialiased)
    assert json.loads(out.read_text()).get("model") == ("antialiased" if antialiased else None)


def test_sog_unpacked(tmp_path: Path) -> None:
    """Oracle: the same in a folder."""
    for name, raw in _sog_parts().items():
        (tmp_path / name).write_bytes(raw)
    _check_sog(read_splat_file(tmp_path).splats)


def ksplat_bytes(level: int) -> bytes:
    """Two sections by the layout of GaussianSplats3D: three splats of degree 1 in a full bucket of
    two and a partly filled one, and one of degree 0."""
    header = bytearray(4096)
    struct.pack_into("<BBxxIIIIH", header, 0, 0, 1, 2, 2, 4, 4, level)
    struct.pack_into("<ff", header, 36, -2.0, 2.0)
    heads = b""
    for count, full, partial, degree in ((3, 1, 1, 1), (1, 0, 1, 0)):
        head = bytearray(1024)
        buckets = full + partial
        fields = (count, count, 2, buckets, 8.0, 12, 1000, 0, full, partial, degree)
        struct.pack_into("<IIIIfHxxIIIIH", head, 0, *fields)
        heads += bytes(head)
    body = struct.pack("<I", 1) + struct.pack("<6f", 10, 20, 30, -10, -20, -30)
    body += b"".join(_ksplat_row(level, k, 9) for k in range(3))
    body += struct.pack("<I", 1) + struct.pack("<3f", 1, 1, 1) + _ksplat_row(level, 3, 0)
    return bytes(header) + heads + body


def _ksplat_row(level: int, k: int, rest: int) -> bytes:
    number = "f" if level == 0 else "e"
    place = struct.pack("<3f", k, 0, -k) if level == 0 else struct.pack("<3H", 1000 + k, 1000, 0)
    row = place + struct.pack(f"<3{number}4{number}", 1, 2, 4, 0.5, 0.5, -0.5, 0.5)
    row += bytes([0, 51, 255, 102])
    values = [j / 8 for j in range(rest)]
    if level == 2:
        return row + bytes(round((v + 2) / 4 * 255) for v in values)
    return row + struct.pack(f"<{rest}{number}", *values)


@pytest.mark.parametrize("level", [0, 1, 2])
def test_ksplat(level: int, tmp_path: Path) -> None:
    """Oracle: numbers worked out from the layout, in floats, halves and bytes."""
    (tmp_path / "a").write_bytes(ksplat_bytes(level))
    found = read_splat_file(tmp_path / "a")
    splats = found.splats
    assert found.format == "ksplat" and splats.sh_degree == 1 and len(splats) == 4
    if level == 0:
        np.testing.assert_array_equal(splats.means[:, 0], [0, 1, 2, 3])
    else:
        step = 8 / 2 / 1000
        first = [[10, 20, 26], [10 + step, 20, 26], [-10 + 2 * step, -20, -34]]
        np.testing.assert_allclose(splats.means, [*first, [1 + 3 * step, 1, -3]], rtol=1e-6)
    np.testing.assert_allclose(splats.scales[0], np.log([1, 2, 4]), atol=1e-6)
    np.testing.assert_array_equal(splats.quats[3], [0.5, 0.5, -0.5, 0.5])
    np.testing.assert_allclose(splats.sh0[2, 0] * SH_C0 + 0.5, [0, 0.2, 1], atol=1e-6)
    # A band stores its reds, then its greens, then its blues.
    wanted = np.arange(9).reshape(3, 3).T / 8
    np.testing.assert_allclose(splats.shN[0], wanted, atol=4 / 255)
    assert not splats.shN[3].any()


def test_ksplat_without_the_number_of_its_sections(tmp_path: Path) -> None:
    """Oracle: the same file with the number; splat-transform's own files only have the room."""
    raw = bytearray(ksplat_bytes(1))
    (tmp_path / "stated").write_bytes(raw)
    struct.pack_into("<I", raw, 8, 0)
    (tmp_path / "left_out").write_bytes(raw)
    stated, found = (read_splat_file(tmp_path / name) for name in ("stated", "left_out"))
    assert found.format == "ksplat" and len(found.splats) == 4
    np.testing.assert_array_equal(found.splats.means, stated.splats.means)


def _gltf(rows: dict[str, tuple], **primitive: object) -> dict:
    """A file with an embedded buffer, of attributes as (type, componentType, bytes)."""
    import base64

    raw, views, accessors, attributes = b"", [], [], {}
    for name, (kind, stored, data, *more) in rows.items():
        views.append({"buffer": 0, "byteOffset": len(raw), "byteLength": len(data)})
        attributes[name] = len(accessors)
        accessors.append(
            {"bufferView": len(views) - 1, "componentType": stored, "count": 1, "type": kind}
            | (more[0] if more else {})
        )
        raw += data + bytes(-len(data) % 4)
    extension = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    uri = "data:application/octet-stream;base64," + base64.b64encode(raw).decode()
    return {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_gaussian_splatting"],
        "buffers": [{"byteLength": len(raw), "uri": uri}],
        "bufferViews": views,
        "accessors": accessors,
        "meshes": [{"primitives": [{
            "attributes": attributes, "mode": 0,
            "extensions": {"KHR_gaussian_splatting": extension}, **primitive,
        }]}],
    }  # fmt: skip


_K = "KHR_gaussian_splatting:"
PLAIN_ROWS = {
    "POSITION": ("VEC3", 5126, struct.pack("<3f", 1, 2, 3)),
    f"{_K}ROTATION": ("VEC4", 5120, struct.pack("<4b", 0, 127, 0, 0), {"normalized": True}),
    f"{_K}SCALE": ("VEC3", 5126, struct.pack("<3f", 1, np.e, 0.5)),
    f"{_K}OPACITY": ("SCALAR", 5121, bytes([51]), {"normalized": True}),
    f"{_K}SH_DEGREE_0_COEF_0": ("VEC3", 5126, struct.pack("<3f", 0.1, 0.2, 0.3)),
    **{
        f"{_K}SH_DEGREE_1_COEF_{k}": ("VEC3", 5126, struct.pack("<3f", k + 1, 0, -k))
        for k in range(3)
    },
}


def test_gltf(tmp_path: Path) -> None:
    """Oracle: numbers worked out from the extension's text; left-up-front, so x and y change."""
    (tmp_path / "a.gltf").write_text(json.dumps(_gltf(PLAIN_ROWS)))
    found = read_splat_file(tmp_path / "a.gltf")
    splats = found.splats
    np.testing.assert_array_equal(splats.means, [[-1, -2, 3]])
    np.testing.assert_allclose(splats.quats, [[0, 0, -1, 0]], atol=1e-6)
    np.testing.assert_allclose(splats.scales, [[0, 1, np.log(0.5)]], atol=1e-6)
    np.testing.assert_allclose(splats.opacities, np.log([0.25]), rtol=1e-5)
    np.testing.assert_allclose(splats.sh0[0, 0], [0.1, 0.2, 0.3], rtol=1e-6)
    np.testing.assert_array_equal(splats.shN[0], [[-1, 0, 0], [2, 0, -1], [-3, 0, 2]])


def test_gltf_of_the_drafts(tmp_path: Path) -> None:
    """Oracle: negative sizes, which are logarithms in drafts of the extension."""
    rows = PLAIN_ROWS | {f"{_K}SCALE": ("VEC3", 5126, struct.pack("<3f", -4, -5, 0.5))}
    (tmp_path / "a.gltf").write_text(json.dumps(_gltf(rows)))
    splats = read_splat_file(tmp_path / "a.gltf").splats
    np.testing.assert_array_equal(splats.scales, [[-4, -5, 0.5]])


def test_gltf_applies_nodes(tmp_path: Path) -> None:
    """Oracle: the position by the nodes' translation, rotation and scale, worked out."""
    content = _gltf(PLAIN_ROWS)
    content |= {
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"translation": [10, 0, 0], "scale": [2, 2, 2], "children": [1]},
            {"rotation": [0, 0, HALF, HALF], "mesh": 0},  # a quarter about z: (-2, 1, 3)
        ],
    }
    (tmp_path / "a.gltf").write_text(json.dumps(content))
    splats = read_splat_file(tmp_path / "a.gltf").splats
    np.testing.assert_allclose(splats.means, [[-6, -2, 6]], atol=1e-5)
    np.testing.assert_allclose(splats.scales[0, 0], np.log(2), atol=1e-6)


def _packed_gltf(place: tuple[float, ...], bounds: list | None, **changed: object) -> dict:
    """A file with an embedded SPZ of one splat, turned by a sixth about z."""
    body = b"".join(int(v * 16).to_bytes(3, "little", signed=True) for v in place)
    body += bytes([51, 128, 128, 128, 160, 144, 176]) + struct.pack("<I", 3 << 30 | 361)
    body += bytes([128] * 3 + [160] * 3 + [192] * 3)  # of degree 1
    raw = gzip.compress(struct.pack("<4sIIBBBB", b"NGSP", 3, 1, 1, 4, 0, 0) + body)
    content = _gltf({"POSITION": ("VEC3", 5126, raw)})
    accessor, primitive = content["accessors"][0], content["meshes"][0]["primitives"][0]
    del accessor["bufferView"]
    if bounds is not None:
        accessor |= {"min": bounds, "max": bounds}
    name = "KHR_gaussian_splatting_compression_spz_2"
    primitive["extensions"]["KHR_gaussian_splatting"]["extensions"] = {name: {"bufferView": 0}}
    return content | changed


@pytest.mark.parametrize(
    ("stored", "bounds", "wanted"),
    [
        ((1, 2, 3), [-1, 2, -3], (-1, 2, -3)), ((1, 2, 3), [1, 2, 3], (1, 2, 3)),
        ((1, 2, 3), [1.02, 1.99, 3.01], (1, 2, 3)), ((1, 2, 3), None, (-1, 2, -3)),
        ((1, 2, 3), [5, 5, 5], (-1, 2, -3)), ((0, 2, 0), [0, 2, 0], (0, 2, 0)),
        ((1, 2, 3), ["a", 2, 3], (-1, 2, -3)),
    ],
)  # fmt: skip
def test_packed_gltf_in_axes_that_its_bounds_state(
    stored: tuple, bounds: list | None, wanted: tuple, tmp_path: Path
) -> None:
    """Oracle: a file with the same numbers as plain accessors, in the axes of glTF: as stored where
    the bounds of positions fit these alone (Cesium), else turned by the extension's rule."""
    (tmp_path / "a.gltf").write_text(json.dumps(_packed_gltf(stored, bounds)))
    found = read_splat_file(tmp_path / "a.gltf").splats
    np.testing.assert_allclose(found.means * [-1, -1, 1], [wanted], atol=1e-6)
    turned = np.array([1, 1, 1]) if wanted == stored and bounds != [0, 2, 0] else [-1, 1, -1]
    w, x, y, z = found.quats[0] / np.linalg.norm(found.quats[0])
    # From 3DGS to glTF x and y change their signs, from SPZ to glTF by the rule x and z.
    np.testing.assert_allclose([w, -x, -y, z], [0.75**0.5, 0, 0, turned[2] * 0.5], atol=2e-3)
    y1, z1, x1 = found.shN[0][:, 0] * [-1, 1, -1]  # of degree 1, -y, z, -x in this order
    np.testing.assert_allclose([x1, y1, z1], turned * np.array([0.5, 0, 0.25]), atol=1e-6)


def test_drafts_of_gltf_are_named(tmp_path: Path) -> None:
    """Oracle: the extensions and attributes of Cesium before the extension was settled."""
    rows = {name.replace(_K, "_"): row for name, row in PLAIN_ROWS.items() if "SH_" not in name}
    rows["COLOR_0"] = ("VEC4", 5121, bytes([1, 2, 3, 51]), {"normalized": True})
    lacking = {name: row for name, row in PLAIN_ROWS.items() if "OPACITY" not in name}
    legacy = "KHR_spz_gaussian_splats_compression"
    first = _gltf(PLAIN_ROWS)
    first["meshes"][0]["primitives"][0]["extensions"] = {legacy: {"bufferView": 0}}
    second = _gltf(PLAIN_ROWS, extensions={"KHR_gaussian_splatting": {}, "KHR_spz_compression": {}})
    for content, words in (
        (first, f"{legacy}, a draft of 2025"),
        (first | {"extensionsRequired": [legacy]}, f"{legacy}, a draft of 2025"),
        (second, "KHR_spz_compression, a draft"),
        (_gltf(rows), "draft of KHR_gaussian_splatting of early 2025.*_ROTATION and _SCALE"),
        (_gltf(lacking), "its splats lack KHR_gaussian_splatting:OPACITY"),
    ):
        (tmp_path / "a.gltf").write_text(json.dumps(content))
        with pytest.raises(FormatError, match=words):
            read_splat_file(tmp_path / "a.gltf")


def test_gltf_as_written(tmp_path: Path) -> None:
    """Oracle: header, chunks and accessors of a .glb by the specification of glTF 2.0."""
    write_splat_file(tmp_path / "a.glb", _one(means=[1, 2, 3], quats=[2, 0, 0, 0]))
    raw = (tmp_path / "a.glb").read_bytes()
    magic, version, length, size, kind = struct.unpack_from("<4sIII4s", raw)
    assert (magic, version, length, kind) == (b"glTF", 2, len(raw), b"JSON") and size % 4 == 0
    content = json.loads(raw[20 : 20 + size])
    rest, tag = struct.unpack_from("<I4s", raw, 20 + size)
    assert tag == b"BIN\0" and rest == len(raw) - 28 - size
    assert content["buffers"] == [{"byteLength": rest}]
    primitive = content["meshes"][0]["primitives"][0]
    assert primitive["mode"] == 0 and content["extensionsUsed"] == ["KHR_gaussian_splatting"]
    accessors = content["accessors"]
    position = accessors[primitive["attributes"]["POSITION"]]
    assert position["min"] == position["max"] == [-1, -2, 3]

    def values(name: str, count: int) -> tuple:
        accessor = accessors[primitive["attributes"][name]]
        view = content["bufferViews"][accessor["bufferView"]]
        assert view["byteOffset"] % 4 == 0 and accessor["componentType"] == 5126
        return struct.unpack_from(f"<{count}f", raw, 28 + size + view["byteOffset"])

    assert values("KHR_gaussian_splatting:ROTATION", 4) == (0, 0, 0, 1)
    assert values("KHR_gaussian_splatting:SCALE", 3) == (1, 1, 1)
    assert values("KHR_gaussian_splatting:OPACITY", 1) == (0.5,)


@pytest.mark.parametrize("up", UPRIGHT)
def test_gltf_is_upright(tmp_path: Path, up: str) -> None:
    """Oracle: the splat's place, by the node's rotation worked out by scipy, is along y; the splat
    is read back to the bit, with its up axis."""
    axis = np.zeros(3)
    axis["XYZ".index(up[-1])] = -1 if up.startswith("-") else 1
    rng = np.random.default_rng(1)
    splats = _one(means=axis, quats=[0.5, 0.5, -0.5, 0.5], shN=rng.standard_normal((3, 3)))
    proxy = TriangleMesh(vertices=np.stack([axis] * 3) + 5, triangles=np.array([[0, 1, 2]]))
    more = {"comments": (f"up axis: {up}",), "proxy": proxy, "origin": np.full(3, 5.0)}
    write_splat_file(tmp_path / "a.glb", splats, **more)
    file = Gltf(tmp_path / "a.glb")
    for node in file.content["nodes"]:
        attributes = file.content["meshes"][node["mesh"]]["primitives"][0]["attributes"]
        place = file.numbers(attributes["POSITION"], "VEC3")[0]
        turned = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).apply(place)
        np.testing.assert_allclose(turned, [0, 1, 0], atol=1e-6)
    found = read_splat_file(tmp_path / "a.glb")
    for name in ("means", "quats", "shN"):
        np.testing.assert_array_equal(getattr(found.splats, name), getattr(splats, name))
    assert stated_up(found.comments) == (up if up != "-Y" else "")


@pytest.mark.parametrize("ending", [".usda", ".usdz"])
@pytest.mark.parametrize("up", UPRIGHT)
def test_usd_is_upright(tmp_path: Path, up: str, ending: str) -> None:
    """Oracle: the places of splat and proxy by OpenUSD's matrices are along y, the up axis of the
    stage, and as in glTF; the splat is read back to the bit, with its up axis."""
    pytest.importorskip("pxr.UsdVol")
    from pxr import Usd, UsdGeom

    axis = np.zeros(3)
    axis["XYZ".index(up[-1])] = -1 if up.startswith("-") else 1
    rng = np.random.default_rng(1)
    splats = _one(means=axis, quats=[0.5, 0.5, -0.5, 0.5], shN=rng.standard_normal((3, 3)))
    proxy = TriangleMesh(vertices=np.stack([axis] * 3), triangles=np.array([[0, 1, 2]]))
    path = tmp_path / f"a{ending}"
    write_splat_file(path, splats, comments=(f"up axis: {up}",), proxy=proxy)
    stage = Usd.Stage.Open(str(path))
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    cache = UsdGeom.XformCache()
    for name, attribute in (("Splats", "positions"), ("Proxy", "points")):
        prim = stage.GetPrimAtPath(f"/Scene/{name}")
        place = prim.GetAttribute(attribute).Get()[0]
        turned = cache.GetLocalToWorldTransform(prim).Transform(place)
        np.testing.assert_allclose(turned, [0, 1, 0], atol=1e-6)
    found = read_splat_file(path)
    for name in ("means", "quats", "shN"):
        np.testing.assert_array_equal(getattr(found.splats, name), getattr(splats, name))
    assert stated_up(found.comments) == (up if up != "-Y" else "")


def test_a_changed_rotation_of_a_prim_counts(tmp_path: Path) -> None:
    """Oracle: the place by a prim whose rotation is not that of its stated up axis any more."""
    pytest.importorskip("pxr.UsdVol")
    path = tmp_path / "a.usda"
    write_splat_file(path, _one(means=[1, 2, 3]), comments=("up axis: Z",))
    text = path.read_text()
    lines = [line for line in text.splitlines() if "xformOp" not in line]
    assert len(lines) == len(text.splitlines()) - 2
    path.write_text("\n".join(lines))
    found = read_splat_file(path)
    np.testing.assert_allclose(found.splats.means[0], [1, 2, 3], atol=1e-6)
    assert stated_up(found.comments) == ""


@pytest.mark.parametrize("rotation", [None, [0.0, 0.0, 1.0, 0.0]], ids=["none", "another"])
def test_a_changed_rotation_counts(tmp_path: Path, rotation: list[float] | None) -> None:
    """Oracle: the place by the rotation of a node whose extras name an up axis that is not that of
    the rotation, as those of other programs."""
    path = tmp_path / "a.gltf"
    write_splat_file(path, _one(means=[1, 2, 3]), comments=("up axis: Z",))
    content = json.loads(path.read_text())
    node = content["nodes"][0]
    assert node["extras"] == {"up": "Z"} and node.pop("rotation")
    node |= {} if rotation is None else {"rotation": rotation}
    path.write_text(json.dumps(content))
    found = read_splat_file(path)
    half_turn = [1, 1, 1] if rotation is None else [-1, -1, 1]
    np.testing.assert_allclose(found.splats.means[0], np.array([1, 2, 3]) * half_turn, atol=1e-6)
    assert stated_up(found.comments) == ""


@pytest.mark.parametrize("ending", [".gltf", ".usda"])
def test_moves_of_other_programs_are_those_of_the_upright_scene(
    tmp_path: Path, ending: str
) -> None:
    """Oracle: a parent that moves the scene by 5 up, which is along z in the splats' world."""
    path = tmp_path / f"a{ending}"
    write_splat_file(path, _one(means=[1, 2, 3]), comments=("up axis: Z",))
    if ending == ".gltf":
        content = json.loads(path.read_text())
        content["nodes"].append({"children": [0], "translation": [0, 5, 0]})
        content["scenes"][0]["nodes"] = [1]
        path.write_text(json.dumps(content))
    else:
        pytest.importorskip("pxr.UsdVol")
        path.replace(tmp_path / "model.usda")
        move = "double3 xformOp:translate = (0, 5, 0)"
        order = 'uniform token[] xformOpOrder = ["xformOp:translate"]'
        above = f'def "A" (references = @./model.usda@) {{\n{move}\n{order}\n}}'
        path.write_text(f'#usda 1.0\n(upAxis = "Y")\n{above}')
    found = read_splat_file(path)
    np.testing.assert_allclose(found.splats.means[0], [1, 2, 8], atol=1e-6)
    assert stated_up(found.comments) == "Z"


@pytest.mark.parametrize("ending", [".gltf", ".usda"])
def test_models_with_several_up_axes_stand_as_in_their_scene(tmp_path: Path, ending: str) -> None:
    """Oracle: places by hand in a scene of a turned model and one that is not."""
    path, turned = tmp_path / f"a{ending}", tmp_path / f"turned{ending}"
    write_splat_file(turned, _one(means=[1, 2, 3]), comments=("up axis: Z",))
    if ending == ".gltf":
        content = json.loads(turned.read_text())
        content["nodes"].append({"mesh": 0})
        content["scenes"][0]["nodes"] = [1, 0]
        path.write_text(json.dumps(content))
        wanted = [[-1, -3, -2], [1, 2, 3]]
    else:
        pytest.importorskip("pxr.UsdVol")
        write_splat_file(tmp_path / "plain.usda", _one(means=[1, 2, 3]))
        both = [f'def "{x}" (references = @./{x}.usda@) {{}}' for x in ("turned", "plain")]
        path.write_text("\n".join(['#usda 1.0\n(upAxis = "Y")', *both]))
        wanted = [[1, -3, 2], [1, 2, 3]]
    found = read_splat_file(path)
    np.testing.assert_allclose(sorted(found.splats.means.tolist()), wanted, atol=1e-6)
    assert stated_up(found.comments) == ""


def test_a_proxy_is_hidden(tmp_path: Path) -> None:
    """Oracle: KHR_node_visibility of Khronos; the purposes of OpenUSD, of which guides are drawn on
    request only."""
    proxy = TriangleMesh(vertices=np.eye(3), triangles=np.array([[0, 1, 2]]))
    for name in ("a.glb", "a.spz.glb"):
        write_splat_file(tmp_path / name, _one(), proxy=proxy)
        file = Gltf(tmp_path / name)
        node = file.content["nodes"][1]
        assert node["extensions"] == {"KHR_node_visibility": {"visible": False}}
        assert node["name"] == "proxy" and node["extras"] == {"proxy": True}
        assert "KHR_node_visibility" in file.content["extensionsUsed"]
        assert len(read_splat_file(tmp_path / name).splats) == 1
    pytest.importorskip("pxr.UsdVol")
    from pxr import Usd, UsdGeom

    splats = _one(means=[1, 2, 3])
    write_splat_file(tmp_path / "a.usda", splats, proxy=proxy)
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Proxy"))
    assert mesh.GetPurposeAttr().Get() == "guide"
    np.testing.assert_array_equal(mesh.GetPointsAttr().Get(), np.eye(3) * [1, -1, -1])
    np.testing.assert_array_equal(mesh.GetFaceVertexIndicesAttr().Get(), [0, 1, 2])
    assert stage.GetDefaultPrim().GetPath() == "/Scene"
    np.testing.assert_array_equal(read_splat_file(tmp_path / "a.usda").splats.means, splats.means)


def test_usd(tmp_path: Path) -> None:
    """Oracle: a scene in text by the schema of OpenUSD 26.03, with Z up and a moved prim."""
    pytest.importorskip("pxr.UsdVol")
    (tmp_path / "a.usda").write_text(
        """#usda 1.0
( upAxis = "Z" )
def ParticleField3DGaussianSplat "A" {
    point3f[] positions = [(1, 2, 3)]
    quatf[] orientations = [(1, 0, 0, 0)]
    float3[] scales = [(1, 2.7182817, 0.5)]
    half[] opacitiesh = [0.25]
    uniform int radiance:sphericalHarmonicsDegree = 0
    float3[] radiance:sphericalHarmonicsCoefficients = [(1, 0.5, 0)]
    double3 xformOp:translate = (10, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""
    )
    found = read_splat_file(tmp_path / "a.usda")
    splats = found.splats
    # Up is -y here and +z there: (11, 2, 3) is (11, -3, 2).
    np.testing.assert_allclose(splats.means, [[11, -3, 2]], atol=1e-5)
    np.testing.assert_allclose(splats.scales, [[0, 1, np.log(0.5)]], atol=1e-6)
    np.testing.assert_allclose(splats.opacities, np.log([1 / 3]), rtol=1e-5)
    np.testing.assert_array_equal(splats.sh0[0, 0], [1, 0.5, 0])


_PRIM = """
    def ParticleField3DGaussianSplat "S" {
        point3f[] positions = [(1, 2, 3), (4, 5, 6)]
        quatf[] orientations = [(1, 0, 0, 0), (1, 0, 0, 0)]
        float3[] scales = [(1, 1, 1), (1, 1, 1)]
        float[] opacities = [0.25, 0.5]
    }
"""
_MOVED = """
        double3 xformOp:translate = (%d, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
"""


def _usd_means(text: str, path: Path) -> list[list[float]]:
    """Positions in the axes of the stage, sorted."""
    path.write_text(f'#usda 1.0\n( upAxis = "Y" )\n{text}')
    means = read_splat_file(path).splats.means * [1, -1, -1]
    return sorted(means.round(4).tolist())


def test_usd_instances(tmp_path: Path) -> None:
    """Oracle: the same prims written out: two instances of one class, one of them nested in an
    instance of a scope that contains the prim and another instance."""
    pytest.importorskip("pxr.UsdVol")
    text = f"""
class "Model" {{ {_PRIM} }}
class "Scope" {{
    {_PRIM}
    def Xform "inner" (
        instanceable = true
        references = </Model>
    ) {{ {_MOVED % 100} }}
}}
def Xform "one" (
    instanceable = true
    references = </Model>
) {{ {_MOVED % 10} }}
def Xform "two" (
    instanceable = true
    references = </Scope>
) {{ {_MOVED % 20} }}
def Xform "plain" {{ {_PRIM} }}
"""
    wanted = [[x + shift, y, z] for shift in (0, 10, 20, 120) for x, y, z in ((1, 2, 3), (4, 5, 6))]
    assert _usd_means(text, tmp_path / "a.usda") == sorted(wanted)


def test_usd_that_lacks_a_file(tmp_path: Path) -> None:
    """Oracle: a scene of three files, with all and without one, which is named."""
    pytest.importorskip("pxr.UsdVol")
    for name in "ab":
        (tmp_path / f"{name}.usda").write_text(
            f'#usda 1.0\n(\n defaultPrim = "M"\n upAxis = "Y"\n)\ndef Xform "M" {{ {_PRIM} }}'
        )
    text = "".join(
        f'def Xform "{name}" (\n instanceable = true\n references = @./{name}.usda@\n) {{}}\n'
        for name in "ab"
    )
    assert len(_usd_means(text, tmp_path / "whole.usda")) == 4
    assert not read_splat_file(tmp_path / "whole.usda").notes
    (tmp_path / "b.usda").unlink()
    [note] = read_splat_file(tmp_path / "whole.usda").notes
    assert "1 part of the scene cannot be read" in note and "b.usda" in note


def test_usd_point_instancers(tmp_path: Path) -> None:
    """Oracle: positions worked out by hand: scale, a half turn about y, then the point, of a
    prototype that is moved itself; one point is hidden."""
    pytest.importorskip("pxr.UsdVol")
    text = f"""
def PointInstancer "points" {{
    rel prototypes = [</points/first>, </points/second>]
    int[] protoIndices = [0, 1, 0]
    point3f[] positions = [(0, 0, 0), (10, 0, 0), (20, 0, 0)]
    quath[] orientations = [(1, 0, 0, 0), (0, 0, 1, 0), (1, 0, 0, 0)]
    float3[] scales = [(1, 1, 1), (2, 2, 2), (1, 1, 1)]
    int64[] invisibleIds = [2]
    def Xform "first" {{ {_PRIM} }}
    def Xform "second" {{ {_MOVED % 100} {_PRIM} }}
}}
"""
    wanted = [[1, 2, 3], [4, 5, 6], [10 - 2 * 101, 4, -6], [10 - 2 * 104, 10, -12]]
    assert _usd_means(text, tmp_path / "a.usda") == sorted(wanted)


def test_usd_that_repeats_its_splats_without_end(tmp_path: Path) -> None:
    """Oracle: one sentence: 2 to the power of 40 instances of a prim with 4,000 splats."""
    pytest.importorskip("pxr.UsdVol")
    levels = "".join(
        f'class "L{k}" {{ ' + "".join(
            f'def Xform "{side}" ( instanceable = true\n references = </L{k - 1}> ) {{}}\n'
            for side in "ab"
        ) + "}\n"
        for k in range(1, 41)
    )  # fmt: skip
    row = re.compile(r"= \[(.*)\]")
    prim = row.sub(lambda found: f"= [{', '.join([found[1]] * 2000)}]", _PRIM)
    text = f'class "L0" {{ {prim} }}\n{levels}def "all" ( references = </L40> ) {{}}'
    with pytest.raises(FormatError, match="repeats its splats"):
        _usd_means(text, tmp_path / "a.usda")


def test_dropped_splats_are_reported_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Oracle: a splat with NaN in a .splat: left out, in the notes and in the log."""
    good = struct.pack("<6f", 1, 2, 3, 1, 1, 1) + bytes([255, 0, 51, 102, 255, 128, 128, 128])
    bad = struct.pack("<6f", np.nan, 2, 3, 1, 1, 1) + good[24:]
    (tmp_path / "a.splat").write_bytes(good + bad)
    with caplog.at_level(logging.WARNING):
        found = read_splat_file(tmp_path / "a.splat")
    assert len(found.splats) == 1 and "1 of 2 splats" in found.notes[0]
    assert [record.getMessage() for record in caplog.records] == list(found.notes)
