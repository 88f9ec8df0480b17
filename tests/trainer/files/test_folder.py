"""The output folder; oracle: its content before and after."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from gscore.config import DataConfig, TrainConfig
from gscore.config_file import config_json
from gscore.errors import ConfigError, GsError
from gscore.io.lock import FolderLock
from gscore.io.runs import RUN_LOCK, clear_run, other_files_in_run, remove_results
from gscore.trainer.files import run_folder as folder_module
from gscore.trainer.files.run_folder import open_folder

pytestmark = pytest.mark.usefixtures("fake_engine")


def names(path: Path) -> set[str]:
    return {p.name for p in path.rglob("*")}


def test_a_new_folder_is_made_and_removed_if_nothing_was_written(tmp_path: Path) -> None:
    """Oracle: no folder; with a file in it the folder stays."""
    path = tmp_path / "a" / "b"
    with open_folder(path, resume=False, overwrite=False):
        assert path.is_dir()
    assert not path.exists()
    with open_folder(path, resume=False, overwrite=False) as folder:
        folder.write_text("config.json", "{}")
    assert names(path) == {"config.json"}


def test_another_run_is_refused_and_untouched(tmp_path: Path) -> None:
    """Oracle: the message, which names the files and both ways out; unchanged files."""
    a_run(tmp_path, "metrics.json")
    found = r"contains another run \(config.json, metrics.json\).*--resume.*--overw"
    with (
        pytest.raises(ConfigError, match=found),
        open_folder(tmp_path, resume=False, overwrite=False),
    ):
        pass
    assert names(tmp_path) == {"config.json", "metrics.json"}
    assert (tmp_path / "metrics.json").read_text() == "x"


OURS = (
    "cfg_args",
    "cameras.json",
    "exposure.json",
    "poses.json",
    "trained_block.json",
    "point_cloud.ply",
    "metrics.json",
    "report.html",
    "checkpoints/step_00000120.safetensors",
    "checkpoints/step_123456789.safetensors",
    "checkpoints/step_00000100.safetensors.damaged",
    "point_cloud/iteration_70/point_cloud.ply",
    "previews/step_000070.png",
    "snapshots/step_000070.ply",
)
THEIRS = (
    "holiday.jpg",
    "scene.blend",
    "metrics.json.old",
    "checkpoints/best.safetensors",
    "checkpoints/step_00000120.safetensors.bak",
    "checkpoints/old/step_00000120.safetensors",
    "point_cloud/notes.txt",
    "point_cloud/iteration_70/cleaned.ply",
    "previews/holiday.jpg",
    "previews/step_000070_edited.png",
    "snapshots/step_nice.ply",
    "snapshots/.hidden",
)


def a_run(path: Path, *others: str) -> None:
    """Files of a run, and others."""
    text = config_json(DataConfig(source=path / "capture"), TrainConfig())
    (path / "config.json").write_text(text)
    for name in others:
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_text("x")


def test_overwriting_takes_what_runs_write_and_nothing_else(tmp_path: Path) -> None:
    """Oracle: two lists made by hand; files of the second are reported and survive twice."""
    a_run(tmp_path, *OURS, *THEIRS)
    shown = {name for name in THEIRS if not name.startswith(".")}
    assert set(other_files_in_run(tmp_path)) == shown
    for _ in range(2):
        with open_folder(tmp_path, resume=False, overwrite=True) as folder:
            folder.clear()
        left = {p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file()}
        assert left == set(THEIRS)


def test_folders_of_a_run_go_with_their_last_file(tmp_path: Path) -> None:
    """Oracle: an empty folder."""
    a_run(tmp_path, *OURS)
    with open_folder(tmp_path, resume=False, overwrite=True) as folder:
        folder.clear()
    assert names(tmp_path) == set()


def test_a_folder_of_the_users_is_no_run(tmp_path: Path) -> None:
    """Oracle: photos in a folder called previews, which do not block a first run there."""
    (tmp_path / "previews").mkdir()
    (tmp_path / "previews" / "holiday.jpg").write_text("keep")
    with open_folder(tmp_path, resume=False, overwrite=False):
        pass
    assert names(tmp_path) == {"previews", "holiday.jpg"}


@pytest.mark.parametrize("config", [None, "{}", "[]", '{"data": {}, "train": {}}', "[" * 100_000])
def test_foreign_files_are_never_overwritten(tmp_path: Path, config: str | None) -> None:
    """Oracle: the layout of the 3DGS trainer, which has no config.json, and other config.jsons."""
    theirs = ("cfg_args", "cameras.json", "point_cloud/iteration_30000/point_cloud.ply")
    a_run(tmp_path, *theirs)
    (tmp_path / "config.json").unlink()
    if config is not None:
        (tmp_path / "config.json").write_text(config)
    before = names(tmp_path)
    for overwrite in (False, True):
        with (
            pytest.raises(ConfigError, match=r"no config\.json by gscore, so they may be from"),
            open_folder(tmp_path, resume=False, overwrite=overwrite),
        ):
            pass
    clear_run(tmp_path)
    assert names(tmp_path) == before


def test_clearing_that_is_cut_short_can_be_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: a kill after each number of files; the rest is still recognised as a run."""
    for count in range(len(OURS) + 1):
        path = tmp_path / str(count)
        path.mkdir()
        a_run(path, *OURS)
        real, left = Path.unlink, [count]

        def unlink(self: Path, missing_ok: bool = False) -> None:
            left[0] -= 1  # noqa: B023
            if left[0] < 0:  # noqa: B023
                raise KeyboardInterrupt
            real(self, missing_ok)  # noqa: B023

        with monkeypatch.context() as patch:
            patch.setattr(Path, "unlink", unlink)
            with pytest.raises(KeyboardInterrupt):
                remove_results(path)
        remove_results(path)
        assert names(path) == set()


