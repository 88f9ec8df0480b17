"""Files of other programs, named where a capture or a PLY is expected."""

import gzip
import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from gscore.commands import main
from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.errors import GsError
from gscore.inspection.capture_facts import photo_folder_facts
from gscore.io.block_record import BLOCK_RECORD
from gscore.io.images.png import write_png
from gscore.io.ply.splats import read_ply
from gscore.io.unsupported_formats import describe_unsupported, unread_cameras


def _zip(*names: str) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as file:
        for name in names:
            file.writestr(name, b"x" * 40_000)
    return made.getvalue()


_METASHAPE = b'<?xml version="1.0"?>\n<document version="2.0.0">\n<chunk label="1">\n<cameras/>'
FILES = {
    "spz": (gzip.compress(b"NGSP" + bytes(60)), "SPZ", "gscore info"),
    "spz 4": (b"NGSP" + bytes(60), "SPZ", "gscore info"),
    "splat": (bytes(64), "antimatter15", "gscore info"),
    "ksplat": (bytes(4096), "mkkellogg", "gscore info"),
    "sog": (_zip("means_l.webp", "sh0.webp", "meta.json"), "SOG", "gscore info"),
    "gltf": (json.dumps({"asset": {"version": "2.0"}}).encode(), "glTF", "gscore info"),
    "glb": (b"glTF\2\0\0\0" + bytes(20), "glTF", "gscore info"),
    "usda": (b"#usda 1.0\n", "USD", "gscore info"),
    "usdc": (b"PXR-USDC" + bytes(80), "USD", "gscore info"),
    "usdz": (_zip("scene.usdc"), "USD", "gscore info"),
    "mp4": (b"\0\0\0\x20ftypisom" + bytes(20), "a video", "gscore sfm"),
    "mov": (b"\0\0\0\x14ftypqt  " + bytes(20), "a video", "gscore sfm"),
    "mkv": (b"\x1a\x45\xdf\xa3" + bytes(20), "a video", "gscore sfm"),
    "avi": (b"RIFF\0\0\0\0AVI LIST", "a video", "gscore sfm"),
    "zip": (_zip("images/a.jpg", "b.txt"), "a ZIP archive", "Unpack"),
    "e57": (b"ASTM-E57" + bytes(40), "E57", "COLMAP's format"),
    "las": (b"LASF" + bytes(40), "LAS", "COLMAP's format"),
    "xml": (_METASHAPE, "camera file of Metashape", "with it and the photos"),
    "psx": (b'<document version="1.2.0" path="{projectname}.files/project.zip"/>',
            "Metashape", "COLMAP's format"),
    "psz": (_zip("doc.xml", "frame.zip"), "project of Metashape", "COLMAP's format"),
    "r3d": (_zip("metadata", "icon"), "Record3D", "ns-process-data record3d"),
    "rcproj": (b"<RealityCaptureProject/>", "RealityCapture", "COLMAP's format"),
    "xmp": (b'<x:xmpmeta><rdf:Description xmlns:xcr="" xcr:Version="3"/>',
            "RealityCapture", "with it and the photos"),
    "db": (b"SQLite format 3\0" + bytes(80), "database of COLMAP", "sparse/0"),
    "ckpt": (_zip("archive/data.pkl"), "PyTorch", "Export a 3DGS PLY"),
    "jpg": (b"\xff\xd8\xff\xe0" + bytes(40), "a single photo", "folder"),
    "blend": (b"BLENDER-v405", "Blender", "add-on"),
}  # fmt: skip
"""By the usual ending: the first bytes by the format's definition, and words of the message."""
BY_NAME = ("splat", "ksplat", "gltf", "psx", "psz", "r3d")
"""Formats without a signature, detected by their ending."""


@pytest.fixture(params=FILES)
def given(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, str, str]:
    """A file under its usual ending, its name in sentences and a word of the advice."""
    content, name, advice = FILES[request.param]
    path = tmp_path / f"scan.{request.param.split()[0]}"
    path.write_bytes(content)
    return path, name, advice


