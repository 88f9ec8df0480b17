"""Frames read ahead into bounded memory. Oracles are named in the tests."""

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from addon.core import Splats
from addon.splats.filters import Filters
from addon.timeline import library
from addon.timeline.frames import FrameFile, Series


def _splats(count: int) -> Splats:
    return Splats(
        means=np.zeros((count, 3), np.float32),
        quats=np.ones((count, 4), np.float32),
        scales=np.zeros((count, 3), np.float32),
        opacities=np.linspace(-3, 3, count, dtype=np.float32),
        sh0=np.zeros((count, 1, 3), np.float32),
        shN=np.zeros((count, 0, 3), np.float32),
    )


FILES = tuple(FrameFile(n, Path(f"/frames/{n}.ply"), (n, 1)) for n in range(10))
SIZE = library.Frame(FILES[0], _splats(100)).bytes


class Disk:
    """Records reads, and blocks each until it is released."""

    def __init__(self) -> None:
        self.read: list[int] = []
        self.may = threading.Event()
        self.may.set()
        self.broken: set[int] = set()

    def __call__(self, path: Path) -> Splats:
        self.may.wait(60)
        number = int(path.stem)
        self.read.append(number)
        if number in self.broken:
            raise ValueError(f"{path} is damaged.")
        return _splats(100)


@pytest.fixture
def disk() -> Disk:
    """A disk with readable files."""
    return Disk()


@pytest.fixture
def frames(disk: Disk) -> Iterator[library.Library]:
    """A library for four frames."""
    made = library.Library(disk, lambda folder, name: Series(files=FILES, name="#.ply"))
    made.most = 4 * SIZE
    yield made
    disk.may.set()
    made.close()


def _until(condition: Callable[[], bool]) -> None:
    until = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.005)


def test_frames_are_read_in_the_order_they_are_needed(frames, disk) -> None:
    """Oracle: the request; four fit, and the current one comes first."""
    frames.request("ob", FILES[3:])
    assert frames.frame(FILES[3]) == (None, "") or disk.read
    _until(lambda: not frames.busy)
    assert disk.read == [3, 4, 5, 6]
    assert frames.loaded == (4, 4 * SIZE)
    found, problem = frames.frame(FILES[4])
    assert found is not None and found.file == FILES[4] and not problem and frames.fresh


def test_past_frames_are_dropped(frames, disk) -> None:
    """Oracle: the memory limit at each step; nothing is read twice during playback."""
    for first in range(6):
        frames.request("ob", FILES[first:])
        _until(lambda: not frames.busy)
        assert frames.loaded[0] <= 4
    assert disk.read == list(range(9))


def test_current_frames_exceed_the_limit(frames, disk) -> None:
    """Oracle: five objects with five current frames, and memory for one."""
    frames.most = SIZE
    for n in range(5):
        frames.request(n, FILES[n:])
    _until(lambda: not frames.busy)
    assert sorted(disk.read) == [0, 1, 2, 3, 4]
    assert all(frames.frame(FILES[n])[0] is not None for n in range(5))


def test_objects_share_frames(frames, disk) -> None:
    """Oracle: the list of reads."""
    frames.request("a", FILES[:2])
    frames.request("b", FILES[:2])
    _until(lambda: not frames.busy)
    assert disk.read == [0, 1]
    assert frames.frame(FILES[0])[0] is frames.frame(FILES[0], wait=True)[0]


def test_asking_does_not_wait_for_the_disk(frames, disk) -> None:
    """Oracle: the answers while the disk is blocked."""
    disk.may.clear()
    frames.request("ob", FILES[:1])
    assert frames.frame(FILES[0]) == (None, "") and frames.busy
    assert frames.series((Path("/frames"), "")) == (None, "")
    disk.may.set()
    _until(lambda: frames.frame(FILES[0])[0] is not None)
    _until(lambda: frames.series((Path("/frames"), ""))[0] is not None)


def test_waiting_takes_what_is_under_way(frames, disk) -> None:
    """Oracle: the file is read once, and the answer is the frame."""
    disk.may.clear()
    frames.request("ob", FILES[:1])
    _until(lambda: frames._under_way is not None)
    threading.Timer(0.05, disk.may.set).start()
    assert frames.frame(FILES[0], wait=True)[0] is not None
    assert disk.read == [0]


def test_damaged_file_is_reported_and_others_continue(frames, disk) -> None:
    """Oracle: the error; it is not read again until Rescan Frames."""
    disk.broken = {1}
    for _ in range(3):
        frames.request("ob", FILES[:3])
        _until(lambda: not frames.busy)
    assert disk.read == [0, 1, 2]
    assert frames.frame(FILES[1]) == (None, "/frames/1.ply is damaged.")
    assert frames.frame(FILES[1], wait=True)[1] == "/frames/1.ply is damaged."
    disk.broken = set()
    frames.forget((Path("/frames"), ""))
    assert frames.frame(FILES[1], wait=True)[0] is not None


def test_no_thread_after_the_end(frames, disk) -> None:
    """Oracle: the threads of the process except those of other libraries; a file being read is not
    kept."""
    others = set(threading.enumerate())
    disk.may.clear()
    frames.request("ob", FILES)
    _until(lambda: frames._under_way is not None)
    mine = [t for t in threading.enumerate() if t.name == "gscore-frames" and t not in others]
    assert mine
    frames.close()
    disk.may.set()
    _until(lambda: not any(thread.is_alive() for thread in mine))
    assert frames.loaded == (0, 0) and disk.read == [0]
    frames.request("ob", FILES[5:6])  # another file is loaded
    _until(lambda: not frames.busy)
    assert disk.read == [0, 5]


def test_filters_of_a_frame() -> None:
    """Oracle: the sigmoid of the raw opacities, splat by splat."""
    frame = library.Frame(FILES[0], _splats(100))
    kept = frame.kept(Filters(opacity_min=0.5))
    assert kept.tolist() == [bool(x >= 0) for x in np.linspace(-3, 3, 100)]
