"""Changed files: detection of capture files that changed since they were first read."""

import hashlib
from collections.abc import Iterable
from pathlib import Path

from ..errors import DatasetError
from ..io.files import open_regular


class ChangeDetector:
    """First size, time and, on request, hash of files, compared with later ones."""

    def __init__(self, paths: Iterable[Path]) -> None:
        """Record size and time of each file; missing files fail when they are read."""
        self._stamps = {path: _stamp(path) for path in paths}
        self._hashes: dict[Path, bytes] = {}

    def hash(self, path: Path) -> bytes:
        """SHA-256 of a file in its first state.

        Raises:
            DatasetError: it is missing, cannot be read, or changed before the call.
        """
        if path not in self._hashes:
            digest = _hash(path)
            if _stamp(path) != self._stamps[path]:
                raise changed_error(path)
            self._hashes[path] = digest
        return self._hashes[path]

    def check(self, path: Path) -> None:
        """Raise DatasetError if a file that was just read differs from its first state.

        Compares size and time; if they differ, the hash decides if it is known, because a file may
        have been copied back or touched.
        """
        stamp = _stamp(path)
        if stamp == self._stamps[path]:
            return
        if path not in self._hashes or _hash(path) != self._hashes[path]:
            raise changed_error(path)
        self._stamps[path] = stamp


def changed_error(path: Path) -> DatasetError:
    """Error for a file that changed since it was first read."""
    return DatasetError(
        f"{path} changed after the capture was read: it is another file now. Put the first one "
        f"back, or start again with the current photos."
    )


def _stamp(path: Path) -> tuple[int, int] | None:
    try:
        stat = path.stat()
    except OSError:
        return None
    return stat.st_size, stat.st_mtime_ns


def _hash(path: Path) -> bytes:
    try:
        with open_regular(path) as file:
            return hashlib.file_digest(file, "sha256").digest()
    except OSError as error:
        raise DatasetError(f"{path} cannot be read ({error.strerror}); restore it.") from error
