"""What files of strangers must not lead to; oracle: the syntax trees and the readers."""

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

from .source_rules import Site, Source

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


STARTS = {
    "gscore/bench/child.py:run_child",
    "gscore/metrics/machine.py:cpu_name",
    "addon/job/process.py:Process.__init__",
}
"""The functions that start processes, from lists of words."""
WRITES = {
    "addon/export_cameras.py:export_colmap .core.write_colmap": "the user's choice",
    "addon/export_transforms.py:export_transforms .core.atomic_write": "the user's choice",
    "addon/splat_io.py:export_splats .core.write_splats": "the user's choice",
    "addon/job/installer.py:make shutil.rmtree": "Blender's folder of it",
    "addon/job/installer.py:_make_venv folder.parent.mkdir": "Blender's folder of it",
    "addon/job/installer.py:_put_in_place shutil.rmtree": "Blender's folder of it",
    "addon/job/installer.py:_rename os.replace": "Blender's folder of it",
    "addon/render/compositor.py:_synchronise other.collection.objects.unlink": "no file, an object",
}
"""All calls in the add-on that write, make or remove files, and where these lie."""
BAD = """
import pickle
import urllib.request
from urllib.request import urlopen
import requests
import http.client
import ssl
import ftplib
import socket as s
import multiprocessing
from multiprocessing import Pool
from concurrent.futures import ProcessPoolExecutor
import concurrent.futures as f; f.ProcessPoolExecutor()
from os import system
import os as o; o.system("x")
import os; os.popen("x")
import os; os.execv("x", [])
import os; go = os.system
import os; getattr(os, "sys" + "tem")("x")
__import__("pickle")
import builtins
eval("1")
go = exec
from torch import load
import torch as t; t.load("x")
import torch; torch.hub.load("x", "y")
from subprocess import run; run("x")
from subprocess import run as go; go(["x"], shell=True)
from subprocess import getoutput
import subprocess; subprocess.run(f"x {1}")
import subprocess; subprocess.Popen("x " + "y")
import subprocess; subprocess.call("x {}".format(1))
import subprocess; subprocess.check_output(args="x")
import subprocess; subprocess.run(["x"], shell=yes)
import numpy as np; np.load("x")
from numpy import load; load("x", allow_pickle=True)
""".strip().splitlines()
"""Each line does what no line may."""
WRITING = """
open("x", "w")
open("x", mode="ab")
open("x", mode)
open("x", "r+")
open("x", **options)
import io; io.open("x", "wb")
path.open("w")
import os; os.open("x", 1)
from os import rename; rename("x", "y")
import numpy as np; np.save("x", a)
from numpy import savez as keep; keep("x", a)
array.tofile(path)
import shutil; shutil.copy("x", "y")
from shutil import copytree as go; go("x", "y")
import tempfile; tempfile.mkdtemp()
from tempfile import NamedTemporaryFile; NamedTemporaryFile()
path.write_text("x")
path.with_name("y").write_bytes(b"x")
(a / b).mkdir()
path.unlink()
path.replace(other)
path.rename(other)
path.touch()
image.save()
image.save_render("x")
archive.extractall("x")
import bpy; bpy.ops.wm.save_as_mainfile(filepath="x")
from .core import write_splats; write_splats("x", splats)
""".strip().splitlines()
"""Each line writes a file."""
HARMLESS = """
open("x")
path.open("rb")
open("x", "r", encoding="utf-8")
text.replace("a", "b")
from dataclasses import replace; replace(one, a=2)
import re; re.compile("x")
model.eval()
import numpy as np; np.load("x", allow_pickle=False)
import subprocess; subprocess.run(["x", name])
import torch; torch.zeros(3)
""".strip().splitlines()


def where(path: Path, site: Site) -> str:
    return f"{path.relative_to(ROOT).as_posix()}:{site.function}"


def test_nothing_runs_code_from_files_or_shells_or_opens_ports() -> None:
    """Oracle: modules that are known, no pickles, no evaluated text, no shell, no server."""
    assert len(SHIPPED) > 200
    starts = set()
    for path in SHIPPED:
        source = Source(path.read_text(encoding="utf-8"))
        assert not list(source.dangers()), path
        starts |= {where(path, site) for site in source.starts()}
    assert starts == STARTS


def test_the_addon_writes_only_where_blender_allows() -> None:
    """Oracle: the list of what writes; each entry's place was looked up in the code."""
    found = set()
    for path in sorted((ROOT / "addon").rglob("*.py")):
        for site in Source(path.read_text(encoding="utf-8")).writes():
            found.add(f"{where(path, site)} {site.callee}")
    assert found == set(WRITES)
    setup = Source((ROOT / "addon" / "job" / "setup.py").read_text(encoding="utf-8"))
    assert "bpy.utils.extension_path_user" in {site.callee for site, _ in setup.calls()}


@pytest.mark.parametrize("line", BAD)
def test_bad_lines_are_found(line: str) -> None:
    """Oracle: each line is bad."""
    assert list(Source(line).dangers())


@pytest.mark.parametrize("line", WRITING)
def test_writing_lines_are_found(line: str) -> None:
    """Oracle: each line writes."""
    assert [site.function for site in Source(f"def f():\n    {line}").writes()] == ["f"]


@pytest.mark.parametrize("line", HARMLESS)
def test_harmless_lines_are_let_through(line: str) -> None:
    """Oracle: each line is harmless."""
    assert not list(Source(line).dangers())
    assert not Source(line).writes()


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
    with pytest.raises(FormatError, match=r"a\.png states a size of 60000 x 60000 pixels"):
        read_image(tmp_path / "a.png")
    with pytest.raises(FormatError, match=r"b\.png states a size of 60000 x 60000 pixels"):
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
