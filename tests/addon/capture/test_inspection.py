"""Inspection of good and bad folders before a training."""

import json
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from addon.capture.inspection import ShownFacts, inspect
from addon.core import find_capture
from gscore.io.images.png import write_png
from tests.addon.captures import ROOT, STUDIO, write_capture, write_photo

PINHOLE = {1: ("PINHOLE", 60, 40, (50.0, 50.0, 30.0, 20.0))}


def texts(facts: ShownFacts, errors: bool) -> str:
    """All problems of one kind."""
    return "\n".join(p.text for p in facts.problems if p.is_error == errors)


def _write(folder: Path) -> None:
    """Twenty different small photos of one camera."""
    rng = np.random.default_rng(0)
    write_capture(folder, rng, cameras=PINHOLE, images=20, photos=True)
    for photo in sorted((folder / "images" / "sub").iterdir()):
        write_png(photo, rng.integers(0, 256, (40, 60, 3)).astype(np.uint8))


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """Twenty small photos of one camera."""
    folder = tmp_path / "c"
    _write(folder)
    return folder


def test_studio() -> None:
    """Oracle: the known content of the example; no problems."""
    facts = inspect(STUDIO)
    assert (facts.kind, facts.model) == ("COLMAP", STUDIO / "sparse" / "0")
    assert (facts.photos, facts.missing, facts.points) == (60, (), 6725)
    assert facts.camera_models == {"PINHOLE": 60} and facts.sizes == {(480, 640): 60}
    assert (facts.masks, facts.depths, facts.depth_params) == (60, 60, 60)
    assert facts.can_train and facts.problems == ()
    rows = dict(facts.lines())
    assert rows["Photos"] == "60 of 60" and rows["Size"] == "480 x 640 px"
    assert rows["Cameras"] == "60"
    assert rows["Points"] == "6,725" and rows["Depths"] == "60 maps, 60 scales"


@pytest.mark.parametrize(
    "inside", ["", "sparse", "sparse/0", "sparse/0/cameras.bin", "images", "images/view_000.jpg"]
)
def test_capture_is_found_from_any_of_its_parts(inside: str) -> None:
    """Oracle: the folder above `sparse`, whichever part of the capture was picked."""
    assert find_capture(STUDIO / inside) == STUDIO
    assert inspect(STUDIO / inside).photos == 60


def test_folders_that_are_no_captures(tmp_path: Path) -> None:
    """Oracle: a message with the folder and what to do; never an exception."""
    assert "Choose a folder" in texts(inspect(""), True)
    facts = inspect(tmp_path / "nowhere")
    assert "no folder" in texts(facts, True) and not facts.can_train and facts.lines() == []
    assert "is empty" in texts(inspect(tmp_path), True)
    (tmp_path / "database.db").write_bytes(b"")
    assert "mapper has not been run" in texts(inspect(tmp_path), True)
    shutil.copytree(STUDIO / "images", tmp_path / "photos")
    bare = inspect(tmp_path)  # cameras can be found, so nothing is wrong with it
    assert (bare.bare, bare.problems, bare.can_train) == ("photos", (), False)
    assert bare.lines() == [("Photos", "60"), ("Size", "480 x 640 px")]
    (tmp_path / "transforms.json").write_text("{")
    assert "is not JSON" in texts(inspect(tmp_path), True)


@pytest.mark.parametrize("end", [0, 7, 100, 4000])
def test_truncated_models(capture: Path, end: int) -> None:
    """Oracle: the message names the file, wherever it was truncated."""
    file = capture / "sparse" / "0" / "images.bin"
    file.write_bytes(file.read_bytes()[:end])
    facts = inspect(capture)
    assert not facts.can_train and "images.bin" in texts(facts, True)


def test_missing_photos(capture: Path) -> None:
    """Oracle: up to half is a note, more is an error; photos in another folder are pointed out."""
    files = sorted((capture / "images" / "sub").iterdir())
    for file in files[:3]:
        file.unlink()
    facts = inspect(capture)
    assert facts.can_train and facts.missing == ("sub/v000.png", "sub/v001.png", "sub/v002.png")
    assert "3 of the 20 images of the model are missing" in texts(facts, False)
    for file in files[3:12]:
        file.unlink()
    facts = inspect(capture)
    assert not facts.can_train and "12 of the 20 images of the model in" in texts(facts, True)
    assert facts.photos == 8
    shutil.rmtree(capture / "images")
    _write(capture)
    (capture / "images").rename(capture / "input")
    assert inspect(capture).can_train, "a folder that other programs use"
    (capture / "input").rename(capture / "images_2")
    assert "They are in images_2" in texts(inspect(capture), True)
    assert inspect(capture, images="images_2").can_train


