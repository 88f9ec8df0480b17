"""Frame folder: written under a temporary name, renamed, and reused by a second run."""

import contextlib
import io
import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .._version import __version__
from ..errors import ConfigError, GsError
from ..io.files import atomic_write, read_bytes, reason
from ..io.images.pillow_images import pillow
from ..io.images.png import write_png
from ..io.lock import FolderLock
from ..json_text import parse_json
from ..quoting import brief
from .request import ExtractRequest

FRAMES_FILE = "frames.json"
"""Record next to the frames, with their video and times."""
_QUALITY = 97
"""JPEG quality, with full colour resolution: see docs/video.md for its cost."""
_LOCK, _FRAMES = "lock", "frames"
"""Content of the hidden folder in which frames are written: lock file and frames."""
_FRAME = re.compile(r"frame_\d{6,}\.(jpg|png)")
_COUNTS = ("width", "height", "total", "blurred", "repeated")
"""Integers of the record."""
_METHOD = 1
"""Version of the selection; increase it when the same video would give other frames."""


class FrameFolder:
    """Output folder of a request."""

    def __init__(self, request: ExtractRequest, *, overwrite: bool = False) -> None:
        """Check the content of the folder.

        Args:
            request: The request.
            overwrite: Frames of another request, but no other files, may be replaced.

        Raises:
            ConfigError: the folder has other content.
        """
        self._request, self._place = request, request.output
        whole = request.output.absolute()
        self._overwrite = overwrite
        self._work_folder = whole.parent / f".{whole.name}.frames"
        self._work = self._work_folder / _FRAMES
        self._lock = FolderLock(self._work_folder, _LOCK, "run of gscore frames")
        self._made = [p for p in whole.parents if not p.exists()]
        self._look()

    def _look(self) -> None:
        """Find the frames of this request, or the files to replace."""
        record = _record(self._place / FRAMES_FILE)
        self._replaced: list[str] = []
        """Files of another run to remove, the record last, because it identifies them."""
        self.found: dict[str, Any] | None = None
        """Record of an earlier run that wrote the same frames; None: none."""
        if record is not None and self._is_same(record) and self._is_whole(record):
            self.found = record
        elif self._place.exists() and not (self._place.is_dir() and not any(self._place.iterdir())):
            self._check_replaceable(record)

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """Lock the folder for a block that calls `put`; after an error nothing is left. `found` is
        updated, because another process may have written the frames meanwhile.

        Raises:
            ConfigError: the folder, or the hidden folder next to it, has other content.
            GsError: the folder cannot be written, or another process is writing it.
        """
        self._check_other_folder()
        self._lock.take()
        try:
            self._look()
            # Remove frames of a killed run.
            shutil.rmtree(self._work, ignore_errors=True)
            self._work.mkdir()
            yield
        except OSError as error:
            raise GsError(f"Cannot write {brief(self._place)}: {reason(error)}") from error
        finally:
            shutil.rmtree(self._work, ignore_errors=True)
            self._lock.release()
            for folder in (self._work_folder, *self._made):
                with contextlib.suppress(OSError):
                    folder.rmdir()  # only an empty one can be removed

    def _check_other_folder(self) -> None:
        """Raise ConfigError if the hidden folder is not by gscore, which always has a lock file."""
        names = (
            {path.name for path in self._work_folder.iterdir()}
            if self._work_folder.is_dir()
            else set()
        )
        if names and (_LOCK not in names or names - {_LOCK, _FRAMES}):
            raise ConfigError(
                f"{brief(self._work_folder)} is the temporary folder for unfinished frames, but "
                "contains something else. Move it away, or choose another output with -o."
            )

    def put(self, number: int, pixels: np.ndarray) -> str:
        """Write one frame and return its file name.

        Args:
            number: Number of the frame in the video, from 0.
            pixels: [H, W, 3] uint8.
        """
        name = f"frame_{number:06}.{self._request.format}"
        if self._request.format == "png":
            write_png(self._work / name, pixels)
        else:
            encoded = io.BytesIO()
            picture = pillow().fromarray(pixels)
            picture.save(encoded, "JPEG", quality=_QUALITY, subsampling=0)
            (self._work / name).write_bytes(encoded.getvalue())
        return name

    def publish(self, facts: dict[str, Any]) -> None:
        """Write the record and rename the folder to its final name.

        Args:
            facts: Content of the record, with `frames`: rows with a `name` each.
        """
        record = {"gscore": __version__, "request": self._stamp(), **facts}
        atomic_write(self._work / FRAMES_FILE, (json.dumps(record, indent=1) + "\n").encode())
        if self._place.exists():
            for name in self._replaced:
                (self._place / name).unlink(missing_ok=True)
            self._place.rmdir()
        self._work.replace(self._place)

    def _stamp(self) -> dict[str, Any]:
        """Properties that identify frames of the same request."""
        request, stat = self._request, self._request.video.stat()
        return {
            "method": _METHOD,
            "video": request.video.name,
            "bytes": stat.st_size,
            "changed": stat.st_mtime_ns,
            "frames": request.frames,
            "format": request.format,
        }

    def _check_replaceable(self, record: dict[str, Any] | None) -> None:
        """Set the files to replace, or raise ConfigError."""
        place = brief(self._place)
        if record is None:
            raise ConfigError(
                f"{place} contains something else. Choose a new folder with -o, or remove it."
            )
        if not self._overwrite:
            raise ConfigError(
                f"{place} contains frames of another video, of other options, or not all of them. "
                "Choose a new folder with -o, or replace them with `--overwrite`."
            )
        rows = record.get("frames")
        listed = rows if isinstance(rows, list) else []
        names = [str(row.get("name")) for row in listed if isinstance(row, dict)]
        ours = [name for name in names if _FRAME.fullmatch(name)] + [FRAMES_FILE]
        others = sorted({path.name for path in self._place.iterdir()} - set(ours))
        if others:
            raise ConfigError(
                f"{place} contains other files than the frames that gscore wrote, such as "
                f"{brief(others[0])}. Choose a new folder with -o, or move them away."
            )
        self._replaced = ours

    def _is_same(self, record: dict[str, Any]) -> bool:
        return self._request.video.is_file() and record.get("request") == self._stamp()

    def _is_whole(self, record: dict[str, Any]) -> bool:
        """True if a record is complete and its frames exist."""
        rows, warnings = record.get("frames"), record.get("warnings")
        return (
            all(type(record.get(name)) is int for name in _COUNTS)
            and isinstance(warnings, list)
            and all(isinstance(text, str) for text in warnings)
            and isinstance(rows, list)
            and all(map(self._is_there, rows))
        )

    def _is_there(self, row: Any) -> bool:
        if not isinstance(row, dict) or type(row.get("seconds")) not in (int, float):
            return False
        name = str(row.get("name"))
        return _FRAME.fullmatch(name) is not None and (self._place / name).is_file()


def _record(path: Path) -> dict[str, Any] | None:
    try:
        found = parse_json(read_bytes(path))
    except (GsError, ValueError):
        return None
    return found if isinstance(found, dict) else None
