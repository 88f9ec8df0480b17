"""Files of a folder found by the names a capture uses, which may differ in case or ending."""

import os
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from ..io.files import is_file
from ..io.pictures.images import IMAGE_ENDINGS


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
                self._files[path.lower()] = path
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
        if name.lower() in self._files:
            return self.root / self._files[name.lower()]
        same = self._stems.get(_stem(name), [])
        return self.root / same[0] if len(same) == 1 else None

    def find_mask(self, name: str) -> Path | None:
        """The mask of image `name`: `name.png` as COLMAP has it, else the same stem."""
        name = _clean(name)
        if f"{name}.png".lower() in self._files:
            return self.root / self._files[f"{name}.png".lower()]
        return self.find_image(str(PurePosixPath(name).with_suffix(".png")))

    def find_masks(self, names: Sequence[str]) -> list[Path | None]:
        """The masks of images; where no name has one, their common folders may lack here."""
        paths = [PurePosixPath(_clean(name)) for name in names]
        while True:
            files = [self.find_mask(path.as_posix()) for path in paths]
            if any(files):
                return files
            if any(len(path.parts) < 2 for path in paths) or len({p.parts[0] for p in paths}) != 1:
                return files
            paths = [PurePosixPath(*path.parts[1:]) for path in paths]


def _clean(name: str) -> str:
    return PurePosixPath(name.replace("\\", "/")).as_posix()


def _stem(path: str) -> str:
    return str(PurePosixPath(path).with_suffix("")).lower()
