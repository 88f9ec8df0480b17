"""Atomic writing under real failures of the file system."""

import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import BinaryIO

import pytest

from gscore.errors import DatasetError, GsError
from gscore.io import files
from gscore.io.files import atomic_write, file_errors, is_file, read_bytes


def _listing(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_writes_and_makes_folders(tmp_path: Path) -> None:
    """Oracle: the bytes read back, and no other file in the folder."""
    path = tmp_path / "a" / "b" / "file.bin"
    atomic_write(path, b"first")
    atomic_write(path, lambda file: [file.write(b"sec"), file.write(b"ond")][0] and None)
    assert path.read_bytes() == b"second"
    assert _listing(path.parent) == ["file.bin"]


def test_failure_leaves_the_old_file(tmp_path: Path) -> None:
    """Oracle: the previous content, for a writer that fails half-way with its own error."""
    path = tmp_path / "file.bin"
    atomic_write(path, b"old")

    def fail(file: BinaryIO) -> None:
        file.write(b"half")
        raise KeyError("stop")

    with pytest.raises(KeyError):
        atomic_write(path, fail)
    assert path.read_bytes() == b"old"
    assert _listing(tmp_path) == ["file.bin"]


def test_a_file_that_was_given_up(tmp_path: Path) -> None:
    """Oracle: the previous content; the exception is raised, and later files are written."""
    path = tmp_path / "file.bin"
    atomic_write(path, b"old")
    reached = []

    def check() -> None:
        reached.append(_listing(tmp_path))
        raise KeyError("stop")

    with pytest.raises(KeyError), file_errors(check):
        atomic_write(path, b"new")
    assert path.read_bytes() == b"old" and _listing(tmp_path) == ["file.bin"]
    assert len(reached) == 1 and len(reached[0]) == 2  # all data were written by then
    with file_errors(lambda: None):
        atomic_write(path, b"newer")
    assert path.read_bytes() == b"newer"


_DYING = """
import os, sys
from pathlib import Path
from gscore.io.files import atomic_write
def write(file):
    file.write(b"half")
    file.flush()
    print("ready", flush=True)
    sys.stdin.readline()
    os._exit(9)
atomic_write(Path(sys.argv[1]), write)
"""


@pytest.mark.parametrize("name", ["o.ply", "a" * 250, "größer.ply"])
def test_remains_of_killed_writes_are_removed(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the names in the folder: temporary files of a process stay while it runs, and go with
    the next write of the same file after it was killed; all other files stay."""
    monkeypatch.setattr(files, "_LIST_AGAIN", -1.0)
    others = [f".other{name[:200]}.0123abcd.tmp", ".o.ply.tmp", ".o.ply.notrandm.tmp", "x.tmp"]
    for other in others:
        (tmp_path / other).write_bytes(b"mine")
    child = subprocess.Popen(
        [sys.executable, "-c", _DYING, str(tmp_path / name)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    )  # fmt: skip
    with child:
        assert child.stdout is not None and child.stdout.readline() == b"ready\n"
        atomic_write(tmp_path / name, b"one")
        assert len(_listing(tmp_path)) == len(others) + 2
        child.kill()
    assert len(_listing(tmp_path)) == len(others) + 2
    atomic_write(tmp_path / "another", b"")
    assert len(_listing(tmp_path)) == len(others) + 3
    atomic_write(tmp_path / name, b"two")
    assert _listing(tmp_path) == sorted([name, "another", *others])
    assert (tmp_path / name).read_bytes() == b"two"


def test_threads_that_write_one_file_leave_each_other_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: one of the contents, and no error, for forty writes on eight threads."""
    monkeypatch.setattr(files, "_LIST_AGAIN", -1.0)
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda k: atomic_write(tmp_path / "a", bytes([k]) * 1000), range(40)))
    assert len(set((tmp_path / "a").read_bytes())) == 1 and _listing(tmp_path) == ["a"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_full_disk(tmp_path: Path) -> None:
    """Oracle: the kernel's /dev/full, which answers every write with 'no space left'."""

    def fill(file: BinaryIO) -> None:
        with open("/dev/full", "wb", buffering=0) as full:  # noqa: PTH123  unbuffered
            full.write(b"x")

    with pytest.raises(GsError, match=r"result\.ply: the disk is full\. Free some space"):
        atomic_write(tmp_path / "result.ply", fill)
    assert _listing(tmp_path) == []


def test_file_in_place_of_folder(tmp_path: Path) -> None:
    """Oracle: the sentence, with the path and the error."""
    (tmp_path / "out").write_text("a file")
    with pytest.raises(GsError, match=r"Cannot write .*out.*a file"):
        atomic_write(tmp_path / "out" / "x.ply", b"1")
    (tmp_path / "dir").mkdir()
    with pytest.raises(GsError, match="it is a folder"):
        atomic_write(tmp_path / "dir", b"1")


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root may write anywhere")
def test_read_only_folder(tmp_path: Path) -> None:
    """Oracle: the sentence, with the error."""
    tmp_path.chmod(0o500)
    with pytest.raises(GsError, match="permission denied"):
        atomic_write(tmp_path / "x", b"1")


@pytest.mark.skipif(os.name == "nt", reason="POSIX permissions")
def test_permissions_of_ordinary_files(tmp_path: Path) -> None:
    """Oracle: a file made by open() in the same process."""
    (tmp_path / "plain").write_bytes(b"")
    atomic_write(tmp_path / "ours", b"")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_readers_never_see_half(tmp_path: Path) -> None:
    """Oracle: whole versions only, in a second thread that reads continuously."""
    path = tmp_path / "file"
    versions = {bytes([k]) * 100_000 for k in range(8)}
    atomic_write(path, bytes([0]) * 100_000)
    seen, stop = set(), threading.Event()

    def watch() -> None:
        while not stop.is_set():
            seen.add(path.read_bytes())

    watcher = threading.Thread(target=watch)
    watcher.start()
    for version in sorted(versions):
        atomic_write(path, version)
    stop.set()
    watcher.join()
    assert seen <= versions


def test_missing_file(tmp_path: Path) -> None:
    """Oracle: the sentence, with the file."""
    with pytest.raises(DatasetError, match=r"Cannot read .*none\.bin: there is no such file"):
        read_bytes(tmp_path / "none.bin")


@pytest.mark.parametrize(
    ("name", "reported"),
    [
        ("n" * 300, "the name is too long"),
        ("a\0b", "has characters"),
        ("a\ud800b", "has characters"),
    ],
)
def test_names_that_cannot_be(tmp_path: Path, name: str, reported: str) -> None:
    """Oracle: one printable sentence, for writing and reading."""
    with pytest.raises(GsError, match=f"Cannot write .*: .*{reported}") as error:
        atomic_write(tmp_path / name, b"1")
    str(error.value).encode()
    with pytest.raises(DatasetError, match=f"Cannot read .*: .*{reported}") as error:
        read_bytes(tmp_path / name)
    str(error.value).encode()
    assert _listing(tmp_path) == []


def test_errors_of_the_writer_stay_its_own(tmp_path: Path) -> None:
    """Oracle: a ValueError that is unrelated to the name."""

    def fail(file: BinaryIO) -> None:
        raise ValueError("mine")

    with pytest.raises(ValueError, match="mine"):
        atomic_write(tmp_path / "x", fail)
    assert _listing(tmp_path) == []


@pytest.mark.parametrize("length", [242, 250, 255])
def test_names_as_long_as_they_may_be(length: int, tmp_path: Path) -> None:
    """Oracle: the file system's limit of 255 bytes, which the temporary name keeps too."""
    path = tmp_path / ("ä" * ((length - 5) // 2) + "b" * (1 + (length - 5) % 2) + ".bin")
    assert len(os.fsencode(path.name)) == length
    atomic_write(path, b"1")
    assert path.read_bytes() == b"1"
    assert _listing(tmp_path) == [path.name]


def test_impossible_names_do_not_exist(tmp_path: Path) -> None:
    """Oracle: no error and no file."""
    assert not is_file(tmp_path / ("n" * 300))
    assert not is_file(tmp_path / "a\0b")
    assert not is_file(tmp_path)
    atomic_write(tmp_path / "x", b"")
    assert is_file(tmp_path / "x")
