"""A video as the source of `gscore sfm`, `train` and `info`: its frames, kept and used again."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscore.commands import main
from gscore.io.colmap.folder import read_model
from gscore.sfm.output_path import CaptureOutput, default_capture_output, has_no_cameras
from tests.video import films

from .conftest import render_cloud

Out = pytest.CaptureFixture[str]
VIEWS = 12
SHORT = ["--iterations", "4", "--max-splats", "400", "--json"]


@pytest.fixture(scope="session")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A film of twelve steps around a cloud of splats."""
    folder = tmp_path_factory.mktemp("walk")
    render_cloud(folder / "views", seed=3, views=VIEWS)
    pictures = [np.array(Image.open(folder / f"views/s3_{i}.png")) for i in range(VIEWS)]
    return films.write(folder / "walk.mp4", pictures, rate=4)


def _times(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in sorted(folder.iterdir())}


def test_sfm_of_a_video_is_one_call(walk: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: COLMAP's reader on the written model, and the twelve places of the film."""
    capture = tmp_path / "capture"
    assert main(["sfm", str(walk), "-o", str(capture), "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    frames = list((capture / "images").glob("*.jpg"))
    assert found["registered"] == found["photos"] == len(frames) > VIEWS // 2
    assert {image.name for image in read_model(capture).images} == {frame.name for frame in frames}

    assert main(["sfm", str(walk), "-o", str(capture)]) == 2
    assert "already contains cameras" in capsys.readouterr().err


def test_a_training_takes_frames_once(walk: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: the modification times of frames and cameras, and the message for another video."""
    out = tmp_path / "out"
    assert main(["train", str(walk), "-o", str(out), *SHORT]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["splats"] > 0
    frames, model = _times(out / "capture/images"), _times(out / "capture/sparse/0")
    assert json.loads((out / "config.json").read_text())["data"]["source"] == str(out / "capture")

    assert main(["train", str(walk), "-o", str(out), "--overwrite", *SHORT]) == 0
    assert _times(out / "capture/images") == frames
    assert _times(out / "capture/sparse/0") == model
    assert main(["train", "-o", str(out), "--resume", "--iterations", "6", "--json"]) == 0

    other = tmp_path / "other.mp4"
    other.write_bytes(walk.read_bytes() + b"\0" * 8)
    capsys.readouterr()
    assert main(["train", str(other), "-o", str(out), "--overwrite", *SHORT]) == 2
    assert "contains frames of another video" in capsys.readouterr().err
    assert _times(out / "capture/sparse/0") == model


def test_refusals_leave_nothing(walk: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: exit code 2, the reason, and the unchanged folder."""
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(b"no video at all")
    taken = tmp_path / "taken"
    taken.mkdir()
    (taken / "letter.txt").write_text("mine")
    for words, why in (
        (["sfm", broken, "-o", tmp_path / "a/b"], "cannot be opened as a video"),
        (["sfm", walk, "-o", taken], "is not empty"),
        (["sfm", walk, "-o", tmp_path / "c", "--frames", "2"], "frames is 2"),
        (["sfm", taken, "-o", tmp_path / "c", "--frames", "9"], "--frames is for videos"),
        (["train", walk, "-o", tmp_path / "d", "--no-sfm"], "is a video without cameras"),
    ):
        assert main([str(word) for word in words]) == 2
        assert why in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["broken.mp4", "taken"]
    assert [path.name for path in taken.iterdir()] == ["letter.txt"]


def test_info_of_a_video(walk: Path, capsys: Out) -> None:
    """Oracle: the parameters that made the film."""
    assert main(["info", str(walk), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["kind"], facts["frames"], facts["width"], facts["height"]) == (
        "video", VIEWS, 256, 256,
    )  # fmt: skip
    assert main(["info", str(walk)]) == 0
    said = capsys.readouterr().out
    assert f"a video, {VIEWS} frames, 3 s, 256 x 256 px" in said
    assert f"gscore train {walk} -o run" in said.replace("\n", " ")


def test_where_a_capture_goes_by_itself(walk: Path, photos: Path, tmp_path: Path) -> None:
    """Oracle: names made here; a folder in use is never returned."""
    mine = tmp_path / "holiday"
    (mine / "images").mkdir(parents=True)
    for photo in photos.rglob("*.jpg"):
        (mine / "images" / photo.name).write_bytes(photo.read_bytes())
    assert has_no_cameras(mine) and has_no_cameras(walk) and not has_no_cameras(tmp_path / "no")
    assert (
        default_capture_output(mine)
        == default_capture_output(mine / "images")
        == CaptureOutput(mine, False)
    )

    (mine / "images").rename(tmp_path / "day one")
    assert default_capture_output(tmp_path / "day one") == CaptureOutput(
        tmp_path / "day one-capture", False
    )
    (tmp_path / "day one-capture").mkdir()
    assert not default_capture_output(tmp_path / "day one").capture.name.endswith("-2")
    (tmp_path / "day one-capture/letter.txt").write_text("mine")
    assert default_capture_output(tmp_path / "day one") == CaptureOutput(
        tmp_path / "day one-capture-2", False
    )

    film = tmp_path / "walk.mp4"
    film.write_bytes(walk.read_bytes())
    assert default_capture_output(film) == CaptureOutput(tmp_path / "walk-capture", False)
    assert main(["sfm", str(film), "-o", str(tmp_path / "walk-capture"), "--quiet"]) == 0
    assert default_capture_output(film) == CaptureOutput(tmp_path / "walk-capture", True)
    film.write_bytes(walk.read_bytes() + b"\0" * 8)
    assert default_capture_output(film) == CaptureOutput(tmp_path / "walk-capture-2", False)
