"""Unreadable files: a sentence names the format found and a remedy, quickly and in little
memory."""

import gzip
import io
import json
import struct
import sys
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gscore.commands import main
from gscore.errors import BackendError, DatasetError, FormatError, GsError
from gscore.formats import gltf_splats, read_splat_file, textures, write_splat_file
from gscore.formats.splat_file import WriteOptions
from tests.lines_run import lines_run

from .conftest import MakeModel
from .test_layouts import PLAIN_ROWS, _gltf, _sog_parts, ksplat_bytes

_MOST_BYTES, _MOST_LINES = 60e6, 20_000


def _spz(
    version: int = 3, count: int = 1, degree: int = 0, bits: int = 12, body: int = 20
) -> bytes:
    header = struct.pack("<4sIIBBBB", b"NGSP", version, count, degree, bits, 0, 0)
    return gzip.compress(header + bytes(body))


def _spz_4(count: int, streams: list[tuple[int, int]], start: int = 32) -> bytes:
    """A file of version 4 with the table `streams`, filled with zeros."""
    header = struct.pack("<4sIIBBBBI12x", b"NGSP", 4, count, 0, 12, 0, len(streams), start)
    table = b"".join(struct.pack("<QQ", *stream) for stream in streams)
    return header + table + bytes(200)


def _zstd_bomb() -> bytes:
    zstandard = pytest.importorskip("zstandard")
    count = 50_000_000
    packed = zstandard.compress(bytes(1 << 20)) * 430
    sizes = [9 * count, count, 3 * count, 3 * count, 4 * count]
    head = _spz_4(count, [(len(packed), size) for size in sizes])[: 32 + 5 * 16]
    return head + packed


def _sog(**changed: object) -> bytes:
    """A SOG archive with other values in its meta.json, or other files."""
    parts = _sog_parts()
    meta = json.loads(parts["meta.json"]) | {k: v for k, v in changed.items() if "." not in k}
    parts |= {k: v for k, v in changed.items() if "." in k}  # pyright: ignore
    parts["meta.json"] = json.dumps(meta).encode()
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, raw in parts.items():
            archive.writestr(name, raw)
    return file.getvalue()


def _encrypted(raw: bytes) -> bytes:
    """The flag of encryption set in all entries of a ZIP archive."""
    out = bytearray(raw)
    for magic, at in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        start = 0
        while (found := out.find(magic, start)) >= 0:
            out[found + at] |= 1
            start = found + 4
    return bytes(out)


def _huge_webp() -> bytes:
    """The header of a lossless WebP of 16,383 x 16,383 pixels."""
    bits = struct.pack("<I", 16382 | 16382 << 14)
    body = b"WEBPVP8L" + struct.pack("<I", 20) + b"\x2f" + bits + bytes(15)
    return b"RIFF" + struct.pack("<I", len(body)) + body


def _json(**changed: object) -> bytes:
    return json.dumps(_gltf(PLAIN_ROWS) | changed).encode()


def _accessor(index: int, **changed: object) -> bytes:
    content = _gltf(PLAIN_ROWS)
    content["accessors"][index] |= changed
    return json.dumps(content).encode()


def _extension(**changed: object) -> bytes:
    content = _gltf(PLAIN_ROWS)
    content["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"] |= changed
    return json.dumps(content).encode()


def _patched(raw: bytes, at: int, form: str, value: int) -> bytes:
    out = bytearray(raw)
    struct.pack_into(form, out, at, value)
    return bytes(out)


