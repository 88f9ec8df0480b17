"""Files: written completely or not at all, read only if they are regular, linked or copied."""

import contextlib
import errno
import math
import os
import re
import secrets
import shutil
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterator
from io import BufferedReader
from pathlib import Path
from typing import Any, BinaryIO

from ..errors import DatasetError, FormatError, GsError
from ..json_text import parse_json
from ..quoting import brief

_of_thread = threading.local()


@contextlib.contextmanager
def file_errors(check: Callable[[], None]) -> Iterator[None]:
    """Call `check` before each file of this thread is renamed to its final name within the block,
    so that a cancelled write has no effect. Errors of `check` are passed on."""
    _of_thread.check = check
    try:
        yield
    finally:
        del _of_thread.check


def atomic_write(path: str | Path, content: bytes | Callable[[BinaryIO], None]) -> None:
    """Write a file under a temporary name next to `path`, flush it to the disk, then rename it.

    Readers of `path` get the old file or the complete new one. The folder is made if needed.
    Temporary files left by killed writes of the same file are removed.

    Args:
        path: The file to write.
        content: The bytes, or a function that writes them to an open binary file.

    Raises:
        GsError: the disk is full, the folder is read-only or no folder; `path` is untouched.
    """
    path = Path(path)
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        candidate, opened = _temporary(path)
        with opened as file:
            temporary = candidate
            if callable(content):
                content(file)
            else:
                file.write(content)
            file.flush()
            os.fsync(file.fileno())
            if (check := getattr(_of_thread, "check", None)) is not None:
                check()
            if sys.platform != "win32":  # Windows can neither rename nor remove an open file
                candidate.replace(path)
        if sys.platform == "win32":
            candidate.replace(path)
        temporary = None
    except (OSError, ValueError) as error:
        if isinstance(error, ValueError) and temporary is not None:
            raise  # from `content`
        raise GsError(f"Cannot write {brief(path)}: {reason(error)}") from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink()


def _temporary_name(name: str) -> str:
    """`.name.xxxxxxxx.tmp`, shortened to the longest possible name."""
    end = f".{secrets.token_hex(_TEMPORARY // 2)}.tmp"
    raw = os.fsencode(name)
    # A name that is too long itself is kept, so that the system reports it.
    most = max(LONGEST_NAME - len(end) - 1, 0) if len(raw) <= LONGEST_NAME else len(raw)
    return f".{os.fsdecode(raw[:most]) if len(raw) > most else name}{end}"


_remains: dict[Path, tuple[float, list[str]]] = {}
"""Time of the last listing and the temporary files found, by folder."""


@contextlib.contextmanager
def write_record(path: Path, of_killed: Callable[[bytes], None]) -> Iterator[BinaryIO]:
    """An empty file for notes on a write of several files, removed at the end of the block.

    It stays if the process is killed, until the next record for the same `path`.

    Args:
        path: The record has a temporary name next to it.
        of_killed: Receives the notes of each killed process.

    Raises:
        GsError: the record cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        record, file = _temporary(path, of_killed)
    except (OSError, ValueError) as error:
        raise GsError(f"Cannot write {brief(path)}: {reason(error)}") from error
    try:
        yield file
    finally:
        with contextlib.suppress(OSError):  # notes that did not fit on the disk
            file.close()
        with contextlib.suppress(OSError):
            record.unlink()


def _temporary(
    path: Path, of_killed: Callable[[bytes], None] | None = None
) -> tuple[Path, BinaryIO]:
    """A new file, locked and open, next to `path`, because a rename is atomic only within one file
    system."""
    while True:
        candidate = path.with_name(_temporary_name(path.name))
        _remove_remains(candidate, of_killed)
        file = candidate.open("x+b")
        # Before it was locked, another process may have removed it as one left by a killed process.
        if _try_lock(file, otherwise=True) and candidate.exists():
            return candidate, file
        file.close()


def _remove_remains(candidate: Path, of_killed: Callable[[bytes], None] | None) -> None:
    """Remove temporary files for the same name as `candidate` whose process has ended, and pass on
    their contents."""
    folder, now = candidate.parent, time.monotonic()
    listed, names = _remains.get(folder, (-math.inf, []))
    if now - listed > _LIST_AGAIN:
        with contextlib.suppress(OSError):
            names = [entry.name for entry in os.scandir(folder) if entry.name.endswith(".tmp")]
        _remains[folder] = now, names
    for name in names:
        same = name[: -len(_RANDOM)] == candidate.name[: -len(_RANDOM)]
        if same and _IS_RANDOM.fullmatch(name[-len(_RANDOM) :]):
            with contextlib.suppress(OSError), (folder / name).open("r+b") as file:
                if _try_lock(file, otherwise=False):
                    content = file.read(_MOST_NOTES) if of_killed else b""
                    (folder / name).unlink()  # fails on Windows while its writer works
                    if of_killed:
                        of_killed(content)


def _try_lock(file: BinaryIO, *, otherwise: bool) -> bool:
    """Lock a file until it is closed, also by the end of the process; False if another process or
    thread has locked it, `otherwise` if the file system has no locks."""
    if sys.platform == "win32":
        return True  # Windows does not remove open files
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in (errno.EACCES, errno.EAGAIN, errno.EDEADLK) and otherwise
    return True


def check_regular(path: str | Path) -> None:
    """Refuse anything but a regular file: opening a named pipe waits for a writer, perhaps for
    ever, and a device may have no end. Missing files pass, and fail when opened.

    Raises:
        DatasetError: a named pipe, a device, a socket or a folder.
    """
    try:
        mode = Path(path).stat().st_mode
    except (OSError, ValueError):
        return
    if stat.S_ISREG(mode):
        return
    kind = _KINDS.get(stat.S_IFMT(mode), "no regular file")
    raise DatasetError(
        f"{brief(path)} is {kind}, a file was expected. Put a copy of the file there."
    )


def open_regular(path: str | Path) -> BufferedReader:
    """Open a regular file for reading.

    Raises:
        OSError: it is missing or not readable.
        DatasetError: it is not a regular file.
    """
    check_regular(path)
    return Path(path).open("rb")


def check_readable(path: str | Path) -> None:
    """Raise unless a file can be read, before another library opens it.

    Raises:
        DatasetError: it is missing, cannot be read or is not a regular file.
    """
    try:
        with open_regular(path):
            return
    except (OSError, ValueError) as error:
        raise DatasetError(f"Cannot read {brief(path)}: {reason(error)}") from error


def read_bytes(path: str | Path) -> bytes:
    """All bytes of a file.

    Raises:
        DatasetError: the file is missing, cannot be read or is not a regular file.
    """
    try:
        with open_regular(path) as file:
            return file.read()
    except (OSError, ValueError) as error:
        raise DatasetError(f"Cannot read {brief(path)}: {reason(error)}") from error


def read_json(path: str | Path) -> Any:
    """Content of a JSON file, see `parse_json`.

    Raises:
        DatasetError: as `read_bytes`.
        FormatError: it is not JSON.
    """
    try:
        return parse_json(read_bytes(path))
    except ValueError as error:
        raise FormatError(f"{path} is not JSON: {error}. Copy or export it again.") from error


def is_file(path: str | Path) -> bool:
    """True if `path` is a file; False also for invalid names."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False


