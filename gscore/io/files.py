"""Atomic file writing: a file is written completely or not at all."""

import contextlib
import errno
import math
import os
import re
import secrets
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterator
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

from ..errors import DatasetError, GsError
from ..quoting import brief

_of_thread = threading.local()


@contextlib.contextmanager
def file_errors(check: Callable[[], None]) -> Iterator[None]:
    """Within the block, on this thread, no file is put in its place once `check` raises: whoever
    waits for a long file may have given it up. What `check` raises is passed on."""
    _of_thread.check = check
    try:
        yield
    finally:
        del _of_thread.check


def atomic_write(path: str | Path, content: bytes | Callable[[BinaryIO], None]) -> None:
    """Write a file under a temporary name beside `path`, flush it to the disk, then rename it.

    Whoever looks at `path` sees the old file or the whole new one. The folder is made if need be.
    What writes of the same file left that were killed is removed.

    Args:
        path: The file to write.
        content: The bytes, or a function that writes them to the open binary file it is given.

    Raises:
        GsError: the disk is full, the folder is read-only or is no folder; `path` is untouched.
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
            if sys.platform != "win32":  # where an open file cannot be renamed, or removed
                candidate.replace(path)
        if sys.platform == "win32":
            candidate.replace(path)
        temporary = None
    except (OSError, ValueError) as error:
        if isinstance(error, ValueError) and temporary is not None:
            raise  # of whoever writes the content
        raise GsError(f"Cannot write {brief(path)}: {reason(error)}") from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink()


def _temporary_name(name: str) -> str:
    """`.name.xxxxxxxx.tmp`, shortened where it would be longer than a name may be."""
    end = f".{secrets.token_hex(_TEMPORARY // 2)}.tmp"
    raw = os.fsencode(name)
    # A name that is too long itself stays so: the system says why it cannot be written.
    most = max(LONGEST_NAME - len(end) - 1, 0) if len(raw) <= LONGEST_NAME else len(raw)
    return f".{os.fsdecode(raw[:most]) if len(raw) > most else name}{end}"


_remains: dict[Path, tuple[float, list[str]]] = {}
"""By folder: when it was looked through, and the temporary files that were in it."""


def _temporary(path: Path) -> tuple[Path, BinaryIO]:
    """A new file, locked and open, beside the one that is written, because a rename is atomic only
    within one file system."""
    while True:
        candidate = path.with_name(_temporary_name(path.name))
        _remove_remains(candidate)
        file = candidate.open("xb")
        # Before it was locked, another process may have taken it for what a killed one left.
        if _try_lock(file, otherwise=True) and candidate.exists():
            return candidate, file
        file.close()


def _remove_remains(candidate: Path) -> None:
    """Remove temporary files of the same name as `candidate` whose process is gone."""
    folder, now = candidate.parent, time.monotonic()
    seen, names = _remains.get(folder, (-math.inf, []))
    if now - seen > _LOOK_AGAIN:
        with contextlib.suppress(OSError):
            names = [entry.name for entry in os.scandir(folder) if entry.name.endswith(".tmp")]
        _remains[folder] = now, names
    for name in names:
        same = name[: -len(_RANDOM)] == candidate.name[: -len(_RANDOM)]
        if same and _IS_RANDOM.fullmatch(name[-len(_RANDOM) :]):
            with contextlib.suppress(OSError), (folder / name).open("r+b") as file:
                if _try_lock(file, otherwise=False):
                    (folder / name).unlink()


def _try_lock(file: BinaryIO, *, otherwise: bool) -> bool:
    """Hold a file until it is closed, however that happens; False where another process or thread
    holds it, and `otherwise` where the file system knows no locks."""
    if sys.platform == "win32":
        return True  # the system removes no file that is open
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in (errno.EACCES, errno.EAGAIN, errno.EDEADLK) and otherwise
    return True


def check_regular(path: str | Path) -> None:
    """Refuse what is there and is no regular file: opening a named pipe waits for a writer, perhaps
    for ever, and a device need not end. Missing files are left to whoever opens them.

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
        OSError: it is missing or must not be read.
        DatasetError: it is no regular file.
    """
    check_regular(path)
    return Path(path).open("rb")


def check_readable(path: str | Path) -> None:
    """Refuse a file that another library is to open and that cannot be read.

    Raises:
        DatasetError: it is missing, cannot be read or is no regular file.
    """
    try:
        with open_regular(path):
            return
    except (OSError, ValueError) as error:
        raise DatasetError(f"Cannot read {brief(path)}: {reason(error)}") from error


def read_bytes(path: str | Path) -> bytes:
    """All bytes of a file.

    Raises:
        DatasetError: the file is missing, cannot be read or is no regular file.
    """
    try:
        with open_regular(path) as file:
            return file.read()
    except (OSError, ValueError) as error:
        raise DatasetError(f"Cannot read {brief(path)}: {reason(error)}") from error


def is_file(path: str | Path) -> bool:
    """Whether a file stands there; none does under a name that no file can have."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False


LONGEST_NAME = 255
"""Bytes of the name of a file, as all usual file systems have it."""
LONGEST_PATH = 4095
"""Bytes of a path that Linux takes; other systems take fewer."""
_TEMPORARY = 8
"""Bytes of a temporary name that make it unique."""
_RANDOM = f".{'0' * _TEMPORARY}.tmp"
_IS_RANDOM = re.compile(rf"\.[0-9a-f]{{{_TEMPORARY}}}\.tmp")
"""Ends of temporary names."""
_LOOK_AGAIN = 30.0
"""Seconds after which a folder is looked through again: it may hold thousands of files."""
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
    errno.EEXIST: "a file stands where a folder is needed.",
    errno.EISDIR: "it is a folder, a file was expected.",
    errno.ENOENT: "there is no such file.",
    errno.ENAMETOOLONG: "the name is too long for the file system. Choose a shorter one.",
    errno.EFBIG: "the file system does not take files of this size.",
}


def is_unnameable(letter: str) -> bool:
    """Whether no file should have the letter in its name: control codes, halves of surrogates."""
    return ord(letter) < 32 or 0xD800 <= ord(letter) < 0xE000


def reason(error: OSError | ValueError) -> str:
    """Why the system refused a path, and what to do, as the end of a sentence.

    Names that hold a zero byte or half of a surrogate pair are ValueErrors of Python.
    """
    if isinstance(error, OSError):
        return _REASONS.get(error.errno or 0, f"{error.strerror or error}".rstrip(".") + ".")
    return "the name holds letters that no file name can hold. Choose another one."
