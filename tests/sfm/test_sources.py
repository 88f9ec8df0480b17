"""Several sources in one search, photos converted to JPEG first, and the files after a failure."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscore.commands import main
from gscore.inspection.capture_facts import photo_folder_facts
from gscore.io.colmap.folder import read_model
from gscore.sfm import heic, staging
from gscore.sfm.output_path import CaptureOutput, default_capture_output
from gscore.sfm.search_request import SearchRequest
from tests.video import films

from .conftest import render_cloud

Out = pytest.CaptureFixture[str]


@pytest.fixture(scope="session")
def views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sixteen pictures around a cloud of splats."""
    folder = tmp_path_factory.mktemp("cloud")
    render_cloud(folder, seed=3, views=16)
    return folder


def _view(views: Path, number: int) -> Path:
    return views / f"s3_{number}.png"


def _copy(views: Path, folder: Path, numbers: range) -> Path:
    folder.mkdir(parents=True)
    for number in numbers:
        shutil.copy(_view(views, number), folder / f"{number}.png")
    return folder


def _film(views: Path, path: Path, numbers: range) -> Path:
    return films.write(path, [np.array(Image.open(_view(views, n))) for n in numbers], rate=4)


def test_two_folders_and_a_video_are_one_capture(views: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: the names of the given files, and COLMAP's model of all of them."""
    first = _copy(views, tmp_path / "a/photos", range(5))
    second = _copy(views, tmp_path / "b/photos", range(5, 9))
    film = _film(views, tmp_path / "walk.mp4", range(9, 16))
    capture = tmp_path / "capture"
    call = ["sfm", str(first), str(second), str(film), "-o", str(capture), "--json"]
    assert main(call) == 0
    facts = json.loads(capsys.readouterr().out.splitlines()[-1])
    names = {image.name for image in read_model(capture).images}
    folders = {name.split("/")[0] for name in names}
    assert folders == {"photos", "photos-2", "walk"}
    assert {n for n in names if n.startswith("photos/")} == {f"photos/{i}.png" for i in range(5)}
    assert facts["registered"] == len(names) >= 0.9 * facts["photos"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b", "capture", "walk.mp4"]
    assert (capture / "images/photos/0.png").stat().st_ino == (first / "0.png").stat().st_ino

    assert main(call) == 2
    assert "already contains cameras" in capsys.readouterr().err


def test_staged_folder_is_reused(views: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: the time of the folder; a changed source is refused."""
    sources = [_copy(views, tmp_path / "a", range(3)), _copy(views, tmp_path / "b", range(2, 5))]
    request = SearchRequest(photos=sources[0], output=tmp_path / "capture")
    staging.stage_photos(request, sources)
    before = (tmp_path / "capture/images").stat().st_mtime_ns
    staging.stage_photos(request, sources)
    assert (tmp_path / "capture/images").stat().st_mtime_ns == before
    (sources[1] / "2.png").touch()
    assert main(["sfm", *map(str, sources), "-o", str(tmp_path / "capture")]) == 2
    assert "photos of other sources" in capsys.readouterr().err


def test_masks_of_each_source_go_along(views: Path, tmp_path: Path) -> None:
    """Oracle: the files, by their paths."""
    sources = [_copy(views, tmp_path / "a", range(2)), _copy(views, tmp_path / "b", range(2))]
    (sources[1] / "masks").mkdir()
    Image.new("L", (256, 256), 255).save(sources[1] / "masks/1.png")
    staging.stage_photos(SearchRequest(photos=sources[0], output=tmp_path / "c"), sources)
    found = {p.relative_to(tmp_path / "c").as_posix() for p in (tmp_path / "c").rglob("*.png")}
    photos = {f"images/{name}/{i}.png" for name in "ab" for i in range(2)}
    assert found == photos | {"masks/b/1.png.png"}


def test_sources_that_cannot_work_leave_nothing(views: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: exit code 2, the sentence, and the unchanged folder."""
    first = _copy(views, tmp_path / "a", range(3))
    _copy(views, first / "inner", range(3, 5))
    (tmp_path / "bare").mkdir()
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(b"no video at all")
    noise = tmp_path / "noise"
    noise.mkdir()
    rng = np.random.default_rng(0)
    for i in range(3):
        pixels = rng.integers(0, 256, (60, 60, 3)).astype(np.uint8)
        Image.fromarray(pixels).resize((240, 240)).save(noise / f"{i}.png")
    before = sorted(tmp_path.rglob("*"))
    for words, why in (
        ([first, first], "was given twice"),
        ([first, first / "inner"], "would count twice"),
        ([first, tmp_path / "bare"], "contains no photos"),
        ([first, tmp_path / "none"], "There is no folder"),
        ([first, broken], "cannot be opened as a video"),
        ([first, noise, "--frames", 9], "is not a video"),
        ([noise, tmp_path / "a/inner"], "No cameras found"),
    ):
        target = tmp_path / "deep/capture"
        assert main(["sfm", *map(str, words), "-o", str(target), "--quiet"]) == 2, why
        said = " ".join(capsys.readouterr().err.split())
        assert why in said and "Traceback" not in said
        assert sorted(tmp_path.rglob("*")) == before


def test_heic_is_refused_in_words_where_nothing_reads_it(
    views: Path, tmp_path: Path, capsys: Out, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: exit code 2, and the command that installs the reader."""
    monkeypatch.setattr(heic, "can_read", lambda: False)
    (tmp_path / "photos").mkdir()
    for i in range(4):
        (tmp_path / f"photos/IMG_{i}.HEIC").write_bytes(b"heic")
    assert main(["sfm", str(tmp_path / "photos"), "-o", str(tmp_path / "capture")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert 'convert to JPEG, or for HEIC: pip install "gscore[heic]"' in said
    assert [path.name for path in tmp_path.iterdir()] == ["photos"]


def _as_heic(source: Path, target: Path, orientation: int = 1) -> None:
    writer = pytest.importorskip("pillow_heif")
    exif = Image.Exif()
    exif[0x0110], exif[0x0112] = "Phone 9", orientation
    target.parent.mkdir(exist_ok=True)
    with Image.open(source) as picture:
        writer.from_pillow(picture).save(target, quality=95, exif=exif.tobytes())


def test_heic_photos_become_jpeg(views: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: the pictures packed as HEIC, and EXIF's model."""
    for i in range(6):
        _as_heic(_view(views, i), tmp_path / f"photos/IMG {i}.HEIC")
    assert main(["info", str(tmp_path / "photos"), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["photos"], facts["sizes"], facts["unread"]) == (6, {"256 x 256": 6}, [])
    assert photo_folder_facts(tmp_path / "photos").photos == 6
    capture = tmp_path / "capture"
    assert default_capture_output(tmp_path / "photos") == CaptureOutput(
        tmp_path / "photos-capture", False
    )
    assert main(["sfm", str(tmp_path / "photos"), "-o", str(capture), "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["registered"] >= 5
    with Image.open(capture / "images/IMG 2.HEIC.jpg") as made, Image.open(_view(views, 2)) as own:
        off = np.asarray(made, float) - np.asarray(own.convert("RGB"), float)
        assert np.abs(off).mean() < 6 and made.getexif()[0x0110] == "Phone 9"

    short = ["--iterations", "4", "--max-splats", "400", "--json"]
    out = tmp_path / "out"
    for more, found in (([], True), (["--overwrite"], False)):
        assert main(["train", str(tmp_path / "photos"), "-o", str(out), *short, *more]) == 0
        assert ("Finding the cameras" in capsys.readouterr().err) is found
    (capture).rename(tmp_path / "photos-capture")
    assert default_capture_output(tmp_path / "photos") == CaptureOutput(
        tmp_path / "photos-capture", True
    )


def test_a_turned_heic_photo_stands_upright(views: Path, tmp_path: Path) -> None:
    """Oracle: numpy turns the picture; the orientation is not applied twice."""
    with Image.open(_view(views, 0)) as own:
        own.convert("RGB").crop((0, 0, 200, 120)).save(tmp_path / "flat.png")
    _as_heic(tmp_path / "flat.png", tmp_path / "x/turned.heic", orientation=6)
    heic.write_jpeg(tmp_path / "x/turned.heic", tmp_path / "out.jpg")
    with Image.open(tmp_path / "out.jpg") as made, Image.open(tmp_path / "flat.png") as own:
        assert made.getexif().get(0x0112, 1) == 1
        expected = np.rot90(np.asarray(own, float), -1)
        assert made.size == (120, 200)
        assert np.abs(np.asarray(made, float) - expected).mean() < 8


def test_a_damaged_heic_photo_is_a_sentence(tmp_path: Path, capsys: Out) -> None:
    """Oracle: exit code 2, the file's name, no files."""
    pytest.importorskip("pillow_heif")
    (tmp_path / "photos").mkdir()
    for i in range(4):
        (tmp_path / f"photos/{i}.heic").write_bytes(b"\0\0\0\x18ftypheic" + bytes(300))
    assert main(["sfm", str(tmp_path / "photos"), "-o", str(tmp_path / "capture")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "0.heic cannot be read as a HEIC photo" in said and "Traceback" not in said
    assert [path.name for path in tmp_path.iterdir()] == ["photos"]