LONGEST_NAME = 255
"""Most bytes of a file name on all common file systems."""
LONGEST_PATH = 4095
"""Most bytes of a path on Linux; other systems allow fewer."""
_TEMPORARY = 8
"""Random bytes of a temporary name."""
_RANDOM = f".{'0' * _TEMPORARY}.tmp"
_IS_RANDOM = re.compile(rf"\.[0-9a-f]{{{_TEMPORARY}}}\.tmp")
"""Ends of temporary names."""
_MOST_NOTES = 1 << 20
"""Most bytes that are read of a record."""
_LIST_AGAIN = 30.0
"""Seconds after which a folder is listed again: it may have thousands of files."""
_KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
    stat.S_IFDIR: "a folder",
}

_REASONS = {
    errno.ENOSPC: "the disk is full. Free some space or choose another output folder.",
    errno.EDQUOT: "your disk quota is used up. Free some space or choose another output folder.",
    errno.EROFS: "the disk is read-only. Choose another folder.",
    errno.EACCES: "permission denied. Check the rights of the folder or choose another one.",
    errno.EPERM: "permission denied. Check the rights of the folder or choose another one.",
    errno.ENOTDIR: "a part of its path is a file, not a folder.",
    errno.EEXIST: "a file exists where a folder is needed.",
    errno.EISDIR: "it is a folder, a file was expected.",
    errno.ENOENT: "there is no such file.",
    errno.ENAMETOOLONG: "the name is too long for the file system. Choose a shorter one.",
    errno.ELOOP: "links lead in a circle. Give another path.",
    errno.EFBIG: "the file system does not support files of this size.",
}


def is_unnameable(letter: str) -> bool:
    """True for characters not allowed in file names: control codes, lone surrogates."""
    return ord(letter) < 32 or 0xD800 <= ord(letter) < 0xE000


def reason(error: OSError | ValueError) -> str:
    """Reason why the system refused a path, and the remedy, as the end of a message.

    Python raises ValueError for names with a zero byte or a lone surrogate.
    """
    if isinstance(error, OSError):
        return _REASONS.get(error.errno or 0, f"{error.strerror or error}".rstrip(".") + ".")
    return "the name has characters that no file name can have. Choose another one."


def link_or_copy(source: Path, target: Path) -> None:
    """Hard-link the file `source` to `target`, or copy it; the folder of `target` is made.

    A hard link takes no space and stays valid if the first name is removed. Targets on another file
    system, or on one without hard links, get a copy.

    Raises:
        OSError: `target` cannot be written.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source.resolve(), target)
    except OSError:
        shutil.copy2(source, target)
