"""Frames of a video as files: their content, their folder, and second runs."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscore.commands import main
from gscore.control import Control
from gscore.errors import Cancelled, ConfigError, DatasetError, GsError
from gscore.events import Event, FramesDone, FramesProgress
from gscore.video import ExtractRequest, extract_frames, is_video
from gscore.video.frame_folder import FrameFolder

from . import films
from .conftest import Film

Out = pytest.CaptureFixture[str]


def _pixels(folder: Path) -> dict[str, np.ndarray]:
    there = sorted(path for path in folder.iterdir() if path.suffix != ".json")
    return {path.name: np.asarray(Image.open(path)).astype(int) for path in there}


def _psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / max(((a - b) ** 2).mean(), 1e-9)))


@pytest.mark.parametrize("kind", ["jpg", "png"])
def test_files_hold_the_frames_their_names_say(film: Film, tmp_path: Path, kind: str) -> None:
    """Oracle: the pictures the video was made of; a smaller loss by JPEG than by the video."""
    done = extract_frames(
        ExtractRequest(video=film.path, output=tmp_path / "out", frames=20, format=kind)
    )
    found = _pixels(tmp_path / "out")
    assert list(found) == list(done.names) and 17 <= len(found) <= 20
    for name, pixels in found.items():
        index = int(name[6:12])
        true = film.pictures[index].astype(int)
        right = _psnr(pixels, true)
        assert right > 22  # loss of the video itself at its noise
        for other in (index - 1, index + 1):
            assert right > _psnr(pixels, film.pictures[other].astype(int)) + 3
    record = json.loads((tmp_path / "out" / "frames.json").read_text())
    times = [row["seconds"] for row in record["frames"]]
    assert np.allclose(times, [int(name[6:12]) / 30 for name in found], atol=1e-3)


def test_jpeg_costs_next_to_nothing(film: Film, tmp_path: Path) -> None:
    """Oracle: the same frames as PNG: more than 40 dB, with the colours at full resolution."""
    for kind in ("jpg", "png"):
        request = ExtractRequest(video=film.path, output=tmp_path / kind, frames=8, format=kind)
        extract_frames(request)
    pairs = zip(_pixels(tmp_path / "jpg").values(), _pixels(tmp_path / "png").values(), strict=True)
    assert min(_psnr(a, b) for a, b in pairs) > 40
    first = next((tmp_path / "jpg").glob("*.jpg"))
    with Image.open(first) as picture:
        assert [layer[1:3] for layer in picture.layer] == [(1, 1)] * 3  # type: ignore[attr-defined]


def test_the_same_video_gives_the_same_bytes(film: Film, tmp_path: Path) -> None:
    """Oracle: the files of another run."""
    for name in ("one", "two"):
        extract_frames(ExtractRequest(video=film.path, output=tmp_path / name, frames=15))
    one, two = ({p.name: p.read_bytes() for p in (tmp_path / n).iterdir()} for n in ("one", "two"))
    assert one == two


def test_a_second_run_finds_its_frames(film: Film, tmp_path: Path) -> None:
    """Oracle: the times of the files; other options are refused, a missing file is detected."""
    out = tmp_path / "out"
    first = extract_frames(ExtractRequest(video=film.path, output=out, frames=10))
    stamps = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    reported: list[Event] = []
    again = extract_frames(
        ExtractRequest(video=film.path, output=out, frames=10), on_event=reported.append
    )
    assert again.found and not first.found and again.names == first.names
    assert stamps == {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    assert [type(event) for event in reported] == [FramesDone]
    with pytest.raises(ConfigError, match="other options"):
        extract_frames(ExtractRequest(video=film.path, output=out, frames=12))
    (out / first.names[0]).unlink()
    with pytest.raises(ConfigError, match="contains frames"):
        extract_frames(ExtractRequest(video=film.path, output=out, frames=10))


def test_frames_are_replaced_where_that_is_asked_for(
    film: Film, tmp_path: Path, capsys: Out
) -> None:
    """Oracle: the folder afterwards: the new frames alone; unchanged with a user's file next to the
    old ones."""
    out = tmp_path / "out"
    line = ["frames", str(film.path), "-o", str(out), "--quiet"]
    assert main([*line, "--frames", "10"]) == 0
    old = {path.name: path.read_bytes() for path in out.iterdir()}
    assert main([*line, "--frames", "12"]) == 2
    assert "--overwrite" in capsys.readouterr().err
    (out / "mine.jpg").write_bytes(b"mine")
    assert main([*line, "--frames", "12", "--overwrite"]) == 2
    assert "mine.jpg" in capsys.readouterr().err
    (out / "mine.jpg").unlink()
    assert {path.name: path.read_bytes() for path in out.iterdir()} == old
    assert main([*line, "--frames", "12", "--overwrite"]) == 0
    rows = json.loads((out / "frames.json").read_text())["frames"]
    names = {row["name"] for row in rows} | {"frames.json"}
    assert {path.name for path in out.iterdir()} == names and len(rows) == 12
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_one_process_at_a_time_writes_into_a_folder(film: Film, tmp_path: Path) -> None:
    """Oracle: the sentence of the second, begun while the first analyses and while it writes, and
    the frames of the first alone; a third finds them."""
    request = ExtractRequest(video=film.path, output=tmp_path / "new/out", frames=10)
    refused: set[str] = set()

    def show(event: Event) -> None:
        if isinstance(event, FramesProgress) and event.phase not in refused:
            with pytest.raises(GsError, match="in use by another run of gscore frames"):
                extract_frames(replace(request, format="png"))
            refused.add(event.phase)

    first = extract_frames(request, on_event=show)
    assert refused == {"looking at frames", "writing frames"}
    assert {p.name for p in (tmp_path / "new/out").iterdir()} == {*first.names, "frames.json"}
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["out"]
    assert extract_frames(request).found


def test_frames_of_another_process_that_has_ended_meanwhile_are_found(
    film: Film, tmp_path: Path
) -> None:
    """Oracle: the names and times of the files of that process."""
    request = ExtractRequest(video=film.path, output=tmp_path / "out", frames=10)
    waiting = FrameFolder(request)
    extract_frames(request)
    with waiting.writing():
        assert waiting.found is not None and len(waiting.found["frames"]) == 10


@pytest.mark.parametrize("name", ["mine.jpg", "frames", "lock2"])
def test_a_hidden_folder_of_somebody_else_stays(film: Film, tmp_path: Path, name: str) -> None:
    """Oracle: the user's file in `.new.frames`, and the sentence that names the folder."""
    theirs = tmp_path / ".new.frames" / name
    theirs.parent.mkdir()
    theirs.write_text("mine")
    with pytest.raises(ConfigError, match=r"\.new\.frames is the temporary folder"):
        extract_frames(ExtractRequest(video=film.path, output=tmp_path / "new"))
    assert theirs.read_text() == "mine" and not (tmp_path / "new").exists()