def test_photos_without_a_camera(capture: Path) -> None:
    """Oracle: a photo more than the model has."""
    write_photo(capture / "images" / "extra.png", 60, 40)
    assert inspect(capture).without_camera == 1


def test_sizes(capture: Path) -> None:
    """Oracle: half the size fits and is reported, another shape does not and is named, garbage is
    refused as in training."""
    write_photo(capture / "images" / "sub" / "v004.png", 30, 20)
    (problem,) = inspect(capture).problems
    assert not problem.is_error and "1 photo has another size than the camera" in problem.text
    write_photo(capture / "images" / "sub" / "v005.png", 40, 60)
    facts = inspect(capture)
    assert "v005.png is 40 x 60 pixels, its camera was calibrated for 60 x 40" in texts(facts, True)
    (capture / "images" / "sub" / "v005.png").write_bytes(b"rubbish")
    facts = inspect(capture)
    if find_spec("PIL") is None:
        assert facts.can_train and "1 photo cannot be checked here" in texts(facts, False)
    else:
        assert not facts.can_train and "v005.png" in texts(facts, True)


def test_photos_stored_sideways(capture: Path) -> None:
    """Oracle: EXIF's 6 turns 40 x 60 pixels into the camera's 60 x 40; without it they misfit."""
    write_photo(capture / "images" / "sub" / "v005.png", 40, 60, turn=6)
    facts = inspect(capture)
    assert facts.can_train and "1 photos are stored sideways" in texts(facts, False)


def test_masks(capture: Path) -> None:
    """Oracle: files next to names in COLMAP's layout; a different size is an error."""
    for i in range(19):
        write_photo(capture / "masks" / "sub" / f"v{i:03}.png.png", 60, 40)
    facts = inspect(capture)
    assert facts.masks == 19 and "1 of 20 views have no mask" in texts(facts, False)
    write_photo(capture / "masks" / "sub" / "v003.png.png", 60, 41)
    facts = inspect(capture)
    assert not facts.can_train and "60 x 41" in texts(facts, True)


def test_depths(capture: Path) -> None:
    """Oracle: maps without scales, scales that are damaged, scales for some."""
    for i in range(20):
        write_photo(capture / "depths" / "sub" / f"v{i:03}.png", 60, 40)
    assert "no depth_params.json" in texts(inspect(capture), False)
    file = capture / "sparse" / "0" / "depth_params.json"
    for damaged in ("{", "[]", '{"sub/v000": 3}', '{"sub/v000": null}'):
        file.write_text(damaged)
        facts = inspect(capture)
        assert facts.depth_params == 0 and facts.can_train
        assert "depth_params.json" in texts(facts, False)
    entries = {f"sub/v{i:03}": {"scale": 1, "offset": 0} for i in range(15)}
    file.write_text(json.dumps(entries | {"sub/v003": {"scale": 90, "offset": 0}}))
    facts = inspect(capture)
    report = facts.depth_report
    assert report.counts == {"accepted": 14, "refused": 6}
    assert "times the median" in report.by_view["sub/v003.png"].reason
    assert facts.depth_params == 15 and "5 of 20 photos lack a depth map" in texts(facts, False)


def test_cameras_and_points(tmp_path: Path) -> None:
    """Oracle: distortion is counted; unequal focal lengths and too few points are warnings."""
    write_capture(tmp_path, np.random.default_rng(0), points=20)
    facts = inspect(tmp_path)
    notes = texts(facts, False)
    assert "4 with lens distortion" in dict(facts.lines())["Cameras"]
    assert "not square" in notes and "40.2%" in notes
    assert "Only 20 SfM points" in notes
    write_capture(tmp_path, np.random.default_rng(0), points=0)
    assert "The capture has no points" in texts(inspect(tmp_path), False)


def test_needs_neither_blender_nor_pillow() -> None:
    """Oracle: a fresh Python in which these cannot be imported."""
    code = (
        "import sys\n"
        "for name in ('bpy', 'mathutils', 'PIL', 'torch', 'scipy', 'pycolmap'):\n"
        "    sys.modules[name] = None\n"
        "import addon.cameras.alignment, addon.cameras.camera_math\n"
        "from addon.capture.inspection import inspect\n"
        f"print(inspect({str(STUDIO)!r}).can_train)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert done.stdout.strip() == "True", done.stderr