def test_by_content(given: tuple[Path, str, str]) -> None:
    """Oracle: the signatures in the formats' definitions, under another ending too."""
    path, name, advice = given
    assert (
        name in describe_unsupported(path)
        and advice in describe_unsupported(path)
        and str(path) in describe_unsupported(path)
    )
    if path.suffix[1:] not in BY_NAME:
        renamed = path.rename(path.with_suffix(".ply"))
        assert name in describe_unsupported(renamed)


def test_where_a_ply_or_a_capture_is_expected(given: tuple[Path, str, str]) -> None:
    """Oracle: the same sentence from both readers, which all verbs and the add-on use."""
    path, name, _ = given
    words = r"gscore does not read|video without cameras|not a capture|not splats|is not XML"
    with pytest.raises(GsError, match=words) as of_splats:
        read_ply(path)
    with pytest.raises(GsError, match=words) as of_capture:
        load_dataset(DataConfig(source=path))
    assert name in str(of_splats.value)
    if path.suffix != ".xml":  # cameras of Metashape are a capture; this one is truncated
        assert name in str(of_capture.value)


@pytest.mark.parametrize(
    "line", ["info {}", "train {} -o {}.out", "render {} -o {}.png", "eval {} -o {}.out"]
)
def test_every_verb_says_so(line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: exit code 2 and one sentence with the format's name."""
    path = tmp_path / "scan"
    path.write_bytes(FILES["e57"][0])
    assert main(line.replace("{}", str(path)).split()) == 2
    err = capsys.readouterr().err
    assert "E57" in err and "COLMAP's format" in err and "Traceback" not in err
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("verb", ["depth {} --check", "train {} -o {}/run --no-sfm"])
@pytest.mark.parametrize("place", ["images", ".", "monday"])
def test_photos_without_cameras(
    place: str, verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the command that finds cameras; photos in `images` stay in their folder."""
    folder = tmp_path / "my photos"
    for i in range(3):
        write_png(folder / place / f"{i}.png", np.zeros((4, 4, 3), np.uint8))
    assert main([word.replace("{}", str(folder)) for word in verb.split()]) == 2
    err = capsys.readouterr().err
    assert "has 3 photos, but no cameras" in err
    made = folder if place == "images" else tmp_path / "my photos-capture"
    assert f"gscore sfm '{folder}' -o '{made}'" in err


def test_a_folder_of_other_things(tmp_path: Path) -> None:
    """Oracle: the sentence on its content; SOG unpacked; none for unknown content."""
    assert describe_unsupported(tmp_path) == "" and describe_unsupported(tmp_path / "nowhere") == ""
    (tmp_path / "notes.txt").write_text("none of them")
    assert (
        describe_unsupported(tmp_path) == "" and describe_unsupported(tmp_path / "notes.txt") == ""
    )
    (tmp_path / "walk.mov").write_bytes(FILES["mov"][0])
    assert "walk.mov is a video" in describe_unsupported(tmp_path)
    bundle = tmp_path / "sog"
    bundle.mkdir()
    (bundle / "meta.json").write_text("{}")
    (bundle / "means_l.webp").write_bytes(b"RIFF")
    assert "SOG" in describe_unsupported(bundle)


def test_own_folders_are_named_with_their_verb(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: sentences with the folder, its kind, and the verb for it."""
    blocks, runs, run = (tmp_path / name for name in ("blocks", "runs", "run"))
    for k in range(2):
        write_png(blocks / f"block_{k}" / "images" / "a.png", np.zeros((4, 4, 3), np.uint8))
        (blocks / f"block_{k}" / BLOCK_RECORD).write_text("{}")
    for folder in (runs / "block_0", runs / "block_1", run):
        folder.mkdir(parents=True)
        for name in ("config.json", "point_cloud.ply"):
            (folder / name).touch()
    assert "2 blocks" in describe_unsupported(
        blocks
    ) and f"gscore train {blocks}" in describe_unsupported(blocks)
    assert "2 trainings" in describe_unsupported(
        runs
    ) and f"gscore merge {runs}" in describe_unsupported(runs)
    assert "folder of a training. Give the capture" in describe_unsupported(run)
    (run / "capture").mkdir()
    assert f"Its capture is {run / 'capture'}" in describe_unsupported(run)
    (tmp_path / "empty").mkdir()
    for line, said in (
        (f"render {runs} -o {tmp_path}/out", "gscore merge"),
        (f"eval {runs}", "gscore merge"),
        (f"info {tmp_path}/empty", "is an empty folder"),
        (f"train {tmp_path}/empty -o {tmp_path}/out", "is an empty folder"),
        (f"frames {run} -o {tmp_path}/out", "is a folder; gscore frames reads a video"),
    ):
        assert main(line.split()) == 2
        assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_capture_where_a_run_is_expected(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the command that trains it."""
    (tmp_path / "sparse" / "0").mkdir(parents=True)
    for name in ("cameras", "images", "points3D"):
        (tmp_path / "sparse" / "0" / f"{name}.txt").write_text("")
    assert main(["render", str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    assert f"is a capture; train it first: gscore train {tmp_path}" in capsys.readouterr().err


UNREAD = {
    "scan.psx": (b"<document/>", "project of Metashape", "Agisoft XML"),
    "scan.rsproj": (b"x", "RealityScan", "Internal/External Camera Parameters"),
    "scan.rcalign": (b"x", "RealityScan", "Internal/External Camera Parameters"),
    "bundle.out": (b"# Bundle file v0.3\n", "Bundler", "COLMAP's format"),
    "scan.nvm": (b"NVM_V3\n", "VisualSFM", "COLMAP's format"),
    "block.xml": (b"<BlocksExchange version='2.1'>", "ContextCapture", "COLMAP's format"),
    "sfm_data.json": (b'{"sfm_data_version": "0.3"', "OpenMVG", "openMVG2Colmap"),
    "cameras.sfm": (b'{"version": ["1"], "featuresFolders": []', "Meshroom", "ExportColmap"),
    "a_calibrated_camera_parameters.txt": (b"x", "Pix4D", "COLMAP's format"),
    "mesh_info.json": (b"{}", "Polycam", "ns-process-data polycam"),
    "metadata": (b'{"w": 1, "K": [], "poses": []', "Record3D", "ns-process-data record3d"),
    "poses.json": (b'{"frames": [{"transform_matrix": []}]}', "layout of transforms.json", "call"),
}
INDEXES = {
    "tileset.json": (b'{"asset": {"version": "1.1"}, "geometricError": 9, "root": {}}', "3D Tiles"),
    "lod-meta.json": (b'{"version": 1, "lodLevels": 2, "filenames": []}', "Streamed SOG"),
}


@pytest.mark.parametrize("name", [*UNREAD, *INDEXES])
@pytest.mark.parametrize("place", ["", "images"])
def test_cameras_among_photos_that_are_not_read(
    name: str, place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: each program's own file name and first bytes; its kind and export advice, in `info`
    and in the facts of the panel."""
    for i in range(3):
        write_png(tmp_path / "images" / f"{i}.png", np.zeros((4, 4, 3), np.uint8))
    content, kind, *advice = (UNREAD | INDEXES)[name]
    (tmp_path / place / name).write_bytes(content)
    assert main(["info", str(tmp_path)]) == 0
    out = " ".join(capsys.readouterr().out.split())
    for words in (name, kind, *advice):
        assert words in out
    assert any(name in problem.text for problem in photo_folder_facts(tmp_path).problems)
    assert bool(unread_cameras(tmp_path / "images")) == (place == "images")


@pytest.mark.parametrize("name", INDEXES)
def test_an_index_of_splats_is_named(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the specifications' names and keys; given itself or by its folder, to verbs for
    splats and to those for captures."""
    content, kind = INDEXES[name]
    path = tmp_path / name
    path.write_bytes(content)
    verbs = (["info"], ["convert", str(tmp_path / "o.ply")], ["train", "-o", str(tmp_path / "run")])
    for given in (path, tmp_path):
        for line in verbs:
            assert main([line[0], str(given), *line[1:]]) == 2
            err = " ".join(capsys.readouterr().err.split())
            assert f"{name} is the index of a {kind}" in err, (line, given)
