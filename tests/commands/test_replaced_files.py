"""Files under the names of outputs: gscore's own are replaced, others only with --overwrite."""

import os

import numpy as np
import pytest
from PIL import Image

from gscore.commands.terminal.output import check_folder, check_replaced, is_ours
from gscore.depth.maps import SHEET
from gscore.errors import ConfigError

HOLIDAY = b"a film of a holiday"


def refused(gscore, path, *line):
    """Whether the verb ends with a sentence that names the file, which stays as it is."""
    code, _, err = gscore(*line)
    assert code == 2 and "says that gscore wrote it" in err and path.name in err, err
    assert "--overwrite" in err and path.read_bytes() == HOLIDAY
    return True


@pytest.mark.parametrize("output", ["film.mp4", "one.png", "folder"])
def test_renders_replace_their_own_alone(gscore, run_folder, tmp_path, output):
    """Oracle: the bytes of a user's file before, and a second rendering over a first."""
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
    """Oracle: the bytes of a user's file, and that no picture was written beside it."""
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
    """Oracle: the bytes of a user's file that has the name of a figure; nothing is trained."""
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


def test_what_is_no_file_is_refused_before_the_work(gscore, run_folder, tmp_path):
    """Oracle: a folder and a named pipe with the name of the picture, there as before."""
    folder = run_folder()
    (tmp_path / "folder.png").mkdir()
    os.mkfifo(tmp_path / "pipe.png")
    for name, words in (("folder.png", "is a folder"), ("pipe.png", "is no regular file")):
        line = ("render", folder, "-o", tmp_path / name, "--view", "0", "--overwrite")
        code, _, err = gscore(*line)
        assert code == 2 and words in err
    assert (tmp_path / "pipe.png").is_fifo() and (tmp_path / "folder.png").is_dir()


def test_empty_files_may_be_replaced(tmp_path):
    """Oracle: a file made by mktemp holds nothing that could be lost."""
    (tmp_path / "a.png").touch()
    check_replaced([tmp_path / "a.png", tmp_path / "none.png"], overwrite=False)
    np.save(tmp_path / "b.npy", np.zeros(3))
    with pytest.raises(ConfigError, match="says that gscore wrote it"):
        check_replaced([tmp_path / "b.npy"], overwrite=False)


@pytest.mark.parametrize(
    ("flag", "words"), [(os.ST_RDONLY, "the disk is read-only"), (0, "permission denied")]
)
def test_why_a_folder_takes_no_files(tmp_path, monkeypatch, flag, words):
    """Oracle: the flag of the file system that Linux gives."""
    told = os.statvfs(tmp_path)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    monkeypatch.setattr(os, "statvfs", lambda path: os.statvfs_result((*told[:8], flag, *told[9:])))
    with pytest.raises(ConfigError, match=f"Cannot write into {tmp_path}: {words}; choose"):
        check_folder(tmp_path / "new")