def test_remains_of_a_killed_run_are_replaced(film: Film, tmp_path: Path) -> None:
    """Oracle: the folder afterwards, without a stale lock and half of the frames."""
    left = tmp_path / ".out.frames"
    (left / "frames").mkdir(parents=True)
    (left / "lock").write_text('{"pid": 1}')
    (left / "frames/frame_000001.jpg").write_bytes(b"half")
    done = extract_frames(ExtractRequest(video=film.path, output=tmp_path / "out", frames=10))
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert "frame_000001.jpg" not in done.names


@pytest.mark.parametrize(
    "key",
    ["width", "height", "total", "blurred", "repeated", "warnings", "frames", "name", "seconds"],
)
@pytest.mark.parametrize("value", ["gone", None, "x", {}, [1]])
def test_a_record_that_lacks_something_is_no_record(
    film: Film, taken: Path, key: str, value: object
) -> None:
    """Oracle: frames treated as incomplete; a sentence on how to replace them."""
    path = taken / "frames.json"
    before = path.read_text()
    record = json.loads(before)
    place = record["frames"][0] if key in ("name", "seconds") else record
    place.pop(key) if value == "gone" else place.update({key: value})
    path.write_text(json.dumps(record))
    try:
        with pytest.raises(ConfigError, match=r"or not all of them.*--overwrite"):
            extract_frames(ExtractRequest(video=film.path, output=taken, frames=10))
    finally:
        path.write_text(before)


