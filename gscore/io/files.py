"""Files written completely or not at all."""

import contextlib
import errno
import os
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from ..errors import DatasetError, GsError


def atomic_write(path: str | Path, content: bytes | Callable[[BinaryIO], None]) -> None:
    """Write a file under a temporary name beside `path`, flush it to the disk, then rename it.

    Whoever looks at `path` sees the old file or the whole new one. The folder is made if need be.

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
        # Beside the target, because a rename is atomic only within one file system.
        candidate = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
        with candidate.open("xb") as file:
            temporary = candidate
            if callable(content):
                content(file)
            else:
                file.write(content)
            file.flush()
            os.fsync(file.fileno())
        candidate.replace(path)
        temporary = None
    except OSError as error:
        raise GsError(f"Cannot write {path}: {_reason(error)}") from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink()


def read_bytes(path: str | Path) -> bytes:
    """All bytes of a file.

    Raises:
        DatasetError: the file is missing or cannot be read.
    """
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise DatasetError(f"Cannot read {path}: {_reason(error)}") from error


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
    errno.EFBIG: "the file system does not take files of this size.",
}


def _reason(error: OSError) -> str:
    return _REASONS.get(error.errno or 0, f"{error.strerror or error}.")