@pytest.mark.skipif(os.name == "nt", reason="links take rights there")
def test_a_linked_folder_is_refused(tmp_path: Path) -> None:
    """Oracle: a link to a folder that another run uses too; its files stay."""
    run, elsewhere = tmp_path / "run", tmp_path / "elsewhere"
    run.mkdir()
    elsewhere.mkdir()
    (elsewhere / "step_00000001.safetensors").write_text("x")
    a_run(run)
    (run / "checkpoints").symlink_to(elsewhere)
    with (
        pytest.raises(ConfigError, match="checkpoints is a link"),
        open_folder(run, resume=False, overwrite=True),
    ):
        pass
    assert names(elsewhere) == {"step_00000001.safetensors"}


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("/", "is the root folder"),
        ("~", "is your home folder"),
        ("capture", "is the capture itself"),
        ("capture/images/../images", "is the folder of the photos"),
        ("capture/masks", "is the folder of the masks"),
        ("capture/maps", "is the folder of the depth maps"),
        ("link", "is the capture itself"),
        ("file", "is a file"),
        ("/dev/null", "/dev/null is a file"),
        ("/tmp", "is shared by many programs"),
        ("to_tmp", "is shared by many programs"),
    ],
)
@pytest.mark.parametrize("overwrite", [False, True])
def test_places_that_are_not_for_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str, words: str, overwrite: bool
) -> None:
    """Oracle: one sentence, and unchanged files."""
    home = tmp_path / "home"
    for folder in (home, tmp_path / "capture" / "images"):
        folder.mkdir(parents=True)
    (tmp_path / "file").write_text("x")
    (tmp_path / "link").symlink_to(tmp_path / "capture")
    (tmp_path / "to_tmp").symlink_to("/tmp")
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.chdir(tmp_path)
    before = names(tmp_path)
    data = DataConfig(source=tmp_path / "capture", depths="maps")
    with (
        pytest.raises(ConfigError, match=words),
        open_folder(Path(place).expanduser(), resume=False, overwrite=overwrite, data=data),
    ):
        pass
    assert names(tmp_path) == before