@pytest.fixture(scope="module")
def taken(film: Film, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of ten frames."""
    out = tmp_path_factory.mktemp("taken") / "out"
    extract_frames(ExtractRequest(video=film.path, output=out, frames=10))
    return out


def test_a_folder_of_others_is_left_alone(film: Film, tmp_path: Path) -> None:
    """Oracle: the folder afterwards."""
    (tmp_path / "mine.txt").write_text("x")
    with pytest.raises(ConfigError, match="something else"):
        extract_frames(ExtractRequest(video=film.path, output=tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.parametrize("phase", ["looking at frames", "writing frames"])
def test_stopping_leaves_nothing(film: Film, tmp_path: Path, phase: str) -> None:
    """Oracle: the folder after a stop in each phase."""
    control = Control()

    def show(event: Event) -> None:
        if isinstance(event, FramesProgress) and event.phase == phase:
            control.stop()

    with pytest.raises(Cancelled):
        request = ExtractRequest(video=film.path, output=tmp_path / "out")
        extract_frames(request, on_event=show, control=control)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_nothing(
    film: Film, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the sentence, and the folder."""
    import errno

    from gscore.video import frame_folder

    def full(*_: object) -> str:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(frame_folder.FrameFolder, "put", full)
    with pytest.raises(GsError, match="the disk is full"):
        extract_frames(ExtractRequest(video=film.path, output=tmp_path / "out"))
    assert list(tmp_path.iterdir()) == []


def test_a_standing_camera_is_refused(tmp_path: Path) -> None:
    """Oracle: the sentence for a video of one view with noise."""
    rng = np.random.default_rng(0)
    view = films.seen(films.wall(600), 10).astype(int)
    noisy = (np.clip(view + rng.integers(-3, 4, view.shape), 0, 255) for _ in range(30))
    path = films.write(tmp_path / "still.mp4", (picture.astype(np.uint8) for picture in noisy))
    with pytest.raises(DatasetError, match="does not move"):
        extract_frames(ExtractRequest(video=path, output=tmp_path / "out"))


def test_the_command_says_what_it_did(film: Film, tmp_path: Path, capsys: Out) -> None:
    """Oracle: the last line of --json, and the files."""
    out = tmp_path / "out"
    line = ["frames", str(film.path), "-o", str(out), "--frames", "12", "--json", "--quiet"]
    assert main(line) == 0
    facts = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert facts["frames"] == len(list(out.glob("*.jpg"))) == 12
    assert facts["total"] == 240 and facts["blurred"] > 30 and facts["repeated"] >= 10
    assert main(["frames", str(film.path), "-o", str(tmp_path / "x"), "--frames", "2"]) == 2
    assert "expected 3 to" in capsys.readouterr().err


def test_events_tell_how_far_it_is(film: Film, tmp_path: Path) -> None:
    """Oracle: counts that rise to the totals of each phase."""
    reported: list[Event] = []
    extract_frames(
        ExtractRequest(video=film.path, output=tmp_path / "out", frames=10),
        on_event=reported.append,
    )
    progress = [event for event in reported if isinstance(event, FramesProgress)]
    assert {event.phase for event in progress} == {"looking at frames", "writing frames"}
    for phase, total in (("looking at frames", 240), ("writing frames", 10)):
        counts = [event.done for event in progress if event.phase == phase]
        assert counts == sorted(counts) and counts[-1] == total
    assert isinstance(reported[-1], FramesDone) and reported[-1].frames == 10


def test_names_that_are_videos(tmp_path: Path) -> None:
    """Oracle: names of files; a folder of that name is no video."""
    (tmp_path / "a.MOV").write_bytes(b"")
    (tmp_path / "b.mp4").mkdir()
    (tmp_path / "c.jpg").write_bytes(b"")
    assert [is_video(tmp_path / n) for n in ("a.MOV", "b.mp4", "c.jpg", "d.mp4")] == [
        True, False, False, False,
    ]  # fmt: skip
