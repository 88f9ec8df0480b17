"""Files of frames, and the frame at a time. Oracles are named in the tests."""

from pathlib import Path

import pytest

from addon.timeline.frames import HIDE, HOLD, LOOP, Series, Timing, find_series, name_of_file
from gscore.io.sequences import SequenceIndex, write_sequence


def _touch(*paths: Path) -> None:
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"ply")


def _numbers(series: Series) -> list[int]:
    return [file.number for file in series.files]


def test_files_come_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    """Oracle: the numbers, which differ from the order of the names."""
    _touch(*(tmp_path / f"take2_{n}.ply" for n in (1, 2, 10, 11, 3)))
    _touch(tmp_path / "notes_1.txt", tmp_path / "mesh.ply")
    series = find_series(tmp_path)
    assert (series.name, _numbers(series)) == ("take2_#.ply", [1, 2, 3, 10, 11])
    assert (series.stride, series.slots, series.gaps) == (1, 11, 6)
    assert series.gap_text() == (
        "Frames 4, 5, 6, 7, 8 and 1 more are missing; the one before is shown."
    )
    assert series.at(5).number == 3


def test_every_fifth_frame_has_no_gaps(tmp_path: Path) -> None:
    """Oracle: the numbers of `--frames 0:20:5`, one of which is missing."""
    _touch(*(tmp_path / f"f{n:03d}.spz" for n in (0, 5, 15, 20)))
    series = find_series(tmp_path)
    assert (series.stride, series.slots, series.gaps) == (5, 5, 1)
    assert "Frame 10 is missing" in series.gap_text()


def test_times_of_a_clock_are_no_count(tmp_path: Path) -> None:
    """Oracle: the order; a camera's milliseconds would be mostly gaps."""
    _touch(*(tmp_path / f"{n}.ply" for n in (1700000000033, 1700000000066, 1700000000101)))
    series = find_series(tmp_path)
    assert (series.slots, series.gaps) == (3, 0)
    assert series.at(2).number == 1700000000101


def test_results_of_gscore_sequence(tmp_path: Path) -> None:
    """Oracle: the list in sequence.json, without a frame that is still being trained."""
    for number in (0, 5, 10):
        _touch(tmp_path / f"frame_{number:06d}" / "point_cloud.ply")
    frames = [{"frame": n, "folder": f"frame_{n:06d}"} for n in (0, 5)]
    write_sequence(tmp_path, SequenceIndex(options={}, frames=frames, mean={}), version="0")
    assert _numbers(find_series(tmp_path)) == [0, 5]


def test_folders_with_a_file_each(tmp_path: Path) -> None:
    """Oracle: the layout of 3DGS trainers, the last iteration of each; and one file per folder."""
    for number in (1, 2):
        for iteration in (7000, 30000):
            place = tmp_path / "a" / str(number) / "point_cloud" / f"iteration_{iteration}"
            _touch(place / "point_cloud.ply")
        _touch(tmp_path / "b" / f"t{number}" / "any.splat")
    found = find_series(tmp_path / "a")
    assert [f.path.parent.name for f in found.files] == ["iteration_30000"] * 2
    assert _numbers(find_series(tmp_path / "b")) == [1, 2]
    chosen = found.files[1].path
    assert name_of_file(chosen) == (tmp_path / "a", found.name)


def test_a_file_chooses_among_several_kinds(tmp_path: Path) -> None:
    """Oracle: the names next to it; the pattern with fewer files is chosen."""
    _touch(*(tmp_path / f"low_{n}.ply" for n in range(4)))
    _touch(*(tmp_path / f"high_{n}.ply" for n in range(2)))
    assert find_series(tmp_path).name == "low_#.ply"
    folder, called = name_of_file(tmp_path / "high_1.ply")
    assert _numbers(find_series(folder, called)) == [0, 1]
    _touch(tmp_path / "plain.ply")
    with pytest.raises(ValueError, match="no number in its name"):
        name_of_file(tmp_path / "plain.ply")


def test_folder_without_frames(tmp_path: Path) -> None:
    """Oracle: errors that name the folder, for each reason why there are no frames."""
    with pytest.raises(ValueError, match=r"cannot be read .No such file.*choose where it is now"):
        find_series(tmp_path / "gone")
    with pytest.raises(ValueError, match="has no frames: choose the output folder"):
        find_series(tmp_path)
    _touch(tmp_path / "a1.ply")
    with pytest.raises(ValueError, match=r"no files named b#\.ply"):
        find_series(tmp_path, "b#.ply")
    (tmp_path / "sequence.json").write_text("{")
    with pytest.raises(ValueError, match="not the list of a sequence's frames"):
        find_series(tmp_path)


@pytest.mark.parametrize(
    ("timing", "shown"),
    [
        (Timing(beyond=HOLD), [0, 0, 0, 1, 2, 3, 4, 4]),
        (Timing(beyond=LOOP), [3, 4, 0, 1, 2, 3, 4, 0]),
        (Timing(beyond=HIDE), [None, None, 0, 1, 2, 3, 4, None]),
        (Timing(start=3, beyond=HIDE), [None, None, None, None, 0, 1, 2, 3]),
        (Timing(offset=2, beyond=LOOP), [3, 4, 2, 3, 4, 2, 3, 4]),
        (Timing(offset=9), [4] * 8),
        (Timing(speed=0.5), [0, 0, 0, 0, 1, 1, 2, 2]),
        (Timing(speed=2, beyond=LOOP), [1, 3, 0, 2, 4, 1, 3, 0]),
        (Timing(speed=-1), [4, 4, 4, 3, 2, 1, 0, 0]),
        (Timing(speed=0), [0] * 8),
        (Timing(step=2), [0, 0, 0, 0, 2, 2, 4, 4]),
    ],
)
def test_frames_over_the_timeline(timing: Timing, shown: list[int | None]) -> None:
    """Oracle: frames -1 to 6 of a timeline, counted by hand for a sequence of five."""
    assert [timing.slot(frame, 5) for frame in range(-1, 7)] == shown


def test_speeds_of_single_precision() -> None:
    """Oracle: 0.7 frames per frame, after ten exactly the seventh, with Blender's float32 0.7."""
    assert Timing(speed=0.699999988079071).slot(11, 100) == 7
    assert Timing(speed=0.699999988079071).slot(100_001, 100_000) == 70_000


def test_upcoming_frames() -> None:
    """Oracle: the frames of the timeline, in their order, around the end of a loop."""
    assert list(Timing(beyond=LOOP).ahead(4, 5, 3)) == [3, 4, 0, 1]
    assert list(Timing(speed=0.5).ahead(1, 5, 3)) == [0, 1]
    assert list(Timing(beyond=HIDE).ahead(-1, 5, 3)) == [0, 1]
