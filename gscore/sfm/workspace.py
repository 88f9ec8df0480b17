"""Workspace: temporary folder of a camera search, which becomes the capture at its end."""

import contextlib
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ConfigError, DatasetError, GsError
from ..io.cameras_json import write_up
from ..io.files import atomic_write, link_or_copy, read_bytes, reason
from ..io.lock import FolderLock
from ..io.runs import SEARCH_RECORD
from ..json_text import parse_json
from ..quoting import first_few
from ..text_format import count_text
from .photos import Photo, stamp

_LOCK = "lock"
_STATE = "state.json"
_CAPTURE = "capture"
_MODEL = "sparse"


class Workspace:
    """A hidden folder next to the capture, from which a stopped search resumes."""

    def __init__(self, capture: Path, root: Path) -> None:
        """Name the workspace of the photos in `root`.

        Raises:
            ConfigError: the capture's folder is not empty, or already has cameras.
        """
        self.capture, self.root = capture, root
        self._place = whole = capture.resolve()  # a link stays; its target is made
        # A rename works within one file system only, and not on a mount point.
        self._inside = os.path.ismount(whole)
        self.folder = whole / ".sfm" if self._inside else whole.parent / f".{whole.name}.sfm"
        self._in_place = (capture / "images").resolve() == root.resolve()
        self._made_parents = [p for p in whole.parents if not p.exists()]
        self._searched: dict[Photo, tuple[list[Any], list[Any] | None]] = {}
        self._lock = FolderLock(self.folder, _LOCK, "search for cameras")
        self._check_room()

    def open(self, state: dict[str, Any]) -> bool:
        """Create the folder; True if it resumes a search for the same photos and options.

        Raises:
            ConfigError: a folder of this name contains other files.
            GsError: it cannot be written, or another search uses it.
        """
        self._lock.take()
        try:
            self._check_room()  # another search may have ended since the first check
            with _as_gs_error(self.folder):
                return self._resumes(state)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Release the lock; the folder stays unless it is empty."""
        self._lock.release()
        with contextlib.suppress(OSError):
            self.folder.rmdir()

    def discard(self) -> None:
        """Remove all files, and the empty folders that were made above the capture."""
        with contextlib.suppress(OSError):
            self._clear()
        self.close()
        for parent in self._made_parents:
            with contextlib.suppress(OSError):
                parent.rmdir()  # only an empty folder can be removed

    def _check_room(self) -> None:
        check_without_cameras(self.capture)
        if self._is_taken() and not self._in_place:
            raise ConfigError(
                f"{self.capture} is not empty. Choose a new folder with -o, or the folder in whose "
                "`images` the photos are."
            )

    def _resumes(self, state: dict[str, Any]) -> bool:
        if any(path.name != _LOCK for path in self.folder.iterdir()):
            if self._state() == state:
                return True
            if self._state() is None:
                raise ConfigError(
                    f"{self.folder} is needed for the camera search, but contains other files. "
                    "Move it away, or choose another output with -o."
                )
            self._clear()
        atomic_write(self.folder / _STATE, json.dumps(state).encode())
        return False

    def _clear(self) -> None:
        """Remove all files but the lock, the state, which identifies the folder, last."""
        paths = [path for path in self.folder.iterdir() if path.name != _LOCK]
        for path in sorted(paths, key=lambda path: path.name == _STATE):
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)

    @property
    def links(self) -> Path:
        """Folder of the photos under their aliases."""
        return self.folder / "links"

    @property
    def masks(self) -> Path:
        """Folder of their masks, white where features are extracted."""
        return self.folder / "masks"

    def link_photos(self, photos: list[Photo], stamps: list[list[Any]]) -> None:
        """Fill `links`; links of an earlier search stay.

        Args:
            photos: The photos.
            stamps: Stamps of all photos in the folder, from before they were read.

        Raises:
            DatasetError: a photo changed since its stamp was taken.
            GsError: a link cannot be written.
        """
        known = {stamp[0]: stamp for stamp in stamps}
        with _as_gs_error(self.links):
            self.links.mkdir(exist_ok=True)
            for photo in photos:
                link = self.links / photo.alias
                if _stamp(photo, link) != known[photo.name]:
                    link.unlink(missing_ok=True)
                    link_or_copy(self.root / photo.name, link)
        # A copy has its own stamp, because some file systems store coarser times.
        self._searched = {
            photo: (known[photo.name], _stamp(photo, self.links / photo.alias)) for photo in photos
        }
        if changed := self._replaced():
            raise DatasetError(f"{_changed(changed)} Start again once the photos are complete.")

    def check_photos(self) -> list[str]:
        """Messages on photos that were replaced while those in `links` were searched.

        Raises:
            DatasetError: a searched photo was written to, so the result is invalid.
            GsError: photos of a capture that gets its cameras in place were replaced; the result is
                valid once the original photos are back.
        """
        written = [
            photo.name
            for photo, (_, linked) in self._searched.items()
            if _stamp(photo, self.links / photo.alias) != linked
        ]
        if written:
            raise DatasetError(f"{_changed(written)} Start again once the photos are complete.")
        replaced = self._replaced()
        if replaced and self._in_place:
            raise GsError(
                f"{_changed(replaced)} Put the original ones back and start again to resume, or "
                "start again with the new photos."
            )
        return [
            f"{_changed(names)} {self.capture} contains them as they were when the search began."
            for names in [replaced]
            if names
        ]

    def _replaced(self) -> list[str]:
        """Names of photos that changed since the search began."""
        return [
            photo.name
            for photo, (known, _) in self._searched.items()
            if _stamp(photo, self.root / photo.name) != known
        ]

    def publish(
        self, model: Any, photos: list[Photo], record: str, *, up: np.ndarray | None = None
    ) -> None:
        """Move the capture to its output with one rename, and remove the intermediate files.

        The photos of `links` are hard-linked, which takes no space and keeps them even if the
        original is removed or replaced, or copied if the file system does not support it.

        Args:
            model: pycolmap's Reconstruction; its images get the names of their photos.
            photos: All photos of the search.
            record: Result and photos of the search, as JSON.
            up: Up direction [3] in the model's world; None: unknown.

        Raises:
            GsError: it cannot be written.
        """
        made = self.folder / _CAPTURE
        with _as_gs_error(self.capture):
            shutil.rmtree(made, ignore_errors=True)
            sparse = made / _MODEL / "0"
            sparse.mkdir(parents=True)
            names = {photo.alias: photo.name for photo in photos}
            for image in model.images.values():
                image.name = names[image.name]
            model.write(sparse)
            write_up(sparse, up)
            atomic_write((self._place if self._in_place else made) / SEARCH_RECORD, record.encode())
            if self._in_place:
                (made / _MODEL).rename(self._place / _MODEL)
            else:
                self._fill(made, photos)
                self._put_in_place(made)
        with contextlib.suppress(OSError):
            self._clear()

    def _is_taken(self) -> bool:
        """Whether the output exists and is not an empty folder."""
        if not self._place.is_dir():
            return self._place.exists()
        return any(path != self.folder for path in self._place.iterdir())

    def _put_in_place(self, made: Path) -> None:
        if self._inside:
            for part in sorted(made.iterdir()):  # `sparse`, which makes it a capture, is last
                part.rename(self._place / part.name)
            return
        with contextlib.suppress(FileNotFoundError):
            self._place.rmdir()
        made.rename(self._place)

    def _fill(self, made: Path, photos: list[Photo]) -> None:
        for photo in photos:
            link_or_copy(self.links / photo.alias, made / "images" / photo.name)
            mask = self.masks / f"{photo.alias}.png"
            if mask.is_file():
                link_or_copy(mask, made / "masks" / f"{photo.name}.png")

    def _state(self) -> Any:
        try:
            return parse_json(read_bytes(self.folder / _STATE))
        except (DatasetError, ValueError):
            return None


def _stamp(photo: Photo, path: Path) -> list[Any] | None:
    """The stamp of a photo's file; None where it is gone."""
    try:
        return stamp(photo.name, path)
    except DatasetError:
        return None


def _changed(names: list[str]) -> str:
    return (
        f"{count_text(len(names), 'photo')} changed while the cameras were searched: "
        f"{first_few(names, 3)}."
    )


def check_without_cameras(capture: Path) -> None:
    """Raise ConfigError if a capture already has cameras."""
    if (capture / _MODEL).exists():
        raise ConfigError(
            f"{capture} already contains cameras, in {capture / _MODEL}. Remove that folder to "
            "find new ones, or choose another output with -o."
        )


@contextlib.contextmanager
def _as_gs_error(place: Path) -> Iterator[None]:
    """Context that turns a refusal of the system into a GsError that names `place`."""
    try:
        yield
    except OSError as error:
        raise GsError(f"Cannot write {place}: {reason(error)}") from error
