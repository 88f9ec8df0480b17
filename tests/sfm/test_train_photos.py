"""gscore train and gscore info on plain photos: cameras estimated first, kept, and refused."""

import html
import json
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscore.commands import main
from gscore.inspection.capture_facts import photo_folder_facts
from gscore.io.colmap.folder import read_model
from gscore.option_marks import show_flags
from gscore.sfm.photos import list_photos

from .conftest import NEAR, STUDIO

Out = pytest.CaptureFixture[str]
SHORT = ["--iterations", "4", "--max-splats", "400", "-r", "4", "--json"]


@pytest.fixture
def mine(photos: Path, tmp_path: Path) -> Path:
    """A writable copy of the photos."""
    shutil.copytree(photos, tmp_path / "holiday")
    return tmp_path / "holiday"


def _train(*words: object) -> int:
    return main(["train", *map(str, words), *SHORT])


def test_cameras_are_found_once_and_kept(mine: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: the capture in the output folder, its modification time, and the JSON."""
    out = tmp_path / "out"
    assert _train(mine, "-o", out) == 0
    said = capsys.readouterr()
    assert "Finding the cameras of 8 photos, which takes about" in said.err
    assert json.loads(said.out.splitlines()[-1])["splats"] > 0
    model = out / "capture/sparse/0/images.bin"
    assert len(read_model(out / "capture").images) == len(NEAR)
    assert json.loads((out / "config.json").read_text())["data"]["source"] == str(out / "capture")
    written = model.stat().st_mtime_ns
    page = (out / "report.html").read_text()
    assert "<h1>holiday</h1>" in page
    (command,) = re.findall(r'<pre class="command">(gscore train .*?)</pre>', page)
    # As on screen, over the initial output.
    assert main([*shlex.split(command)[1:], "--overwrite", "--json"]) == 0
    assert model.stat().st_mtime_ns == written
    capsys.readouterr()

    assert _train(mine, "-o", out, "--overwrite") == 0
    again = capsys.readouterr().err
    assert "Finding the cameras" not in again and "other files" not in again
    assert model.stat().st_mtime_ns == written

    assert main(["train", "-o", str(out), "--resume", "--iterations", "6", "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["steps"] == 6
    further = ["-o", str(out), "--resume", "--iterations", "8", "--json"]
    assert main(["train", str(mine), *further]) == 0
    assert "Finding the cameras" not in capsys.readouterr().err

    (mine / "front/view 000.jpg").touch()
    assert _train(mine, "-o", out, "--overwrite") == 2
    assert "contains the cameras of other photos" in capsys.readouterr().err
    assert model.stat().st_mtime_ns == written and (out / "point_cloud.ply").is_file()


def test_a_run_that_was_moved_takes_its_capture_along(
    mine: Path, tmp_path: Path, capsys: Out
) -> None:
    """Oracle: the same figures from `gscore eval` as before, and a run that resumes."""
    assert _train(mine, "-o", tmp_path / "out") == 0
    moved = (tmp_path / "out").rename(tmp_path / "moved")
    capsys.readouterr()
    assert main(["eval", str(moved), "--json"]) == 0
    again = json.loads(capsys.readouterr().out.splitlines()[-1])
    before = json.loads((moved / "metrics.json").read_text())
    assert again["psnr"] == pytest.approx(before["psnr"], abs=1e-6)
    assert main(["train", "-o", str(moved), "--resume", "--iterations", "6", "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["steps"] == 6
    assert json.loads((moved / "config.json").read_text())["data"]["source"] == str(
        moved / "capture"
    )


def test_a_taken_folder_is_refused_before_the_search(
    mine: Path, tmp_path: Path, capsys: Out
) -> None:
    """Oracle: exit code 2 and the existing file, alone."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "point_cloud.ply").write_bytes(b"mine")
    assert _train(mine, "-o", out) == 2
    assert "may be from another program" in capsys.readouterr().err
    assert [path.name for path in out.iterdir()] == ["point_cloud.ply"]


@pytest.mark.parametrize(
    ("flag", "value", "said"),
    [
        ("--region", "no.json", "no.json"),
        ("--region", "half.json", "one corner of two"),
        ("--guide-surface", "no.ply", "no.ply"),
        ("--guide-free", "half.json", "half.json"),
        ("--start-splats", "no.ply", "no.ply"),
        ("--hold-out", "no.txt", "no.txt"),
        ("--lpips", "no.onnx", "no.onnx"),
        ("--hold-out", "none.txt", "leaves no view to test"),
        ("--hold-out", "strange.txt", "has 1 view that the capture does not have"),
        ("--hold-out", "first:8", "leaves no view to train"),
        ("--start-checkpoint", "no.safetensors", "no.safetensors"),
        ("--start-checkpoint", "half.json", "is not a complete checkpoint"),
        ("-d", "depths", "gscore depth OUTPUT/capture"),
        ("--depth-mode", "on", "Leave --depth-mode on out"),
        ("--port", "99999", "port"),
    ],
)
def test_option_files_are_checked_before_the_search(
    mine: Path, tmp_path: Path, capsys: Out, flag: str, value: str, said: str
) -> None:
    """Oracle: exit code 2, a sentence about the file, and no search."""
    (tmp_path / "half.json").write_text('{"low": [0, 0, 0]}')
    (tmp_path / "none.txt").touch()
    (tmp_path / "strange.txt").write_text("nobody.jpg")
    given = tmp_path / value if "." in value else value
    assert _train(mine, "-o", tmp_path / "out", flag, given) == 2
    error = capsys.readouterr().err
    assert said in error and "Finding the cameras" not in error
    assert not (tmp_path / "out").exists()


def test_a_list_of_test_views_is_one_of_the_photos(mine: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: names below the folder, which pass before the search and split after it."""
    (tmp_path / "list.txt").write_text("front/view 001.jpg\n")
    assert _train(mine, "-o", tmp_path / "out", "--hold-out", tmp_path / "list.txt") == 0
    capsys.readouterr()
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["split"] == "test" and len(metrics["views"]) == 1


def test_a_run_that_never_began_is_not_resumed(mine: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: exit code 2 and no search, with a preset too, which needs no config.json."""
    out = tmp_path / "out"
    assert _train(mine, "-o", out, "--resume", "--preset", "preview") == 2
    assert "no checkpoint to resume from" in capsys.readouterr().err and not out.exists()


@pytest.mark.parametrize("place", ["film.mp4", "film.mp4/run"])
def test_a_file_as_output_is_refused_at_once(
    mine: Path, tmp_path: Path, capsys: Out, place: str
) -> None:
    """Oracle: the sentence, which names the given file and no other; no photo is read."""
    (tmp_path / "film.mp4").write_bytes(b"x")
    assert _train(mine, "-o", tmp_path / place) == 2
    assert capsys.readouterr().err.splitlines() == [
        f"gscore train: error: {tmp_path / 'film.mp4'} is a file; a folder is needed. "
        "Choose another output."
    ]


def test_without_sfm_photos_are_refused(mine: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: exit code 2, a sentence, no files."""
    assert _train(mine, "-o", tmp_path / "out", "--no-sfm") == 2
    err = capsys.readouterr().err.rstrip()
    assert "Leave out --no-sfm" in err and "no cameras for them" in err
    assert err.endswith(f"gscore sfm {mine} -o {mine}-capture")  # to be copied: no full stop
    assert not (tmp_path / "out").exists()


def test_photos_of_which_nothing_can_be_made_leave_nothing(tmp_path: Path, capsys: Out) -> None:
    """Oracle: exit code 2, the reason, and no output folder."""
    from PIL import Image

    photos = tmp_path / "photos"
    photos.mkdir()
    for i in range(4):
        Image.new("RGB", (120, 90), (100 + i, 90, 80)).save(photos / f"{i}.png")
    assert _train(photos, "-o", tmp_path / "out") == 2
    assert "too little texture" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_info_tells_what_photos_need(mine: Path, capsys: Out) -> None:
    """Oracle: the photos, all pairs of them, and the next command."""
    (mine / "x.nef").write_bytes(b"")
    assert main(["info", str(mine), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    count = len(NEAR)
    assert facts["kind"] == "photos" and facts["photos"] == count and facts["cameras"] == 1
    assert facts["pairs"] == count * (count - 1) // 2 and facts["unread"] == ["x.nef"]
    assert 0 < facts["sfm_seconds"] < 60
    assert main(["info", str(mine)]) == 0
    assert f"Next: gscore train {mine} -o run" in capsys.readouterr().out


def test_info_finds_blank_photos(mine: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: white photos are named, those of the studio are not."""
    white = tmp_path / "white"
    white.mkdir()
    for i in range(4):
        Image.new("RGB", (320, 240), "white").save(white / f"{i}.jpg")
    assert main(["info", str(white)]) == 0
    text = capsys.readouterr()
    assert "are blank" in text.err + text.out and "Next:" not in text.out
    assert main(["info", str(mine)]) == 0
    text = capsys.readouterr()
    assert "are blank" not in text.err + text.out


def _saved(view: int, path: Path) -> None:
    """A photo of the studio as a phone saves it, taken in second `view`."""
    exif = Image.Exif()
    exif[0x0110] = "Phone 9"
    exif.get_ifd(0x8769)[0x9003] = f"2026:01:01 10:00:{view:02}"
    with Image.open(STUDIO / f"images/view_{view:03}.jpg") as photo:
        if path.suffix == ".HEIC":
            writer = pytest.importorskip("pillow_heif")
            writer.from_pillow(photo).save(path, quality=95, exif=exif.tobytes())
        else:
            photo.save(path, exif=exif)


@pytest.mark.parametrize("ending", ["png", "HEIC"])
def test_info_counts_a_shot_of_two_files_once(ending: str, tmp_path: Path, capsys: Out) -> None:
    """Oracle: four exposures, three of them saved twice; a file of the same name with another
    time is another photo."""
    for view in (0, 1, 2):
        _saved(view, tmp_path / f"IMG_{view}.jpg")
        _saved(view, tmp_path / f"IMG_{view}.{ending}")
    _saved(3, tmp_path / "IMG_3.jpg")
    _saved(4, tmp_path / "IMG_3.webp")
    assert main(["info", str(tmp_path), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["photos"], facts["cameras"], facts["pairs"]) == (5, 1, 10)
    assert sum(facts["sizes"].values()) == 5


def test_files_of_one_shot_count_once_in_the_panel(tmp_path: Path) -> None:
    """Oracle: JPEGs of a phone and of a camera with the files they come from, whose headers need
    packages that Blender lacks."""
    for view in range(4):
        _saved(view, tmp_path / f"IMG_{view}.JPG")
        (tmp_path / f"IMG_{view}{'.HEIC' if view < 2 else '.NEF'}").write_bytes(b"")
    facts = photo_folder_facts(tmp_path)
    assert (facts.photos, facts.problems) == (4, ())
    (tmp_path / "IMG_9.NEF").write_bytes(b"")
    [problem] = photo_folder_facts(tmp_path).problems
    assert "1 photo is of a kind that is not read: IMG_9.NEF" in problem.text
    assert list_photos(tmp_path, ())[1] == ["IMG_0.HEIC", "IMG_1.HEIC", "IMG_9.NEF"]


@pytest.mark.parametrize("camera", ["RICOH THETA Z1", "Phone 9", ""])
def test_info_names_panoramas(camera: str, tmp_path: Path, capsys: Out) -> None:
    """Oracle: pictures twice as wide as high of a 360-degree camera, which the search refuses in
    the same words, of a phone with its focal length, and of an unknown camera."""
    exif = Image.Exif()
    exif[0x0110] = camera
    if camera == "Phone 9":
        exif.get_ifd(0x8769)[0x920A] = 4.2
    for i in range(4):
        noise = Image.effect_noise((64, 32), 90)
        noise.save(tmp_path / f"{i}.jpg", exif=exif)
    assert main(["info", str(tmp_path), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    if camera == "Phone 9":
        assert facts["warnings"] == [] and facts["next"]
        return
    if not camera:
        assert facts["next"] and "4 photos are twice as wide as high" in facts["warnings"][0]
        return
    assert facts["next"] is None and "4 photos show all directions" in facts["warnings"][0]
    assert main(["sfm", str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    messages = " ".join(capsys.readouterr().err.split())
    assert messages.endswith(show_flags(facts["warnings"][0]))


def _screens(folder: Path) -> Path:
    """Eight pictures of eight sizes, as in a folder of documents."""
    folder.mkdir()
    for i in range(8):
        Image.new("RGB", (300 + 7 * i, 200 + i)).save(folder / f"screen {i}.png")
    return folder


def test_pictures_that_are_no_photos_of_a_scene(mine: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: screenshots, a git clone, a folder of captures: info names each, and recommends no
    training; the search reports it first, and refuses photos that belong to captures."""
    clone, above = tmp_path / "clone", tmp_path / "above"
    shutil.copytree(mine, clone)
    (clone / ".git").mkdir()
    shutil.copytree(mine, above / "first" / "images")
    (above / "first" / "sparse").mkdir()
    cases = {_screens(tmp_path / "docs"): "typical of screenshots", clone: "is a git repository"}
    for folder, words in (cases | {above: f"contains a capture, {above / 'first'}."}).items():
        assert main(["info", str(folder), "--json"]) == 0
        facts = json.loads(capsys.readouterr().out)
        assert facts["next"] is None and words in facts["warnings"][0]
        assert main(["info", str(folder)]) == 0
        said = capsys.readouterr().out
        assert "Next:" not in said and words in said
        assert any(words in problem.text for problem in photo_folder_facts(folder).problems)
    assert _train(above, "-o", tmp_path / "refused") == 2
    assert f"contains a capture, {above / 'first'}. Give" in " ".join(
        capsys.readouterr().err.split()
    )
    assert not (tmp_path / "refused").exists()
    assert _train(tmp_path / "docs", "-o", tmp_path / "out") == 2
    assert "typical of screenshots" in capsys.readouterr().err


def test_a_capture_with_broken_cameras_is_none_of_plain_photos(
    mine: Path, tmp_path: Path, capsys: Out
) -> None:
    """Oracle: unreadable cameras, which are reported and not estimated again."""
    sparse = mine / "sparse/0"
    sparse.mkdir(parents=True)
    (sparse / "cameras.bin").write_bytes(b"torn")
    assert _train(mine, "-o", tmp_path / "out") == 2
    assert "Finding the cameras" not in capsys.readouterr().err
    assert not (tmp_path / "out/capture").exists()


def test_photos_of_a_capture_are_not_plain(mine: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: the folder with the cameras is named, and none are estimated again."""
    for name, given in (("images", ""), ("input", " with --images input")):
        capture = tmp_path / f"capture of {name}"
        shutil.copytree(mine, capture / name)
        assert main(["info", str(capture / name)]) == 0
        (capture / "sparse/0").mkdir(parents=True)
        capsys.readouterr()
        assert _train(capture / name, "-o", tmp_path / "out") == 2
        assert main(["info", str(capture / name)]) == 2
        said = " ".join(capsys.readouterr().err.split())
        assert said.count(f"give {capture}{given}.") == 2 and "Finding the cameras" not in said
    assert not (tmp_path / "out").exists()


def test_photos_without_a_camera_are_reported(mine: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: a photo of noise without matches: the training reports it, also in its report
    file."""
    shape = np.asarray(Image.open(mine / "front/view 000.jpg")).shape
    noise = np.random.default_rng(1).integers(0, 256, shape, np.uint8)
    Image.fromarray(noise).save(mine / "front/elsewhere.jpg")
    out = tmp_path / "out"
    assert _train(mine, "-o", out) == 0
    words = "8 of 9 photos have a camera. 1 photo matches no other: front/elsewhere.jpg."
    assert words in " ".join(capsys.readouterr().err.split())
    assert words in html.unescape((out / "report.html").read_text())