CASES: dict[str, tuple[str, Callable[[], bytes], str]] = {
    "spz cut": ("a.spz", lambda: _spz(body=19), "damaged SPZ.*has"),
    "spz cut in gzip": ("a.spz", lambda: _spz(body=20)[:-14], "SPZ"),
    "spz lying count": ("a.spz", lambda: _spz(count=2**32 - 1), "damaged SPZ.*announces"),
    "spz version": ("a.spz", lambda: _spz(version=9), "SPZ file of version 9; .*2, 3 and 4"),
    "spz version 1": ("a.spz", lambda: _spz(version=1), "SPZ file of version 1"),
    "spz degree": ("a.spz", lambda: _spz(degree=9), "SH degree 9"),
    "spz bits": ("a.spz", lambda: _spz(bits=200), "200 bits"),
    "spz bomb": ("a.spz", lambda: _spz(count=1, body=300_000_000), ""),
    "spz 4 in gzip": ("a.spz", lambda: _spz(version=4), "version 4, but within gzip"),
    "spz 4 streams": ("a.spz", lambda: _spz_4(1, [(1, 9)]), "1 streams"),
    "spz 4 sizes": ("a.spz", lambda: _spz_4(1, [(9, 2**60)] * 5), "stream 1 states"),
    "spz 4 beyond": ("a.spz", lambda: _spz_4(1, [(2**60, 9)] * 5), "stream 1 states"),
    "spz 4 table": ("a.spz", lambda: _spz_4(1, [(1, 9)] * 5, 2**31), "stream table"),
    "spz 4 corrupt": ("a.spz", lambda: _spz_4(1, [(9, n) for n in (9, 1, 3, 3, 4)]), "zstd"),
    "spz 4 bomb": ("a.spz", _zstd_bomb, "SPZ"),
    "splat cut": ("a.splat", lambda: bytes(63), "rows of 32 bytes"),
    "splat empty": ("a.splat", lambda: b"", "rows of 32 bytes"),
    "ksplat cut": ("a.ksplat", lambda: ksplat_bytes(1)[:-1], "beyond its end"),
    "ksplat head": ("a.ksplat", lambda: bytes(100), "its header of .* is truncated"),
    "ksplat version": ("a.ksplat", lambda: b"\7" + ksplat_bytes(1)[1:], "version 7.1"),
    "ksplat level": ("a.ksplat", lambda: _patched(ksplat_bytes(1), 20, "<H", 7), "level 7"),
    "ksplat count": ("a.ksplat", lambda: _patched(ksplat_bytes(1), 16, "<I", 9), "states 9"),
    "ksplat sections": (
        "a.ksplat", lambda: _patched(ksplat_bytes(1), 4, "<I", 2**32 - 1), "sections in",
    ),
    "ksplat section": (
        "a.ksplat", lambda: _patched(ksplat_bytes(1), 4096, "<I", 2**32 - 1), "beyond its end",
    ),
    "ksplat buckets": (
        "a.ksplat", lambda: _patched(ksplat_bytes(1), 4096 + 8, "<I", 0), "buckets are too small",
    ),
    "sog cut": ("a.sog", lambda: _sog()[:-30], "SOG|ZIP"),
    "sog version": ("a.sog", lambda: _sog(version=3), "SOG of version 3; version 2 is read"),
    "sog version 1": ("a.sog", lambda: _sog(version=None), "SOG of version 1"),
    "sog lying count": ("a.sog", lambda: _sog(count=2**31 - 1), "2,147,483,647 splats in"),
    "sog more than pixels": ("a.sog", lambda: _sog(count=5), "2 x 2 pixels for 5"),
    "sog nothing": ("a.sog", lambda: _sog(means=None), "no means"),
    "sog texture": ("a.sog", lambda: _sog(**{"q.webp": b"RIFF\0\0\0\0WEBPVP8L"}), "q.webp"),
    "sog bomb": ("a.sog", lambda: _sog(**{"q.webp": _huge_webp()}), "16383 x 16383"),
    "sog zip bomb": ("a.sog", lambda: _sog(**{"q.webp": bytes(300_000_000)}), "packed ones|WebP"),
    "sog encrypted": ("a.sog", lambda: _encrypted(_sog()), "encrypted ZIP.*password"),
    "sog label": (
        "a.sog",
        lambda: _sog(shN=json.loads(_sog_parts()["meta.json"])["shN"] | {"count": 1}),
        "palette of 1",
    ),
    "sog nan": ("a.sog", lambda: _sog(means={"mins": ["x"] * 3, "maxs": [1, 1, 1],
                "files": ["l.webp", "u.webp"]}), "list of numbers mins"),
    "gltf meshes": ("a.gltf", lambda: _json(meshes=[{"primitives": [{"attributes": {}}]}]),
                    "glTF file without splats: none of its 1 meshes"),
    "gltf nothing": ("a.gltf", lambda: b'{"asset": {"version": "2.0"}}', "without splats"),
    "gltf version": ("a.gltf", lambda: _json(asset={"version": "1.0"}), "version '1.0'"),
    "gltf required": ("a.gltf", lambda: _json(extensionsRequired=["KHR_draco_mesh_compression"]),
                      "KHR_draco_mesh_compression"),
    "gltf kernel": ("a.gltf", lambda: _extension(kernel="cube"), "kernel 'cube'"),
    "gltf colours": ("a.gltf", lambda: _extension(colorSpace="lin_rec709_display"), "colour space"),
    "gltf packed": ("a.gltf", lambda: _extension(extensions={"X_y": {}}), "'X_y', which is not"),
    "gltf count": ("a.gltf", lambda: _accessor(0, count=2**40), "beyond its bufferView"),
    "gltf offset": ("a.gltf", lambda: _accessor(0, byteOffset=2**62), "beyond its bufferView"),
    "gltf sparse": ("a.gltf", lambda: _accessor(0, sparse={}), "sparse"),
    "gltf rows": ("a.gltf", lambda: _accessor(1, count=0), "different numbers of rows"),
    "gltf folder": ("a.gltf", lambda: _json(buffers=[{"byteLength": 9, "uri": "../a.bin"}]),
                    "outside its folder"),
    "gltf web": ("a.gltf", lambda: _json(buffers=[{"byteLength": 9, "uri": "http://a/b"}]),
                 "outside its folder"),
    "gltf loop": ("a.gltf", lambda: _json(scenes=[{"nodes": [0]}], nodes=[{"children": [0]}]),
                  "the child of two nodes"),
    "gltf stretched": ("a.gltf", lambda: _json(scenes=[{"nodes": [0]}],
                       nodes=[{"mesh": 0, "scale": [1, 2, 3]}]), "stretches space unevenly"),
    "glb cut": ("a.glb", lambda: struct.pack("<4sII", b"glTF", 2, 999) + bytes(20), "states 999"),
    "glb chunk": ("a.glb", lambda: struct.pack("<4sIII4s", b"glTF", 2, 20, 2**31, b"JSON"),
                  "a chunk states"),
    "nothing known": ("a.spz", lambda: b"hello" * 100, r"contains no splats.*\.spz"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_messages_name_the_fault(case: str, tmp_path: Path) -> None:
    """Oracle: the words of the sentence; tracemalloc and the count of lines that run."""
    name, make, words = CASES[case]
    path = tmp_path / name
    path.write_bytes(make())

    def read() -> None:
        if words:
            with pytest.raises(GsError, match=words) as caught:
                read_splat_file(path)
            assert str(path) in str(caught.value) and "  " not in str(caught.value)
        else:
            read_splat_file(path)

    tracemalloc.start()
    try:
        assert lines_run(read) < _MOST_LINES
    finally:
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    # In addition to the file itself, which is read whole.
    assert most - path.stat().st_size < _MOST_BYTES, f"{most / 1e6:.0f} MB"


def test_every_verb_says_it_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: exit code 2 and one sentence on stderr, for info and render."""
    (tmp_path / "a.spz").write_bytes(_spz(version=9))
    for arguments in (["info", "a.spz"], ["render", "a.spz", "-o", "out"]):
        verb, file, *rest = arguments
        assert main([verb, str(tmp_path / file), *rest]) == 2
        reported = capsys.readouterr().err
        assert "SPZ file of version 9" in reported and "Traceback" not in reported


@pytest.mark.parametrize("name", ["../l.webp", "/etc/passwd", "a/b.webp", "..\\l.webp", "..", ""])
def test_an_unpacked_sog_stays_in_its_folder(name: str, tmp_path: Path) -> None:
    """Oracle: names that lead outside the folder are refused, even if files exist there."""
    inside = tmp_path / "in"
    inside.mkdir()
    for part, raw in _sog_parts().items():
        (inside / part).write_bytes(raw)
        (tmp_path / part).write_bytes(raw)
    meta = json.loads((inside / "meta.json").read_text())
    meta["means"]["files"][0] = name
    (inside / "meta.json").write_text(json.dumps(meta))
    with pytest.raises(FormatError, match="leaves its folder"):
        read_splat_file(inside)


def test_a_missing_part_is_named(make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: the name of the missing file, of a SOG's folder and of a .gltf."""
    write_splat_file(tmp_path / "s" / "meta.json", make_model(20, 0))
    (tmp_path / "s" / "quats.webp").unlink()
    with pytest.raises(DatasetError, match=r"quats\.webp"):
        read_splat_file(tmp_path / "s")
    write_splat_file(tmp_path / "a.gltf", make_model(20, 0))
    (tmp_path / "a.bin").unlink()
    with pytest.raises(DatasetError, match=r"a\.bin"):
        read_splat_file(tmp_path / "a.gltf")
    with pytest.raises(DatasetError, match="no such file"):
        read_splat_file(tmp_path / "none.spz")


def test_numbers_that_are_not_finite(make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: a glTF with NaN and infinity in some splats: those alone are left out, with a
    note."""
    model = make_model(10, 1)
    model.means[2, 0], model.shN[5, 1, 2] = np.nan, np.inf
    options = WriteOptions(antialiased=False, comments=(), spz_version=3)
    gltf_splats.GLTF.write(tmp_path / "a.glb", model, options)
    found = read_splat_file(tmp_path / "a.glb")
    assert len(found.splats) == 8 and "2 of 10 splats" in found.notes[0]


@pytest.mark.parametrize(
    ("name", "module", "extra"),
    [("a.spz", "zstandard", "formats"), ("a.sog", "PIL.Image", "train"), ("a.usdc", "pxr", "usd")],
)
def test_a_package_that_is_not_there(
    name: str,
    module: str,
    extra: str,
    make_model: MakeModel,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """Oracle: the command that installs it, for reading and for writing; no files."""
    if module == "pxr":
        pytest.importorskip("pxr.UsdVol")
    write_splat_file(tmp_path / name, make_model(5), spz_version=4)
    for loaded in [key for key in sys.modules if key == module or key.startswith(f"{module}.")]:
        monkeypatch.setitem(sys.modules, loaded, None)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(BackendError, match=rf"gscore\[{extra}\]"):
        read_splat_file(tmp_path / name)
    with pytest.raises(BackendError, match=rf"gscore\[{extra}\]"):
        write_splat_file(tmp_path / f"other_{name}", make_model(5), spz_version=4)
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("content", [b"#usda 1.0\n(", b'#usda 1.0\ndef Mesh "A" {}\n', None])
def test_usd(content: bytes | None, make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: a sentence for text that does not parse, for a scene of meshes, and for a binary file
    with its middle missing: Pixar's library may end its process over that, not ours."""
    pytest.importorskip("pxr.UsdVol")
    path = tmp_path / ("a.usda" if content else "a.usdc")
    if content is None:
        write_splat_file(path, make_model(50, 1))
        raw = path.read_bytes()
        content = raw[:100] + bytes(len(raw) // 2) + raw[100 + len(raw) // 2 :]
    path.write_bytes(content)
    with pytest.raises(FormatError, match=r"damaged|without splats") as caught:
        read_splat_file(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        (b"def", b"d\xfff", "bytes that are not text"),
        (b"point3f[] positions = ", b"float positions = 3\nfloat3[] others = ", "not rows of 3"),
        (
            b"point3f[] positions = ",
            b'string[] positions = ["a"]\nfloat3[] others = ',
            "not rows of 3",
        ),
    ],
)
def test_usd_that_is_damaged_in_its_words(
    old: bytes, new: bytes, why: str, make_model: MakeModel, tmp_path: Path
) -> None:
    """Oracle: the defect, in words, where the library does not report it or accepts the file."""
    pytest.importorskip("pxr.UsdVol")
    path = tmp_path / "a.usda"
    write_splat_file(path, make_model(3, 1))
    raw = path.read_bytes()
    assert old in raw
    path.write_bytes(raw.replace(old, new, 1))
    with pytest.raises(FormatError, match=f"damaged.*{why}"):
        read_splat_file(path)


def test_failed_write_leaves_no_file(make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: the folder, after a write into a folder that is a file."""
    (tmp_path / "file").write_bytes(b"")
    for name in ("a.spz", "a.sog", "a.glb", "a.compressed.ply", "a.splat"):
        with pytest.raises(GsError, match="Cannot write"):
            write_splat_file(tmp_path / "file" / name, make_model(5))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("by", ["nodes", "meshes"])
def test_splats_that_are_repeated_without_end(
    by: str, make_model: MakeModel, tmp_path: Path
) -> None:
    """Oracle: a few repetitions, read in full number; hundreds are refused in little memory,
    whether many nodes share a mesh or many meshes share their numbers."""
    path = tmp_path / "a.gltf"
    write_splat_file(path, make_model(5000, 0))
    content = json.loads(path.read_text())
    for times in (3, 400):
        if by == "nodes":
            content["nodes"] = [{"mesh": 0, "translation": [k, 0, 0]} for k in range(times)]
            content["scenes"] = [{"nodes": list(range(times))}]
        else:
            content["meshes"] = content["meshes"][:1] * times
            del content["scenes"]
        path.write_text(json.dumps(content))
        if times == 3:
            assert len(read_splat_file(path).splats) == 15_000
            content.setdefault("scenes", [])
            continue
        tracemalloc.start()
        with pytest.raises(FormatError, match=r"repeats its splats: .* nodes have"):
            read_splat_file(path)
        assert tracemalloc.get_traced_memory()[1] < 150e6
        tracemalloc.stop()


def test_a_sog_of_too_many_splats_for_its_bytes(tmp_path: Path) -> None:
    """Oracle: two million splats in two thousand bytes, refused; 60,000 equal ones, read."""
    for count in (60_000, 2_000_000):
        width, height = textures.size_for(count)
        plain = textures.encode_all({"x": np.full((height, width, 4), 255, np.uint8)})["x"]
        names = ("a.webp", "b.webp", "s.webp", "q.webp", "c.webp")
        book = [0.0] * 256
        meta = {
            "version": 2,
            "count": count,
            "means": {"mins": [0] * 3, "maxs": [1] * 3, "files": names[:2]},
            "scales": {"codebook": book, "files": names[2:3]},
            "quats": {"files": names[3:4]},
            "sh0": {"codebook": book, "files": names[4:]},
        }
        for name in names:
            (tmp_path / name).write_bytes(plain)
        (tmp_path / "meta.json").write_text(json.dumps(meta))
        if count == 60_000:
            assert len(read_splat_file(tmp_path).splats) == count
            continue
        with pytest.raises(FormatError, match="2,000,000 splats in"):
            read_splat_file(tmp_path)
