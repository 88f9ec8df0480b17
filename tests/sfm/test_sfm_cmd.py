"""gscore sfm: cameras of photos alone, its verdict, interruptions and refusals."""

import json
import shutil
import sqlite3
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gscore.commands import main
from gscore.config import DataConfig
from gscore.control import Control
from gscore.datasets import load_dataset
from gscore.errors import Cancelled, DatasetError, GsError
from gscore.events import Event, SfmDone, SfmEstimated, SfmProgress
from gscore.io.colmap.folder import read_model
from gscore.sfm import SearchRequest, database, find_cameras, pairs
from gscore.sfm.photos import photos_of, same_photos
from gscore.sfm.pycolmap_thread import run_in_thread
from gscore.sfm.search_result import SearchResult

from .conftest import NEAR, STUDIO, render_cloud

Out = pytest.CaptureFixture[str]


def _centers(capture: Path) -> dict[str, np.ndarray]:
    images = read_model(capture).images
    return {i.name: -i.viewmat[:3, :3].T @ i.viewmat[:3, 3] for i in images}


def _aligned_errors(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Distances after the best similarity (Umeyama 1991), as shares of the true extent."""
    a, b = true - true.mean(0), found - found.mean(0)
    u, s, vt = np.linalg.svd(a.T @ b)
    flip = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    turned = b @ (u * flip @ vt).T * (s * flip).sum() / (b**2).sum()
    return np.linalg.norm(a - turned, axis=1) / np.linalg.norm(a, axis=1).max()


def _hidden(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.name.startswith("."))


@pytest.fixture(scope="module")
def found(photos: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict, list[Event]]:
    """A capture made of the photos, the verdict and the messages."""
    capture = tmp_path_factory.mktemp("made") / "capture"
    reported: list[Event] = []
    result = find_cameras(SearchRequest(photos=photos, output=capture), on_event=reported.append)
    return capture, result.facts(), reported


def test_cameras_are_where_they_were(found: tuple[Path, dict, list[Event]]) -> None:
    """Oracle: the cameras that rendered the photos, after a similarity alignment."""
    capture, facts, _ = found
    assert facts["photos"] == facts["registered"] == len(NEAR) and facts["models"] == 1
    assert facts["alone"] == () and facts["reprojection_px"] < 0.6 and facts["points"] > 150
    there = _centers(capture)
    true = _centers(STUDIO)
    names = sorted(there)
    assert names == sorted(f"{'left side' if i > 20 else 'front'}/view {i:03}.jpg" for i in NEAR)
    given = np.array([true[Path(name).name.replace(" ", "_")] for name in names])
    assert _aligned_errors(np.array([there[name] for name in names]), given).max() < 0.05
    assert facts["cameras"][0]["focal_px"] == pytest.approx(856.7 / 2, rel=0.03)


def test_the_capture_is_one(found: tuple[Path, dict, list[Event]], photos: Path) -> None:
    """Oracle: the reader of captures, and the bytes of the photos."""
    capture, facts, _ = found
    dataset = load_dataset(DataConfig(source=capture, resolution=1))
    assert len(dataset) == len(NEAR) and len(dataset.scene.points) == facts["points"]
    assert dataset.warnings == ()
    for name in dataset.names:
        assert (capture / "images" / name).read_bytes() == (photos / name).read_bytes()
    assert sorted(path.name for path in capture.iterdir()) == ["images", "sfm.json", "sparse"]
    assert _hidden(capture.parent) == []


def test_progress_is_reported(found: tuple[Path, dict, list[Event]]) -> None:
    """Oracle: the phases in their order, and the last event."""
    _, facts, reported = found
    phases = [event.phase for event in reported if isinstance(event, SfmProgress)]
    assert list(dict.fromkeys(phases)) == [
        "reading photos",
        "entering photos",
        "finding features",
        "comparing photos",
        "placing cameras",
        "adjusting cameras",
        "writing the capture",
    ]
    assert all(e.done <= e.total for e in reported if isinstance(e, SfmProgress))
    (forecast,) = (event for event in reported if isinstance(event, SfmEstimated))
    assert forecast.photos == len(NEAR) and 0 < forecast.seconds < 60
    left = [
        e.left_s for e in reported if isinstance(e, SfmProgress) and e.phase == "comparing photos"
    ]
    assert left[-1] == left[-1] and left[-1] < 600
    assert isinstance(reported[-1], SfmDone) and reported[-1].registered == facts["registered"]


def test_the_same_photos_give_the_same_cameras(
    found: tuple[Path, dict, list[Event]], photos: Path, tmp_path: Path
) -> None:
    """Oracle: the first model, up to rounding, because threads add in another order."""
    again = tmp_path / "again"
    result = find_cameras(SearchRequest(photos=photos, output=again))
    assert result.points == found[1]["points"]
    first, second = _centers(found[0]), _centers(again)
    assert first.keys() == second.keys()
    for name, center in first.items():
        np.testing.assert_allclose(second[name], center, atol=1e-5)


def test_many_photos_are_joined_by_what_they_show(
    photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: eight photos treated as many, with names that join the folders nowhere; a camera for
    each, and one more phase in the messages."""
    for name, value in (("EXHAUSTIVE", 4), ("_OVERLAP", 1), ("_KEY_PHOTOS", 2)):
        monkeypatch.setattr(pairs, name, value)
    reported: list[Event] = []
    result = find_cameras(
        SearchRequest(photos=photos, output=tmp_path / "c"), on_event=reported.append
    )
    assert result.registered == len(NEAR) and result.attempts == 1
    phases = [event.phase for event in reported if isinstance(event, SfmProgress)]
    names = list(dict.fromkeys(phases))
    assert names[names.index("choosing pairs") - 1] == "finding features"


def test_a_stopped_search_goes_on(photos: Path, tmp_path: Path) -> None:
    """Oracle: only the hidden folder is left, and the second search has its features."""
    capture, control = tmp_path / "capture", Control()

    def stop(event: Event) -> None:
        if isinstance(event, SfmProgress) and event.phase == "comparing photos":
            control.stop()

    request = SearchRequest(photos=photos, output=capture)
    with pytest.raises(Cancelled):
        find_cameras(request, on_event=stop, control=control)
    assert [path.name for path in tmp_path.iterdir()] == [".capture.sfm"]
    reported: list[Event] = []
    result = find_cameras(request, on_event=reported.append)
    assert result.resumed and result.registered == len(NEAR) and _hidden(tmp_path) == []


_SEARCH = """
import sys
from pathlib import Path
from gscore.events import SfmProgress
from gscore.sfm import SearchRequest, find_cameras
def tell(event):
    if isinstance(event, SfmProgress):
        print(event.phase, event.done, flush=True)
find_cameras(SearchRequest(photos=Path(sys.argv[1]), output=Path(sys.argv[2])), on_event=tell)
"""


def test_a_killed_search_goes_on(photos: Path, tmp_path: Path) -> None:
    """Oracle: the features and cameras of a search killed while photos are compared, in the next
    search; while it ran, another was refused by name."""
    capture = tmp_path / "capture"
    command = [sys.executable, "-c", _SEARCH, str(photos), str(capture)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as search:
        assert search.stdout is not None
        for line in search.stdout:
            if line.startswith("comparing photos"):
                break
        request = SearchRequest(photos=photos, output=capture)
        try:
            with pytest.raises(GsError, match=rf"another search for cameras .*{search.pid}"):
                find_cameras(request)
        finally:
            search.kill()
    assert search.returncode < 0 and not capture.exists()
    features = sum(database.features(tmp_path / ".capture.sfm/usual.db"))
    reported: list[Event] = []
    result = find_cameras(request, on_event=reported.append)
    assert result.resumed and result.registered == len(NEAR) and _hidden(tmp_path) == []
    assert features > 1000


def test_changed_photos_restart_the_search(photos: Path, tmp_path: Path) -> None:
    """Oracle: a search from the start where a photo was written again since the stop."""
    mine, control = tmp_path / "photos", Control()
    shutil.copytree(photos, mine)
    request = SearchRequest(photos=mine, output=tmp_path / "capture")

    def stop(event: Event) -> None:
        if isinstance(event, SfmProgress) and event.phase == "finding features":
            control.stop()

    with pytest.raises(Cancelled):
        find_cameras(request, on_event=stop, control=control)
    (mine / "front/view 000.jpg").touch()
    assert not find_cameras(request).resumed


def _replaced(photo: Path) -> None:
    """Replace the photo by another picture of the same name."""
    with Image.open(photo) as picture:
        picture.transpose(Image.Transpose.ROTATE_180).save(photo.with_name("new.tmp"), "JPEG")
    photo.with_name("new.tmp").replace(photo)


def _written_to(photo: Path) -> None:
    with Image.open(photo) as picture:
        picture.transpose(Image.Transpose.FLIP_LEFT_RIGHT).save(photo, "JPEG")


def _search_while(change: Callable[[Path], object], mine: Path, capture: Path) -> SearchResult:
    """A search during which a photo is changed as soon as features are found."""
    changed: list[object] = []

    def at_once(event: Event) -> None:
        if isinstance(event, SfmProgress) and event.phase == "comparing photos" and not changed:
            changed.append(change(mine / "front/view 001.jpg"))

    return find_cameras(SearchRequest(photos=mine, output=capture), on_event=at_once)


@pytest.mark.parametrize("change", [_replaced, Path.unlink])
def test_photos_replaced_during_a_search(change: Any, photos: Path, tmp_path: Path) -> None:
    """Oracle: the searched bytes in the capture, and a warning that names the photo."""
    mine, capture = shutil.copytree(photos, tmp_path / "photos"), tmp_path / "capture"
    found = _search_while(change, mine, capture)
    for photo in photos.rglob("*.jpg"):
        assert (capture / "images" / photo.relative_to(photos)).read_bytes() == photo.read_bytes()
    (said,) = [sentence for sentence in found.warnings if "changed" in sentence]
    assert "1 photo changed" in said and "front/view 001.jpg" in said
    assert not same_photos(capture, photos_of(SearchRequest(photos=mine, output=capture)))


def test_photos_replaced_in_a_capture(photos: Path, tmp_path: Path) -> None:
    """Oracle: no cameras next to other photos; with the first photos back the search is resumed."""
    mine = shutil.copytree(photos, tmp_path / "capture/images")
    with pytest.raises(GsError, match=r"1 photo changed .*: front/view 001\.jpg"):
        _search_while(_replaced, mine, tmp_path / "capture")
    assert not (tmp_path / "capture/sparse").exists()
    shutil.copy2(photos / "front/view 001.jpg", mine / "front")
    assert find_cameras(SearchRequest(photos=mine, output=tmp_path / "capture")).resumed


def test_a_photo_written_to_during_a_search(photos: Path, tmp_path: Path) -> None:
    """Oracle: a sentence, no capture, and no results."""
    mine = shutil.copytree(photos, tmp_path / "photos")
    with pytest.raises(DatasetError, match=r"1 photo changed .*: front/view 001\.jpg"):
        _search_while(_written_to, mine, tmp_path / "capture")
    assert [path.name for path in tmp_path.iterdir()] == ["photos"]


@pytest.mark.parametrize(
    ("free", "says"), [(1 << 30, "No factory. Its"), (4096, "disk is full, or nearly")]
)
def test_an_error_of_colmap_is_a_sentence(
    free: int, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: an error as pycolmap raises it where SQLite cannot write, and the free space."""

    def work(token: object) -> None:
        raise RuntimeError("[database.cc:7] No factory.")

    usage = shutil.disk_usage(tmp_path)._replace(free=free)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: usage)
    with pytest.raises(GsError, match=says):
        run_in_thread(work, tmp_path, tick=lambda: None, cancelled=lambda: False)


@pytest.mark.parametrize(
    "error", [FileNotFoundError(2, "gone"), RuntimeError("No factory."), sqlite3.OperationalError()]
)
def test_a_work_folder_that_is_removed_is_a_sentence(error: Exception, tmp_path: Path) -> None:
    """Oracle: the errors that Python, pycolmap and SQLite raise once their folder is removed."""
    folder = tmp_path / ".capture.sfm"
    folder.mkdir()

    def work(token: object) -> None:
        folder.rmdir()
        raise error

    with pytest.raises(GsError, match=r"capture\.sfm was removed during .* from the beginning"):
        run_in_thread(work, folder, tick=lambda: None, cancelled=lambda: False)


def test_full_disk_stops_before_colmap_fails(
    photos: Path, tmp_path: Path, capsys: Out, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: exit code 2 and the sentence; the same command resumes once there is space."""
    usage = shutil.disk_usage(tmp_path)
    sizes = iter([10**10] * 2)
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "disk_usage", lambda f: usage._replace(free=next(sizes, 10**6)))
        assert main(["sfm", str(photos), "-o", str(tmp_path / "capture")]) == 2
    said = capsys.readouterr().err
    assert "the disk is full, or nearly, with 1 MB free" in said and "Traceback" not in said
    assert [path.name for path in tmp_path.iterdir()] == [".capture.sfm"]
    assert main(["sfm", str(photos), "-o", str(tmp_path / "capture"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["resumed"]


def test_photos_of_a_capture_stay_in_place(photos: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: only sparse is added; the last line is JSON; a second search is refused."""
    capture = tmp_path / "capture"
    shutil.copytree(photos, capture / "images")
    masks = {path: path.relative_to(photos) for path in photos.rglob("*.jpg")}
    for path, name in masks.items():
        with Image.open(path) as photo:
            mask = np.full((photo.height, photo.width), 255, np.uint8)
        mask[:, : mask.shape[1] // 3] = 0
        target = capture / "masks" / f"{name}.png"
        target.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(mask).save(target)
    assert main(["sfm", str(capture), "-o", str(capture), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out.splitlines()[-1])
    wanted = {"photos", "registered", "models", "points", "reprojection_px", "seconds"}
    assert wanted <= facts.keys() and facts["registered"] >= 6
    assert sorted(path.name for path in capture.iterdir()) == [
        "images",
        "masks",
        "sfm.json",
        "sparse",
    ]
    model = read_model(capture)
    seen = np.concatenate([i.xys[i.point3D_ids >= 0] for i in model.images])
    assert len(seen) > 100 and seen[:, 0].min() >= 240 // 3, "features that a mask hides"
    assert main(["sfm", str(capture), "-o", str(capture)]) == 2
    assert "already contains cameras" in capsys.readouterr().err


def _noise(folder: Path, count: int) -> None:
    rng = np.random.default_rng(0)
    for i in range(count):
        pixels = rng.integers(0, 256, (60, 60, 3)).astype(np.uint8)
        Image.fromarray(pixels).resize((240, 240)).save(folder / f"{i}.png")


def _one(folder: Path) -> None:
    _noise(folder, 1)


def _none(folder: Path) -> None:
    (folder / "IMG_1.NEF").write_bytes(b"raw")


def _copies(folder: Path) -> None:
    _noise(folder, 1)
    for i in range(1, 6):
        shutil.copy(folder / "0.png", folder / f"{i}.png")


def _smooth(folder: Path) -> None:
    for i in range(4):
        Image.new("RGB", (120, 90), (100 + i, 90, 80)).save(folder / f"{i}.png")


def _unrelated_photos(folder: Path) -> None:
    _noise(folder, 4)


def _broken(folder: Path) -> None:
    _noise(folder, 4)
    whole = (folder / "2.png").read_bytes()
    (folder / "2.png").write_bytes(whole[: len(whole) // 2])


def _still(folder: Path) -> None:
    """The same view four times, with a little noise."""
    rng = np.random.default_rng(0)
    with Image.open(STUDIO / "images/view_000.jpg") as photo:
        pixels = np.asarray(photo.resize((240, 320)), np.int16)
    for i in range(4):
        noisy = np.clip(pixels + rng.integers(-3, 4, pixels.shape), 0, 255).astype(np.uint8)
        Image.fromarray(noisy).save(folder / f"{i}.png")


def _turned(folder: Path) -> None:
    """A camera that turns on the spot: one photo under homographies."""
    with Image.open(STUDIO / "images/view_000.jpg") as photo:
        pixels = np.asarray(photo.convert("RGB"))
    height, width = pixels.shape[:2]
    y, x = np.mgrid[0:240, 0:320]
    rays = np.stack([(x - 160) / 300, (y - 120) / 300, np.ones_like(x, float)], axis=-1)
    for i in range(7):
        c, s = np.cos(0.07 * (i - 3)), np.sin(0.07 * (i - 3))
        turned = rays @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        where = turned[..., :2] / turned[..., 2:] * 0.6 * width + [width / 2, height / 2]
        column, row = where.astype(int).transpose(2, 0, 1).clip(0, [[[width - 1]], [[height - 1]]])
        Image.fromarray(pixels[row, column]).save(folder / f"{i}.png")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (_one, "1 photo"),
        (_none, "convert to JPEG"),
        (_copies, "copies of others"),
        (_smooth, "too little texture"),
        (_unrelated_photos, "No two of the 4 photos overlap"),
        (_broken, "2.png cannot be read"),
        (_still, "copies of others"),
        (_turned, "no parallax"),
    ],
)
def test_bad_photos_are_a_sentence(make, words: str, tmp_path: Path, capsys: Out) -> None:
    """Oracle: exit code 2, a sentence with the reason, and no files."""
    photos = tmp_path / "photos"
    photos.mkdir()
    make(photos)
    before = sorted(photos.rglob("*"))
    assert main(["sfm", str(photos), "-o", str(tmp_path / "deep/capture"), "--quiet"]) == 2
    err = capsys.readouterr().err
    assert words.lower() in err.lower() and "Traceback" not in err
    assert list(tmp_path.iterdir()) == [photos] and sorted(photos.rglob("*")) == before


def test_existing_files_are_not_touched(photos: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: exit code 2 and the unchanged file."""
    (tmp_path / "notes.txt").write_text("mine")
    assert main(["sfm", str(photos), "-o", str(tmp_path)]) == 2
    assert "is not empty" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.slow
def test_two_scenes_are_reported(tmp_path: Path) -> None:
    """Oracle: the photos of each scene by their names; the larger scene is used."""
    render_cloud(tmp_path / "photos", 1, 8)
    render_cloud(tmp_path / "photos", 2, 5)
    capture = tmp_path / "capture"
    result = find_cameras(SearchRequest(photos=tmp_path / "photos", output=capture))
    assert {name[:2] for name in _centers(capture)} == {"s1"}
    assert {name[:2] for part in result.models[1:] for name in part} <= {"s2"}
    others = {*result.alone, *(name for part in result.models[1:] for name in part)}
    assert {name for name in others if name[:2] == "s2"} == {f"s2_{i}.png" for i in range(5)}
    said = " ".join(result.lines())
    assert "s2_0.png" in said and ("separate model" in said or "match" in said)
    assert result.attempts > 1 and any("Trying again" in text for text in result.warnings)


def test_a_folder_of_something_else_stays(photos: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: exit code 2, and the unchanged file in the folder that the search would use."""
    mine = tmp_path / ".capture.sfm" / "state.json"
    mine.parent.mkdir()
    mine.write_bytes(struct.pack("<I", 7))
    assert main(["sfm", str(photos), "-o", str(tmp_path / "capture"), "--quiet"]) == 2
    assert "contains other files" in capsys.readouterr().err
    assert mine.read_bytes() == struct.pack("<I", 7)