def test_a_sequence_is_no_single_run(tmp_path: Path) -> None:
    """Oracle: a refusal in both directions."""
    a_run(tmp_path)
    (tmp_path / "sequence.json").write_text("{}")
    with (
        pytest.raises(ConfigError, match="contains a sequence"),
        open_folder(tmp_path, resume=False, overwrite=True),
    ):
        pass


def test_two_runs_at_once_are_refused(tmp_path: Path) -> None:
    """Oracle: an error of the second run that names the process of the undisturbed first."""
    with open_folder(tmp_path, resume=False, overwrite=False) as folder:
        with (
            pytest.raises(GsError, match=rf"in use by another training \(process {os.getpid()}\)"),
            open_folder(tmp_path, resume=False, overwrite=True),
        ):
            pass
        folder.write_text("config.json", "{}")
    assert names(tmp_path) == {"config.json"}


def test_the_lock_of_a_dead_process_does_not_count(tmp_path: Path) -> None:
    """Oracle: a process killed while it had the folder locked."""
    code = (
        "import os, sys; from pathlib import Path\n"
        "from gscore.trainer.files.run_folder import open_folder\n"
        "with open_folder(Path(sys.argv[1]), resume=False, overwrite=False): os._exit(9)"
    )
    ended = subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    assert ended.returncode == 9
    assert json.loads((tmp_path / RUN_LOCK).read_text())["pid"] != os.getpid()
    with open_folder(tmp_path, resume=False, overwrite=False):
        assert json.loads((tmp_path / RUN_LOCK).read_text())["pid"] == os.getpid()
    assert names(tmp_path) == set()


def test_resume_needs_a_checkpoint(tmp_path: Path) -> None:
    """Oracle: the message, and no new folder."""
    path = tmp_path / "none"
    with (
        pytest.raises(ConfigError, match="has no checkpoint"),
        open_folder(path, resume=True, overwrite=False),
    ):
        pass
    assert not path.exists()


def test_a_run_that_has_only_begun_is_in_use(tmp_path: Path) -> None:
    """Oracle: the process named on resume instead of a missing checkpoint; no files by
    check_free."""
    with open_folder(tmp_path / "a", resume=False, overwrite=False):
        with (
            pytest.raises(GsError, match=rf"in use by another training \(process {os.getpid()}\)"),
            open_folder(tmp_path / "a", resume=True, overwrite=False),
        ):
            pass
        with pytest.raises(GsError, match="in use by another training"):
            folder_module.check_free(tmp_path / "a")
    folder_module.check_free(tmp_path / "a")
    assert names(tmp_path) == set()


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_place_is_refused(tmp_path: Path) -> None:
    """Oracle: one sentence."""
    tmp_path.chmod(0o555)
    try:
        with (
            pytest.raises(GsError, match="Cannot write into"),
            open_folder(tmp_path / "out", resume=False, overwrite=False),
        ):
            pass
    finally:
        tmp_path.chmod(0o755)


