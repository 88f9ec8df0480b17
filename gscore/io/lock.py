"""Folder lock: one process at a time works in a folder; the lock file names its owner."""

import contextlib
import errno
import json
import os
import sys
from pathlib import Path
from typing import IO

from ..errors import ConfigError, DatasetError, GsError
from ..json_text import parse_json
from ..quoting import brief
from .files import check_regular, reason

_FAR = 1 << 20


class FolderLock:
    """A file in a folder, locked by the system until its process ends in any way."""

    def __init__(self, folder: Path, name: str, work: str) -> None:
        """Create the lock of a folder, which need not exist yet; `take` locks it.

        Args:
            folder: The folder to lock.
            name: Name of the lock file in it.
            work: Kind of work in it, such as `training`, for messages.
        """
        self._folder, self._path, self._work = folder, folder / name, work
        self._file: IO[str] | None = None

    def check_free(self) -> None:
        """Raise GsError if another process has locked the folder."""
        holder = self.holder()
        if holder is not None:
            raise self._in_use(holder)

    def holder(self) -> int | None:
        """Id of the process that has locked the folder, 0 if it cannot be read; None: no lock."""
        try:
            check_regular(self._path)
            file = self._path.open("r+", encoding="utf-8")
        except (OSError, ValueError, DatasetError):  # no folder, no lock
            return None
        with file:
            return None if _try_lock(file) else _owner_in(file)

    def take(self) -> None:
        """Lock the folder, which is made if missing.

        Raises:
            GsError: another process has locked it, or it cannot be written.
            ConfigError: it is a file.
        """
        file = self._open()
        try:
            file.truncate(0)
            # Unbuffered, because a buffer would try again when the file is closed.
            os.write(file.fileno(), json.dumps({"pid": os.getpid()}).encode())
        except OSError as error:
            self._file = file
            self.release()
            raise GsError(f"Cannot write into {brief(self._folder)}: {reason(error)}") from error
        self._file = file

    def release(self) -> None:
        """Unlock the folder and remove the file."""
        file, self._file = self._file, None
        if file is None:
            return
        with contextlib.suppress(OSError):
            if sys.platform == "win32":
                # Windows cannot remove an open file, nor one that another process has opened.
                file.close()
                self._path.unlink(missing_ok=True)
            else:
                # Remove before unlocking: afterwards the file may be another process's.
                self._path.unlink(missing_ok=True)
                file.close()

    def _open(self) -> IO[str]:
        while True:
            try:
                self._folder.mkdir(parents=True, exist_ok=True)
                check_regular(self._path)
                if self._path.is_symlink() and not self._path.exists():
                    raise DatasetError(f"{self._path} is a link to nowhere.")
                file = self._path.open("a+", encoding="utf-8")
            except FileExistsError:
                raise ConfigError(
                    f"{self._folder} is a file; a folder is needed. Choose another output."
                ) from None
            except DatasetError as error:
                raise ConfigError(
                    f"{brief(self._path)}, the lock file of a {self._work}, is not a regular file. "
                    "Remove it, or choose another output folder."
                ) from error
            except (OSError, ValueError) as error:
                raise GsError(
                    f"Cannot write into {brief(self._folder)}: {reason(error)}"
                ) from error
            if not _try_lock(file):
                with file:
                    raise self._in_use(_owner_in(file))
            try:
                current = os.path.samestat(os.fstat(file.fileno()), self._path.stat())
            except OSError:
                current = False
            if current:
                return file
            file.close()  # its last owner has removed it since it was opened

    def _in_use(self, holder: int) -> GsError:
        process = f" (process {holder})" if holder else ""
        return GsError(
            f"{self._folder} is in use by another {self._work}{process}; wait for it, stop it, or "
            "choose another output folder."
        )


def _owner_in(file: IO[str]) -> int:
    """Id of the process named in a lock file; 0: it cannot be read."""
    file.seek(0)
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
        return int(parse_json(file.read())["pid"])
    return 0


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
        # Other errors come from file systems without locks.
        return error.errno not in (errno.EACCES, errno.EAGAIN, errno.EDEADLK)
    return True
