"""Existing files at output paths: gscore's own are replaced, others only with --overwrite."""

import json
import os
import zipfile

import av
import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from gscore.commands.terminal.output import check_folder, check_replaced, is_ours
from gscore.depth.maps import SHEET
from gscore.errors import ConfigError
from gscore.report.html_parts import html_page

HOLIDAY = b"a film of a holiday"


def refused(gscore, path, *line):
    """Check that the verb ends with a sentence that names the file, and leaves it unchanged."""
    code, _, err = gscore(*line)
    assert code == 2 and "without a mark of" in err and path.name in err, err
    assert "--overwrite" in err and path.read_bytes() == HOLIDAY
    return True


@pytest.mark.parametrize("output", ["film.mp4", "one.png", "folder"])
def test_renders_replace_their_own_alone(gscore, run_folder, tmp_path, output):
    """Oracle: the bytes of a user's file, and a second rendering over a first."""
    pytest.importorskip("av")
    path = tmp_path / output
    view = ("--path", "orbit", "--frames", "2") if output == "film.mp4" else ("--view", "a_1.png")
    line = ("render", run_folder(), "-o", path, "-r", "16", *view)
    written = path / "a_1.png" if output == "folder" else path
    assert gscore(*line, "--quiet")[0] == 0 and is_ours(written)
    assert gscore(*line, "--quiet")[0] == 0
    written.write_bytes(HOLIDAY)
    assert refused(gscore, written, *line)
    assert gscore(*line, "--overwrite", "--quiet")[0] == 0 and is_ours(written)


@pytest.mark.parametrize("kind", ["png", "npy"])
def test_depth_maps_of_others_stay(gscore, run_folder, tmp_path, kind):
    """Oracle: the bytes of a user's file, and no picture next to it."""
    line = ("render", run_folder(), "-o", tmp_path / "out", "--view", "a_1.png", "--depth", kind)
    theirs = tmp_path / "out" / f"a_1_depth.{kind}"
    theirs.parent.mkdir()
    theirs.write_bytes(HOLIDAY)
    assert refused(gscore, theirs, *line) and not (tmp_path / "out" / "a_1.png").exists()
    assert gscore(*line, "--overwrite", "--quiet")[0] == 0
    assert gscore(*line, "--quiet")[0] == 0


def test_the_mark_is_where_viewers_look(gscore, run_folder, tmp_path):
    """Oracle: Pillow's and FFmpeg's readers."""
    av = pytest.importorskip("av")
    folder = run_folder()
    gscore("render", folder, "-o", tmp_path / "a.png", "--view", "0")
    assert Image.open(tmp_path / "a.png").text == {"Software": "gscore"}
    small = ("--path", "orbit", "--frames", "2", "-r", "16")
    gscore("render", folder, "-o", tmp_path / "a.mp4", *small)
    with av.open(str(tmp_path / "a.mp4")) as film:
        assert film.metadata["comment"] == "Rendered by gscore"


def test_measurements_replace_their_own_alone(gscore, run_folder, tmp_path, capture):
    """Oracle: the bytes of a user's report in another folder."""
    theirs = tmp_path / "report.html"
    theirs.write_bytes(HOLIDAY)
    line = ("eval", run_folder(), "-o", tmp_path)
    assert refused(gscore, theirs, *line) and not (tmp_path / "metrics.json").exists()
    assert gscore(*line, "--overwrite", "--quiet")[0] == 0
    assert gscore(*line, "--quiet")[0] == 0


@pytest.mark.parametrize("name", ["results.json", "capture0-psnr.svg", "capture0-sizes.svg"])
def test_benches_replace_their_own_alone(gscore, tmp_path, capture, name):
    """Oracle: the bytes of a user's file with the name of a figure; no training."""
    theirs = tmp_path / name.replace("capture0", capture.name)
    theirs.write_bytes(HOLIDAY)
    assert refused(gscore, theirs, "bench", "time-error", capture, "-o", tmp_path)
    if name == "results.json":
        assert refused(gscore, theirs, "bench", "quality", capture, "-o", tmp_path)


def test_a_contact_sheet_of_others_stays(gscore, tmp_path, capture):
    """Oracle: the bytes of a user's picture among the depth maps."""
    folder = capture / "maps"
    folder.mkdir(exist_ok=True)
    theirs = folder / SHEET
    theirs.write_bytes(HOLIDAY)
    try:
        assert refused(gscore, theirs, "depth", capture, "--depths", "maps")
    finally:
        theirs.unlink()
        folder.rmdir()


def test_folders_and_pipes_as_output_are_refused(gscore, run_folder, tmp_path):
    """Oracle: a folder and a named pipe with the name of the picture, both unchanged."""
    folder = run_folder()
    (tmp_path / "folder.png").mkdir()
    os.mkfifo(tmp_path / "pipe.png")
    for name, words in (("folder.png", "is a folder"), ("pipe.png", "is not a regular file")):
        line = ("render", folder, "-o", tmp_path / name, "--view", "0", "--overwrite")
        code, _, err = gscore(*line)
        assert code == 2 and words in err
    assert (tmp_path / "pipe.png").is_fifo() and (tmp_path / "folder.png").is_dir()


WRITERS = {
    "a.ply": ("convert",),
    "a.compressed.ply": ("convert",),
    "a.sog": ("convert",),
    "a.glb": ("convert",),
    "a.gltf": ("convert",),
    "a.lod": ("lod",),
    "a.html": ("view", "--photos", 0),
}


