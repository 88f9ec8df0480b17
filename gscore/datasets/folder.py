"""Folder lookup: files by the names in a capture, despite other case, ending or Unicode form."""

import os
import unicodedata
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath

from ..io.files import is_file
from ..io.images.read_image import IMAGE_ENDINGS


class Folder:
    """The image files below a folder, listed once."""

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
        """The file called `name`, else one differing in case, else the only one of this stem."""
        name = _clean(name)
        path = self.root / name
        # Asked of the disk first: files with unusual endings are not in the list.
        if is_file(path):
            return path
        if _key(name) in self._files:
            return self.root / self._files[_key(name)]
        same = self._stems.get(_stem(name), [])
        return self.root / same[0] if len(same) == 1 else None

    def find_mask(self, name: str) -> Path | None:
        """The mask of image `name`: `name.png` as COLMAP has it, else the same stem."""
        name = _clean(name)
        if _key(f"{name}.png") in self._files:
            return self.root / self._files[_key(f"{name}.png")]
        return self.find_image(str(PurePosixPath(name).with_suffix(".png")))

    def find_images(self, names: Sequence[str]) -> list[Path | None]:
        """The files of images; where none is there, their common folders may lack here, and then
        the only file of an image's name in any folder is taken."""
        files = _without_common(self.find_image, names)
        if any(files):
            return files
        own = [_key(PurePosixPath(_clean(name)).name) for name in names]
        wanted = Counter(own)
        there: dict[str, list[str]] = {}
        for path in self._files.values():
            there.setdefault(_key(PurePosixPath(path).name), []).append(path)
        hits = [there.get(name, []) if wanted[name] == 1 else [] for name in own]
        return [self.root / hit[0] if len(hit) == 1 else None for hit in hits]

    def find_masks(self, names: Sequence[str]) -> list[Path | None]:
        """The masks of images, as `find_images`."""
        return _without_common(self.find_mask, names)


def same_name(name: str) -> str:
    """A name as it is compared: of the two ways to write an accented letter the composed one
    (NFC of Unicode's annex 15; macOS and some tools write NFD)."""
    return unicodedata.normalize("NFC", name)


def _without_common(find: Callable[[str], Path | None], names: Sequence[str]) -> list[Path | None]:
    paths = [PurePosixPath(_clean(name)) for name in names]
    while True:
        files = [find(path.as_posix()) for path in paths]
        alone = any(len(path.parts) < 2 for path in paths)
        if any(files) or alone or len({path.parts[0] for path in paths}) != 1:
            return files
        paths = [PurePosixPath(*path.parts[1:]) for path in paths]


def _key(path: str) -> str:
    return same_name(path).lower()


def _clean(name: str) -> str:
    return PurePosixPath(name.replace("\\", "/")).as_posix()


def _stem(path: str) -> str:
    return _key(str(PurePosixPath(path).with_suffix("")))
