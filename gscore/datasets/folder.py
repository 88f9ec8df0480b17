"""Folder lookup: files by the names in a capture, despite other case, ending or Unicode form."""

import os
import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from pathlib import Path, PurePath, PurePosixPath

from ..io.files import is_file
from ..io.images.read_image import IMAGE_ENDINGS

_MARKED = re.compile(r"[._@#!]mask$", re.IGNORECASE)
"""End of a mask's stem: RealityScan appends one of these signs and the name of the layer to the
photo's file name, Metashape's template is `{filename}_mask.png`."""


class Folder:
    """Image files below a folder, listed once."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._files: dict[str, str] = {}
        self._stems: dict[str, list[str]] = {}
        for folder, _, names in os.walk(root):
            prefix = Path(folder).relative_to(root).as_posix()
            for name in names:
                if Path(name).suffix.lower() not in IMAGE_ENDINGS:
                    continue
                path = name if prefix == "." else f"{prefix}/{name}"
                self._files[_key(path)] = path
                self._stems.setdefault(_stem(path), []).append(path)

    def __len__(self) -> int:
        return len(self._files)

    def find_image(self, name: str) -> Path | None:
        """The file named `name`, else one that differs in case, else the only one of this stem."""
        name = _clean(name)
        path = self.root / name
        # The disk first, because files with unusual endings are not listed.
        if is_file(path):
            return path
        if _key(name) in self._files:
            return self.root / self._files[_key(name)]
        same = self._stems.get(_stem(name), [])
        return self.root / same[0] if len(same) == 1 else None

    def find_mask(self, name: str) -> Path | None:
        """The mask of image `name`: `name.png` as in COLMAP, else the same stem, else one marked as
        a mask, such as `name_mask.png`."""
        name = _clean(name)
        if _key(f"{name}.png") in self._files:
            return self.root / self._files[_key(f"{name}.png")]
        plain = self.find_image(str(PurePosixPath(name).with_suffix(".png")))
        if plain is not None:
            return plain
        path = self._marked.get(_key(name)) or self._marked.get(_stem(name))
        return None if path is None else self.root / path

    @cached_property
    def _marked(self) -> dict[str, str]:
        return _masks_by_photo(self._files.values())

    def find_images(self, names: Sequence[str]) -> list[Path | None]:
        """The files of images. If none is found, the common parent folders of the names are
        dropped, and then the only file of an image's name in any folder is used."""
        files = _without_common(self.find_image, names)
        if any(files):
            return files
        keys = [_key(PurePosixPath(_clean(name)).name) for name in names]
        count = Counter(keys)
        by_name: dict[str, list[str]] = {}
        for path in self._files.values():
            by_name.setdefault(_key(PurePosixPath(path).name), []).append(path)
        hits = [by_name.get(key, []) if count[key] == 1 else [] for key in keys]
        return [self.root / hit[0] if len(hit) == 1 else None for hit in hits]

    def find_masks(self, names: Sequence[str]) -> list[Path | None]:
        """The masks of images; folders as in `find_images`."""
        return _without_common(self.find_mask, names)


def masks_by_photos(photos: Sequence[Path | None]) -> list[Path | None]:
    """Masks next to photos, named like the photo with a mark, such as `IMG_0.JPG.mask.png` and
    `IMG_0_mask.png`; None: no mask, or no photo."""
    known = set(photos)
    folders = {photo.parent for photo in photos if photo is not None and photo.parent.is_dir()}
    marked = {
        folder: _masks_by_photo(
            file.name
            for file in folder.iterdir()
            if file.suffix.lower() in IMAGE_ENDINGS and file not in known
        )
        for folder in folders
    }

    def find(photo: Path | None) -> Path | None:
        if photo is None or photo.parent not in marked:
            return None
        names = marked[photo.parent]
        name = names.get(_key(photo.name)) or names.get(_stem(photo.name))
        return None if name is None else photo.parent / name

    return [find(photo) for photo in photos]


def without_masks(names: Sequence[str], others: Iterable[str] = ()) -> list[str]:
    """Names without those of masks of one of the names or of one of `others`."""
    photos = {key for name in (*names, *others) for key in (_key(name), _stem(name))}
    return [name for name in names if _photo_of_mask(name) not in photos]


def is_marked_mask(path: PurePath) -> bool:
    """True if a file name has the mark of a mask."""
    return bool(_photo_of_mask(path.name))


def same_name(name: str) -> str:
    """Normalised name for comparison: NFC of Unicode's annex 15, because macOS and some tools write
    NFD."""
    return unicodedata.normalize("NFC", name)


def _without_common(find: Callable[[str], Path | None], names: Sequence[str]) -> list[Path | None]:
    paths = [PurePosixPath(_clean(name)) for name in names]
    while True:
        files = [find(path.as_posix()) for path in paths]
        alone = any(len(path.parts) < 2 for path in paths)
        if any(files) or alone or len({path.parts[0] for path in paths}) != 1:
            return files
        paths = [PurePosixPath(*path.parts[1:]) for path in paths]


def _masks_by_photo(paths: Iterable[str]) -> dict[str, str]:
    """Marked masks by the key of their photo, which may lack its ending."""
    return {owner: path for path in sorted(paths) if (owner := _photo_of_mask(path))}


def _photo_of_mask(path: str) -> str:
    """Key of the photo of a marked mask, which may lack its ending; empty: no mask."""
    stem = _stem(path)
    return _MARKED.sub("", stem) if _MARKED.search(stem) else ""


def _key(path: str) -> str:
    return same_name(path).lower()


def _clean(name: str) -> str:
    return PurePosixPath(name.replace("\\", "/")).as_posix()


def _stem(path: str) -> str:
    return _key(str(PurePosixPath(path).with_suffix("")))