@pytest.mark.parametrize("name", list(WRITERS))
def test_own_output_may_be_replaced(gscore, run_folder, tmp_path, name):
    """Oracle: a second call of the verb over the file of the first."""
    verb, *more = WRITERS[name]
    folder = run_folder()
    given = folder if verb == "view" else folder / "point_cloud.ply"
    words = (verb, given, *((tmp_path / name,) if verb == "convert" else ("-o", tmp_path / name)))
    assert gscore(*words, *more, "--quiet")[0] == 0 and is_ours(tmp_path / name)
    beside = ["--overwrite"] if name == "a.gltf" else []
    assert gscore(*words, *more, *beside, "--quiet")[0] == 0


@pytest.mark.parametrize(
    ("title", "ours"),
    [
        ("lund: gscore report", True),
        ("a and b: two runs compared by gscore", True),
        ("My gscore report", False),
    ],
)
def test_pages_written_before_their_mark_are_known(title, ours, tmp_path):
    """Oracle: the first lines of older reports and comparisons."""
    page = html_page(title, "<p>x</p>")
    (tmp_path / "a.html").write_text(page)
    assert is_ours(tmp_path / "a.html")
    (tmp_path / "a.html").write_text(page.replace("<!-- written by gscore -->\n", "", 1))
    assert is_ours(tmp_path / "a.html") == ours


def _png(path):
    note = PngInfo()
    note.add_text("Comment", "compared with gscore; Software: gscore")
    note.add_text("Software", "gscore-like viewer")
    Image.new("RGB", (4, 4)).save(path, pnginfo=note)


def _ply(path):
    header = "ply\nformat ascii 1.0\ncomment thanks to gscore convert\nelement vertex 0\n"
    path.write_text(f"{header}property float x\nend_header\n")


def _zip(path):
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("meta.json", json.dumps({"asset": {"generator": "PlayCanvas, not gscore"}}))
        file.writestr("gscore.txt", "gscore")


def _gltf(path):
    path.write_text(json.dumps({"asset": {"generator": "Blender"}, "extras": {"by": "gscore"}}))


def _glb(path):
    text = json.dumps({"asset": {"generator": "Blender"}, "nodes": [{"name": "gscore"}]}).encode()
    text += b" " * (-len(text) % 4)
    sizes = [n.to_bytes(4, "little") for n in (2, 20 + len(text), len(text))]
    path.write_bytes(b"glTF" + b"".join(sizes) + b"JSON" + text)


def _page(path):
    link = '<a href="https://example.org/gscore">written by gscore</a>'
    path.write_text(f"<!doctype html>\n<html><title>Me</title>{link}<!-- gscore view --></html>")


def _json(path):
    path.write_text(json.dumps({"notes": ["gscore"], "tools": {"gscore": "0.1"}}))


def _svg(path):
    path.write_text("<svg width='1'><text>gscore</text><metadata>gscore</metadata></svg>")


def _film(path):
    with av.open(str(path), "w", format="mp4") as file:
        file.metadata["title"] = "Rendered by gscore"
        file.metadata["comment"] = "my walk, not Rendered by gscore"
        stream = file.add_stream("libx264", rate=30)
        stream.width, stream.height = 32, 32
        for packet in stream.encode(av.VideoFrame(32, 32, "yuv420p")):
            file.mux(packet)
        file.mux(stream.encode())


def _lod(path):
    path.write_bytes(b"my list of gscore levels of detail 1\n")


THEIRS = {
    "a.png": _png, "a.ply": _ply, "a.sog": _zip, "a.gltf": _gltf, "a.glb": _glb, "a.html": _page,
    "results.json": _json, "a.svg": _svg, "a.mp4": _film, "a.lod": _lod,
}  # fmt: skip


@pytest.mark.parametrize("name", list(THEIRS))
def test_files_of_others_that_name_gscore_stay(name, tmp_path):
    """Oracle: files of users and other programs with gscore's name in them, but not at the place of
    gscore's mark."""
    THEIRS[name](tmp_path / name)
    assert b"gscore" in (tmp_path / name).read_bytes() and not is_ours(tmp_path / name)
    with pytest.raises(ConfigError, match="without a mark of"):
        check_replaced([tmp_path / name], overwrite=False)


@pytest.mark.parametrize(
    "text", [b"{", b'{"gscore": 1}', b"[" * 9000, b"PK\x03\x04gscore", b"glTF"]
)
def test_damaged_files_are_nobodys(text, tmp_path):
    """Oracle: an unreadable mark, so that they stay."""
    (tmp_path / "a").write_bytes(text)
    assert not is_ours(tmp_path / "a")


def test_empty_files_may_be_replaced(tmp_path):
    """Oracle: a file made by mktemp, in which no data could be lost."""
    (tmp_path / "a.png").touch()
    check_replaced([tmp_path / "a.png", tmp_path / "none.png"], overwrite=False)
    np.save(tmp_path / "b.npy", np.zeros(3))
    with pytest.raises(ConfigError, match="without a mark of"):
        check_replaced([tmp_path / "b.npy"], overwrite=False)


@pytest.mark.parametrize(
    ("flag", "words"), [(os.ST_RDONLY, "the disk is read-only"), (0, "permission denied")]
)
def test_why_a_folder_takes_no_files(tmp_path, monkeypatch, flag, words):
    """Oracle: the flag of the file system, as set by Linux."""
    reported = os.statvfs(tmp_path)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    monkeypatch.setattr(
        os, "statvfs", lambda path: os.statvfs_result((*reported[:8], flag, *reported[9:]))
    )
    with pytest.raises(ConfigError, match=f"Cannot write into {tmp_path}: {words}; choose"):
        check_folder(tmp_path / "new")