@pytest.mark.parametrize("there", [False, True])
def test_a_disk_without_a_byte_left_is_named(
    there: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the sentence; an unchanged folder. Such a disk only takes an empty lock."""

    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    path = tmp_path / "out"
    if there:
        path.mkdir()
    monkeypatch.setattr(os, "write", full)
    with (
        pytest.raises(GsError, match=r"Cannot write into .*out: the disk is full"),
        open_folder(path, resume=False, overwrite=False),
    ):
        pass
    assert names(tmp_path) == ({"out"} if there else set())


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    """Oracle: the unchanged file."""
    (tmp_path / "out").write_text("x")
    with (
        pytest.raises(ConfigError, match="is a file"),
        open_folder(tmp_path / "out", resume=False, overwrite=True),
    ):
        pass
    assert (tmp_path / "out").read_text() == "x"


def test_old_checkpoints_are_dropped_except_those_asked_for(tmp_path: Path) -> None:
    """Oracle: the last two, and the protected one."""
    with open_folder(tmp_path, resume=False, overwrite=False) as folder:
        for step in (5, 90, 100, 1000):
            path = folder.checkpoint(step)
            path.parent.mkdir(exist_ok=True)
            path.write_text("")
        folder.drop_checkpoints(keep=2, protected=(5,))
        assert folder.checkpoints() == [folder.checkpoint(s) for s in (5, 100, 1000)]


def test_temporary_files_of_a_killed_run_are_removed(tmp_path: Path) -> None:
    """Oracle: the names that atomic_write uses; foreign files stay."""
    junk = (".config.json.0a1b2c3d.tmp", "checkpoints/.step_00000004.safetensors.0a1b2c3d.tmp")
    kept = (".mine.tmp", "checkpoints/.note.tmp", "checkpoints/step_00000003.safetensors")
    for name in (*junk, *kept):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text("x")
    with open_folder(tmp_path, resume=True, overwrite=False):
        pass
    assert not any((tmp_path / name).exists() for name in junk)
    assert all((tmp_path / name).exists() for name in kept)


@pytest.mark.parametrize("name", ["n" * 300, "a\0b", "a\ud800b"])
@pytest.mark.parametrize("resume", [False, True])
def test_names_that_cannot_be_are_refused(tmp_path: Path, name: str, resume: bool) -> None:
    """Oracle: one printable sentence; no files."""
    with (
        pytest.raises(
            GsError, match=r"Cannot use .*the name (is too long|has characters)"
        ) as error,
        open_folder(tmp_path / name, resume=resume, overwrite=False),
    ):
        pass
    assert len(str(error.value).encode()) < 400
    assert names(tmp_path) == set()


@pytest.mark.skipif(os.name == "nt", reason="an open file cannot be removed there")
def test_giving_up_the_lock_never_takes_that_of_the_next(tmp_path: Path) -> None:
    """Oracle: another run takes the lock the moment it is free, and a third is refused."""
    (tmp_path / "kept").write_text("")
    held, following, third = (FolderLock(tmp_path, RUN_LOCK, "training") for _ in range(3))
    held.take()
    file = held._file

    class Closing:
        """The file; the next run comes right after it was closed."""

        def close(self) -> None:
            file.close()
            following.take()

    held._file = Closing()  # type: ignore[assignment]
    held.release()
    with pytest.raises(GsError, match="in use by another training"):
        third.take()
    following.release()
    assert names(tmp_path) == {"kept"}


def test_other_names_are_no_checkpoints(tmp_path: Path) -> None:
    """Oracle: only files with the names that runs write."""
    folder = folder_module.RunFolder(tmp_path)
    good = folder.checkpoint(12)
    for stray in ("step_zzz", "step_00000013", "step_1"):
        (good.parent / f"{stray}.safetensors").mkdir(parents=True)
    (good.parent / "step_x.safetensors").write_text("")
    good.write_text("")
    assert folder.checkpoints() == [good]


@pytest.mark.skipif(os.name == "nt", reason="named pipes of POSIX")
@pytest.mark.parametrize("kind", ["pipe", "link", "folder"])
def test_a_lock_that_is_no_file_is_named(tmp_path: Path, kind: str) -> None:
    """Oracle: what is there, which stays, without waiting for a pipe's other end; one sentence."""
    lock = tmp_path / ".gscore.lock"
    if kind == "pipe":
        os.mkfifo(lock)
    elif kind == "link":
        lock.symlink_to("/nowhere/at/all")
    else:
        lock.mkdir()
    before = lock.lstat()
    with (
        pytest.raises(ConfigError, match=r"is not a regular file\. Remove it") as messages,
        open_folder(tmp_path, resume=False, overwrite=False),
    ):
        pass
    assert ".." not in str(messages.value).replace(str(tmp_path), "")
    assert os.path.samestat(lock.lstat(), before)
