"""What files of strangers must not lead to; oracle: the syntax trees and the readers."""

import contextlib
import io
import json
import re
import struct
import sys
import zlib
from pathlib import Path
from subprocess import CalledProcessError

import numpy as np
import pytest
from PIL import Image

from gscore.commands import main
from gscore.commands.pictures.video import write_video
from gscore.config import DataConfig
from gscore.datasets import read_capture
from gscore.datasets.transforms_json import read_transforms
from gscore.depth.maps import MapFolder, _read_picture, check_exr_size, read_map
from gscore.errors import FormatError, GsError
from gscore.io.colmap.folder import is_safe_name
from gscore.io.images.png import write_png
from gscore.io.images.read_image import read_image, read_info, read_mask
from gscore.io.npy import read_npy
from gscore.io.sequences import read_sequence
from gscore.metrics import Lpips

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
    "gscore/commands/bench/shared.py:run_child",
    "gscore/formats/usd.py:_in_child",
    "gscore/metrics/machine.py:cpu_name",
    "gscore/raster/gpu/verification.py:_tested",
    "gscore/raster/render_process.py:ServerProcess.__init__",
    "addon/process/child_program.py:Process.__init__",
}
"""The functions that start processes, from lists of words."""
LISTENS = ROOT / "gscore" / "live" / "server.py"
"""The only file that opens a port."""
SPEAKS = ROOT / "gscore" / "trainer" / "distributed" / "process_group.py"
"""The only file that speaks with other processes of one training, through torch's own sockets."""
PARSES = ROOT / "gscore/io/xml_text.py"
COLLECTS = ROOT / "addon" / "process" / "incremental_tasks.py"
"""The only file that tells Python when to look for garbage."""
SPOKEN = {"all_gather", "all_to_all_single", "broadcast", "gather"}
"""What it calls of torch.distributed besides meeting and parting: none that passes pickles, as
those whose names end in `_object` and torch's RPC do."""
WRITES = {
    "addon/cameras/camera_path.py": "the user's choice",
    "addon/cameras/export_colmap.py": "the user's choice",
    "addon/cameras/export_transforms.py": "the user's choice",
    "addon/cameras/importing.py": "no file, an object",
    "addon/cameras/undistort_program.py": "Blender's folder of it",
    "addon/cameras/undistorted_photos.py": "Blender's folder of it",
    "addon/region_training/mask_operators.py": "the capture's folder of masks",
    "addon/region_training/masks.py": "the capture's folder of masks",
    "addon/region_training/train_region.py": "a new folder beside the output",
    "addon/render/compositor.py": "no file, an object",
    "addon/render/proxy.py": "no file, an object",
    "addon/render/shadow_scene.py": "no file, an object",
    "addon/sequence/guide_meshes.py": "the output folder",
    "addon/splats/conversion.py": "Blender's temporary folder; the user's choice",
    "addon/splats/exporting.py": "the user's choice",
    "addon/trainer_python/installer.py": "Blender's folder of it",
    "addon/training/start_training.py": "the output folder",
    "addon/training/guides.py": "the output folder",
    "addon/training/results.py": "no file, an object",
}
"""The modules of the add-on that write, make or remove files, and where these files are."""
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
from PIL import Image; Image.open("x")
import PIL.Image; PIL.Image.open("x")
import PIL.Image as pictures; pictures.open("x", "r")
Image = need("PIL.Image", "Reading photos"); Image.open("x")
pil = pillow(); pil.open("x")
import av; av.open("x", "w")
av = need_video(); av.open(str(path), "w")
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


OPENING = """
from PIL import Image; Image.open("x", formats=("PNG",))
pil = pillow(); pil.open("x", formats=PICTURE_FORMATS)
import av; av.open(f"file:{path}", "w")
""".strip().splitlines()
"""Each line opens what it names, and nothing else."""


