"""Changed files: detection of capture files that changed since they were first read."""

import hashlib
from collections.abc import Iterable
from pathlib import Path

from ..errors import DatasetError
from ..io.files import open_regular


class ChangeDetector:
    """What files were when they were seen first: size and time, and once asked for, a hash."""

    def __init__(self, paths: Iterable[Path]) -> None:
        """Look at each file; one that is missing is left to whoever reads it."""
        self._stamps = {path: _stamp(path) for path in paths}
        self._hashes: dict[Path, bytes] = {}

    def hash(self, path: Path) -> bytes:
        """SHA-256 of a file as it was when it was seen first.

        Raises:
            DatasetError: it is missing, cannot be read, or changed before it was asked for.
        """
        if path not in self._hashes:
            found = _hash(path)
            if _stamp(path) != self._stamps[path]:
                raise changed_error(path)
            self._hashes[path] = found
        return self._hashes[path]

    def check(self, path: Path) -> None:
        """Raise DatasetError if a file that was just read is another one than it was.

        Size and time are compared; where they differ, the content decides if its hash is known, as
        a file may be copied back or touched.
        """
        stamp = _stamp(path)
        if stamp == self._stamps[path]:
            return
        if path not in self._hashes or _hash(path) != self._hashes[path]:
            raise changed_error(path)
        self._stamps[path] = stamp


def changed_error(path: Path) -> DatasetError:
    """The sentence for a file that is another one than it was."""
    return DatasetError(
        f"{path} changed after the capture was read: it is another file now. Put the first one "
        f"back, or start again with the photos as they are."
    )


def _stamp(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_size, found.st_mtime_ns


def _hash(path: Path) -> bytes:
    try:
        with open_regular(path) as file:
            return hashlib.file_digest(file, "sha256").digest()
    except OSError as error:
        raise DatasetError(f"{path} cannot be read ({error.strerror}); restore it.") from error
