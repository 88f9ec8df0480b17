"""What files of strangers must not lead to; oracle: the syntax trees and the readers."""

import ast
import json
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from gscore.config import DataConfig
from gscore.datasets.transforms_json import read_transforms
from gscore.depth.maps import MapFolder, read_map
from gscore.errors import FormatError, GsError
from gscore.io.colmap import is_safe_name
from gscore.io.exr_header import check_exr_size
from gscore.io.images import read_image
from gscore.io.npy import read_npy
from gscore.io.sequences import read_sequence

ROOT = Path(__file__).parent.parent
SHIPPED = sorted(path for folder in ("gscore", "addon") for path in (ROOT / folder).rglob("*.py"))
UNSAFE_NAMES = (
    "../secret.png",
    "a/../../secret.png",
    "/etc/passwd",
    "C:\\Windows\\win.ini",
    "\\\\server\\share\\x.png",
    "..\\secret.png",
    "",
    ".",
    "a\x00b.png",
    "a\nb.png",
    "a\ud800.png",
)


def dotted(node: ast.expr) -> str:
    """`os.path.join` of a call's function; empty for others."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        base = dotted(node.value)
        return f"{base}.{node.attr}" if base else node.attr
    return ""


def calls(path: Path) -> list[tuple[str, ast.Call]]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [(dotted(node.func), node) for node in ast.walk(tree) if isinstance(node, ast.Call)]


def imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add((node.module or "").split(".")[0])
    return found


def test_nothing_runs_code_from_files_or_shells_or_opens_ports() -> None:
    """Oracle: no pickles, no evaluated text, no shell, no server, in any line that is shipped."""
    assert len(SHIPPED) > 200
    for path in SHIPPED:
        check_source(path)


def check_source(path: Path) -> None:
    unsafe = {"pickle", "cPickle", "dill", "shelve", "marshal", "joblib", "code"}
    network = {"socket", "socketserver", "http", "xmlrpc", "asyncio", "ftplib", "telnetlib"}
    assert not imports(path) & (unsafe | network), path
    for name, call in calls(path):
        last = name.rpartition(".")[2]
        assert name not in {"eval", "exec", "compile", "os.system", "os.popen"}, (
            f"{path.name}, line {call.lineno}"
        )
        given = {word.arg: word.value for word in call.keywords}
        assert name != "torch.load", f"{path.name}, line {call.lineno}: {name}"
        if name in {"np.load", "numpy.load"}:
            assert "allow_pickle" in given, (
                f"{path.name}, line {call.lineno}: say allow_pickle=False"
            )
        for key in ("shell", "allow_pickle"):
            value = given.get(key)
            is_false = isinstance(value, ast.Constant) and value.value is False
            assert value is None or is_false, f"{path.name}, line {call.lineno}: {key}"
        if name.startswith("subprocess.") and last in {"run", "Popen", "call", "check_output"}:
            command = call.args[0] if call.args else given.get("args")
            is_text = isinstance(command, ast.JoinedStr) or (
                isinstance(command, ast.Constant) and isinstance(command.value, str)
            )
            assert not is_text, f"{path.name}, line {call.lineno}: a command as text"


def test_the_addon_writes_only_where_blender_allows() -> None:
    """Oracle: Blender's own folder of an extension; none beside the add-on's files."""
    for path in sorted((ROOT / "addon").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        for name, call in calls(path):
            last = name.rpartition(".")[2]
            if last in {"write_text", "write_bytes", "mkdir", "unlink", "rmtree"}:
                line = ast.get_source_segment(text, call) or ""
                assert "__file__" not in line, f"{path.name}, line {call.lineno}"
    assert any(
        "extension_path_user" in path.read_text(encoding="utf-8")
        for path in (ROOT / "addon").rglob("*.py")
    )


@pytest.mark.parametrize("name", UNSAFE_NAMES)
def test_names_from_files_stay_in_their_folder(name: str, tmp_path: Path) -> None:
    """Oracle: each reader that takes names refuses it, or cannot find what lies outside."""
    (tmp_path / "secret.png").write_bytes(b"x")
    inside = tmp_path / "capture"
    inside.mkdir()
    assert not is_safe_name(name)
    frame = {"file_path": name, "transform_matrix": np.eye(4).tolist()}
    content = {"w": 8, "h": 8, "fl_x": 9, "frames": [frame]}
    (inside / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(GsError):
        read_transforms(DataConfig(source=inside))
    index = {"options": {}, "frames": [{"frame": 1, "folder": name}], "mean": {}}
    (inside / "sequence.json").write_text(json.dumps(index))
    with pytest.raises(FormatError, match=r"folder below the sequence's"):
        read_sequence(inside)
    assert not name.strip(".") or MapFolder(inside).find(name) is None


def png(width: int, height: int, body: bytes) -> bytes:
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    out = [b"\x89PNG\r\n\x1a\n"]
    for kind, data in ((b"IHDR", head), (b"IDAT", body), (b"IEND", b"")):
        check = zlib.crc32(kind + data)
        out.append(struct.pack(">I", len(data)) + kind + data + struct.pack(">I", check))
    return b"".join(out)


def test_pictures_that_unpack_to_gigabytes_are_refused(tmp_path: Path) -> None:
    """Oracle: 60 000 x 60 000 px of zeros in some kilobytes."""
    packer = zlib.compressobj(9)
    zeros = packer.compress(bytes(10_000_000)) + packer.flush()
    for name in ("a.png", "b.png"):
        (tmp_path / name).write_bytes(png(60_000, 60_000, zeros))
    with pytest.raises(FormatError, match=r"a\.png cannot be read as an image.*limit"):
        read_image(tmp_path / "a.png")
    with pytest.raises(FormatError):
        read_map(tmp_path / "b.png")


def npy(shape: str, kind: str = "<f4") -> bytes:
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (npy("(1000000, 1000000)") + bytes(64), "truncated: 64 bytes"),
        (npy("(-1, 4)") + bytes(64), "states the shape"),
        (npy("(2, 2)", "|O") + bytes(64), "no array of numbers"),
        (npy("__import__('os').system('true')"), "header is damaged"),
        (b"\x93NUMPY\x02\x00\xff\xff\xff\xff" + bytes(64), "header is damaged"),
        (b"PK\x03\x04" + bytes(64), "does not start"),
    ],
)
def test_arrays_that_lie_are_refused(raw: bytes, reason: str) -> None:
    """Oracle: the reason; nothing is allocated or evaluated."""
    with pytest.raises(ValueError, match=reason):
        read_npy(raw)


def test_arrays_of_every_kind_come_back(tmp_path: Path) -> None:
    """Oracle: numpy.save."""
    for kind in ("<f4", ">f8", "<i2", "|u1"):
        for order in ("C", "F"):
            array = np.arange(12).reshape(3, 4).astype(kind, order=order)
            np.save(tmp_path / "a.npy", array)
            assert np.array_equal(read_npy((tmp_path / "a.npy").read_bytes()), array)


def test_an_exr_that_announces_gigabytes_is_refused(tmp_path: Path) -> None:
    """Oracle: a real file whose data window is made a million times larger."""
    openexr = pytest.importorskip("OpenEXR")
    path = tmp_path / "a.exr"
    header = {"compression": openexr.ZIP_COMPRESSION, "type": openexr.scanlineimage}
    with openexr.File(header, {"Z": np.ones((12, 16), np.float32)}) as file:
        file.write(str(path))
    check_exr_size(path)
    window = struct.pack("<4i", 0, 0, 15, 11)
    raw = path.read_bytes()
    assert window in raw
    path.write_bytes(raw.replace(window, struct.pack("<4i", 0, 0, 200_000, 200_000)))
    with pytest.raises(FormatError, match=r"a\.exr .* states 200001 x 200001 pixels"):
        read_map(path)