ALLOWED = {
    LISTENS: {"imports socket"},
    SPEAKS: {
        "imports torch.distributed",
        "names torch.distributed",
        "names torch.distributed.init_process_group",
        "names torch.distributed.rendezvous",
        "names torch.distributed.PrefixStore",
    },
    COLLECTS: {"imports gc"},  # its thresholds alone
    PARSES: {"imports xml.etree.ElementTree"},  # refuses document types before
}
"""All that looks dangerous in what is shipped, by file."""


def where(path: Path, site: Site) -> str:
    return f"{path.relative_to(ROOT).as_posix()}:{site.function}"


def test_no_code_from_files_no_shell_no_ports() -> None:
    """Oracle: modules that are known, no pickles, no evaluated text, no shell; sockets in one file,
    and nothing else there."""
    assert len(SHIPPED) > 200
    starts = set()
    for path in SHIPPED:
        source = Source(path.read_text(encoding="utf-8"))
        dangers = [danger.partition(": ")[2] for danger in source.dangers()]
        assert set(dangers) == ALLOWED.get(path, set()), path
        starts |= {where(path, site) for site in source.starts()}
    assert starts == STARTS


def test_ranks_pass_no_pickles() -> None:
    """Oracle: SPOKEN, and what its one import of torch.distributed is called by."""
    text = SPEAKS.read_text(encoding="utf-8")
    called = set(re.findall(r"\b_?dist\.(\w+)", text))
    meeting = {"init_process_group", "destroy_process_group", "is_initialized"}
    meeting |= {"rendezvous", "PrefixStore"}
    assert called == SPOKEN | meeting
    assert text.count("torch.distributed") == 1
    assert re.search(r"\n {8}import torch\.distributed as dist\n", text), "where it is needed"


def test_tools_open_pictures_of_known_formats_alone() -> None:
    """Oracle: the rules for what is shipped, as far as they concern pictures and films."""
    folders = ("tools", "experiments", "examples")
    paths = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    assert len(paths) > 20
    for path in paths:
        found = Source(path.read_text(encoding="utf-8")).dangers()
        assert not [danger for danger in found if "open" in danger and "popen" not in danger], path


EPS = b"""%!PS-Adobe-3.0 EPSF-3.0
%%BoundingBox: 0 0 64 48
%%EndComments
0 0 64 48 rectfill
showpage
%%EOF
"""


