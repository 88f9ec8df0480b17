"""The output folder of a run: what lies where, whose it is, and that only one run writes there."""

import contextlib
import errno
import json
import os
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from ...config import DataConfig
from ...errors import ConfigError, GsError
from ...io.files import atomic_write, reason
from ...io.places import check_place
from ...io.runs import (
    RUN_LOCK,
    check_replaceable,
    checkpoint_path,
    checkpoints_in,
    clear_unfinished,
    remove_results,
    results_in,
)
from ...io.sequences import SEQUENCE_FILE
from ...json_text import parse_json
from ...shown import shown

_FAR = 1 << 20


class RunFolder:
    """Names of the results of a run."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def config(self) -> Path:
        """Options of the run."""
        return self.path / "config.json"

    @property
    def point_cloud(self) -> Path:
        """The splats at the end."""
        return self.path / "point_cloud.ply"

    def saved(self, step: int) -> Path:
        """The splats after `step`, where 3DGS tools look for them."""
        return self.path / "point_cloud" / f"iteration_{step}" / "point_cloud.ply"

    def snapshot(self, step: int) -> Path:
        """The splats after `step`, on request."""
        return self.path / "snapshots" / f"step_{step:06d}.ply"

    def preview(self, step: int) -> Path:
        """A picture of one view after `step`."""
        return self.path / "previews" / f"step_{step:06d}.png"

    def checkpoint(self, step: int) -> Path:
        """The checkpoint after `step`."""
        return checkpoint_path(self.path, step)

    def checkpoints(self) -> list[Path]:
        """All checkpoints, the latest last."""
        return list(checkpoints_in(self.path).values())

    def drop_checkpoints(self, *, keep: int, protected: Collection[int]) -> None:
        """Remove all but the last `keep` checkpoints and those of the steps in `protected`."""
        spared = {self.checkpoint(step) for step in protected}
        droppable = [path for path in self.checkpoints() if path not in spared]
        for path in droppable[: max(len(droppable) - keep, 0)]:
            path.unlink(missing_ok=True)

    def drop_checkpoints_after(self, step: int) -> None:
        """Remove the checkpoints of later steps, which lead where the run does not go any more."""
        for path in self.checkpoints():
            if path > self.checkpoint(step):
                path.unlink(missing_ok=True)

    def results(self) -> list[str]:
        """Names of files and folders here that a run has written."""
        return results_in(self.path)

    def clear(self) -> None:
        """Remove what a run has written, and nothing else."""
        remove_results(self.path)

    def write_text(self, name: str, text: str) -> None:
        """Write a small file completely or not at all."""
        atomic_write(self.path / name, text.encode())


@contextmanager
def open_folder(
    path: Path, *, resume: bool, overwrite: bool, data: DataConfig | None = None
) -> Iterator[RunFolder]:
    """Hold an output folder, alone, for the duration of a run.

    Args:
        path: Made if it is not there; removed again if nothing was written into it.
        resume: It must hold a checkpoint.
        overwrite: It may hold another run.
        data: The capture, among which results must not go.

    Raises:
        ConfigError: it holds another run, something else of that name, or none to resume; or it
            is no place for results.
        GsError: another process trains into it, or it cannot be written.
    """
    folder = RunFolder(path)
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except (OSError, ValueError) as error:  # others answer otherwise to `exists` and `glob`
        raise GsError(f"Cannot use {shown(path)}: {reason(error)}") from error
    check_place(path, data)
    if resume and not folder.checkpoints():
        check_free(path)
        raise ConfigError(f"{path} holds no checkpoint to resume from; leave --resume out.")
    new = not path.exists()
    lock = _lock(path)
    try:
        _sign(lock, path)
        if not resume:
            _check_room(folder, overwrite=overwrite)
        clear_unfinished(path)
        yield folder
    finally:
        _release(lock, path, remove_folder=new)


def _check_room(folder: RunFolder, *, overwrite: bool) -> None:
    """ConfigError unless another run may be written into a folder."""
    path, names = folder.path, folder.results()
    if (path / SEQUENCE_FILE).exists():
        raise ConfigError(f"{path} holds a sequence, of many runs; choose another folder.")
    check_replaceable(path)
    if names and not overwrite:
        raise ConfigError(
            f"{path} holds another run ({', '.join(names)}); go on with it with --resume, replace "
            "it with --overwrite, or choose another folder."
        )


def check_free(path: Path) -> None:
    """Raise unless nobody trains into a folder now.

    Raises:
        GsError: another process does.
    """
    try:
        file = (path / RUN_LOCK).open("r+", encoding="utf-8")
    except (OSError, ValueError):  # no folder, no lock
        return
    with file:
        if not _try_lock(file):
            raise _in_use(path, file)


def _in_use(path: Path, file: IO[str]) -> GsError:
    """The error for a lock that another process has."""
    file.seek(0)
    holder = ""
    with contextlib.suppress(ValueError, KeyError, TypeError, RecursionError):
        holder = f" (process {parse_json(file.read())['pid']})"
    return GsError(
        f"{path} is in use by another training{holder}; wait for it, stop it, or choose "
        "another output folder."
    )


def _lock(path: Path) -> IO[str]:
    """Take the lock, which the system drops when this process ends, however it ends."""
    while True:
        try:
            path.mkdir(parents=True, exist_ok=True)
            file = (path / RUN_LOCK).open("a+", encoding="utf-8")
        except FileExistsError:
            raise ConfigError(f"{path} is a file; an output folder is needed.") from None
        except (OSError, ValueError) as error:
            raise GsError(f"Cannot write into {shown(path)}: {reason(error)}") from error
        if not _try_lock(file):
            with file:
                raise _in_use(path, file)
        try:
            current = os.path.samestat(os.fstat(file.fileno()), (path / RUN_LOCK).stat())
        except OSError:
            current = False
        if current:
            break
        file.close()  # its last owner has removed it since it was opened
    return file


def _sign(file: IO[str], path: Path) -> None:
    """Say in the lock whose it is."""
    try:
        file.truncate(0)
        # Not through its buffer, which would try again when the file is closed.
        os.write(file.fileno(), json.dumps({"pid": os.getpid()}).encode())
    except OSError as error:
        raise GsError(f"Cannot write into {shown(path)}: {reason(error)}") from error


def _try_lock(file: IO[str]) -> bool:
    try:
        if sys.platform == "win32":
            import msvcrt

            file.seek(_FAR)  # the lock is on a byte; the text before it stays readable
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        # Anything else is a file system that knows no locks.
        return error.errno not in (errno.EACCES, errno.EAGAIN, errno.EDEADLK)
    return True


def _release(file: IO[str], path: Path, *, remove_folder: bool) -> None:
    with contextlib.suppress(OSError):
        if sys.platform == "win32":
            # An open file cannot be removed there; nor one that another run has opened since.
            file.close()
            (path / RUN_LOCK).unlink(missing_ok=True)
        else:
            # While it is still held: the moment it is not, the file there may be another run's.
            (path / RUN_LOCK).unlink(missing_ok=True)
            file.close()
        if remove_folder:
            path.rmdir()  # only an empty folder can be removed