@pytest.fixture
def ghostscript(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A `gs` that is found first and leaves a file where it was started."""
    from PIL import EpsImagePlugin

    started, program = tmp_path / "started", tmp_path / "bin" / "gs"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\n[ "$1" = --version ] && exit 0\ntouch {started}\nexit 1\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent), prepend=":")
    monkeypatch.setattr(EpsImagePlugin, "gs_binary", None)
    with Image.open(io.BytesIO(EPS)) as image, contextlib.suppress(OSError, CalledProcessError):
        image.load()
    assert started.is_file(), "Pillow itself starts it"
    started.unlink()
    return started


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in is a shell script")
@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif", "a.eps", "a.tga"])
def test_photos_start_no_programs(ghostscript: Path, name: str, tmp_path: Path) -> None:
    """Oracle: a Ghostscript that leaves a trace, and the sentence."""
    path = tmp_path / name
    path.write_bytes(EPS)
    for read in (read_info, read_image, read_mask, _read_picture):
        with pytest.raises(
            FormatError, match=rf"{name} cannot be read as an image: its format is not"
        ):
            read(path)
    assert not ghostscript.exists()


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in is a shell script")
@pytest.mark.parametrize(("good", "bad"), [("a.png", "m.png"), ("m.png", "a.png")])
def test_photos_start_no_programs_in_a_command(
    ghostscript: Path, good: str, bad: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the same through `gscore info`, in a photo or a mask."""
    pose = np.eye(4).tolist()
    frames = [{"file_path": "a.png", "transform_matrix": pose, "mask_path": "m.png"}]
    content = {"w": 64, "h": 48, "fl_x": 60.0, "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    write_png(tmp_path / good, np.zeros((48, 64, 3), np.uint8))
    (tmp_path / bad).write_bytes(EPS)
    assert main(["info", str(tmp_path)]) == 2
    reported = capfd.readouterr()
    assert f"{bad} cannot be read as an image" in reported.err and "Traceback" not in reported.err
    assert not ghostscript.exists()


def test_networks_read_no_files_outside_their_folder(tmp_path: Path) -> None:
    """Oracle: onnxruntime itself: weights kept in a file beside the network, above it, anywhere."""
    onnx = pytest.importorskip("onnx")
    helper, folder = onnx.helper, tmp_path / "model"
    folder.mkdir()
    weights = np.ones(4, np.float32).tobytes()
    (tmp_path / "outside.bin").write_bytes(weights)
    (folder / "inside.bin").write_bytes(weights)
    (folder / "link.bin").symlink_to(tmp_path / "outside.bin")
    for place in ("../outside.bin", str(tmp_path / "outside.bin"), "link.bin", "inside.bin"):
        tensor = onnx.TensorProto(name="w", data_type=1, dims=[4], data_location=1)
        tensor.external_data.add(key="location", value=place)
        a, b, out = (helper.make_tensor_value_info(name, 1, [4]) for name in "abc")
        nodes = [helper.make_node("Add", ["a", "w"], ["d"]), helper.make_node("Add", "db", "c")]
        graph = helper.make_graph(nodes, "g", [a, b], [out], [tensor])
        opset = helper.make_opsetid("", 17)
        model = helper.make_model(graph, opset_imports=[opset], ir_version=8)
        (folder / "a.onnx").write_bytes(model.SerializeToString())
        if place == "inside.bin":
            Lpips(folder / "a.onnx")
            continue
        with pytest.raises(FormatError, match=r"a\.onnx is not an ONNX graph"):
            Lpips(folder / "a.onnx")


def test_films_are_written_to_files_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: names that FFmpeg takes for protocols are folders and files here."""
    pytest.importorskip("av")
    monkeypatch.chdir(tmp_path)
    for name in ("md5:/a.mp4", "tcp:/b.mp4", "a:b.mp4", "c.mp4"):
        write_video(Path(name), [np.zeros((16, 16, 3), np.uint8)] * 2, fps=5)
        assert b"ftyp" in Path(name).read_bytes()[:16]


def test_the_addon_writes_only_where_blender_allows() -> None:
    """Oracle: the list of modules that write; each entry's folder was looked up in the code."""
    found = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "addon").rglob("*.py")
        if any(Source(path.read_text(encoding="utf-8")).writes())
    }
    assert found == set(WRITES)
    paths = Source((ROOT / "addon" / "paths.py").read_text(encoding="utf-8"))
    assert "bpy.utils.extension_path_user" in {site.callee for site, _ in paths.calls()}


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


@pytest.mark.parametrize("line", OPENING)
def test_pictures_and_films_are_opened_by_kind(line: str) -> None:
    """Oracle: each line says which formats, or that it is a file."""
    assert not list(Source(line).dangers())


@pytest.mark.parametrize("name", ["http://127.0.0.1:9/a.png", "file:///etc/passwd", "fd:0"])
def test_addresses_are_names_of_files(name: str, tmp_path: Path) -> None:
    """Oracle: a photo of such a name that is not there; nothing shipped can open connections."""
    frame = {"file_path": name, "transform_matrix": np.eye(4).tolist()}
    content = {"w": 8, "h": 8, "fl_x": 9, "frames": [frame]}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(GsError, match=r"1 of the 1 images .* are missing"):
        read_transforms(DataConfig(source=tmp_path))


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
    (inside / "transforms.json").unlink()
    shot = {"camera": "c", "rotation": [0, 0, 0], "translation": [0, 0, 0]}
    camera = {"projection_type": "perspective", "width": 8, "height": 8, "focal": 1}
    part = {"cameras": {"c": camera}, "shots": {name: shot}}
    (inside / "reconstruction.json").write_text(json.dumps([part]))
    for view in read_capture(DataConfig(source=inside), photos_required=False).views:
        assert view.image.parent == inside and view.name == view.image.name
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
        (npy("(2, 2)", "|O") + bytes(64), "not an array of numbers"),
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
