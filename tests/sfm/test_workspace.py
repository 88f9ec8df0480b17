"""Working folder of a search and destination of its capture; oracle: the files at their paths."""

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from gscore.errors import ConfigError
from gscore.io.runs import SEARCH_RECORD
from gscore.sfm.photos import Photo, stamp
from gscore.sfm.workspace import Workspace


def published(space: Workspace, photo: Photo) -> None:
    """A search that found cameras for one photo, from start to end."""
    assert space.open({"options": 1}) is False
    model: Any = SimpleNamespace(images={1: SimpleNamespace(name=photo.alias)})
    model.write = lambda folder: (folder / "cameras.bin").write_bytes(b"cameras")
    space.link_photos([photo], [stamp(photo.name, space.root / photo.name)])
    space.publish(model, [photo], "{}")
    space.close()


@pytest.fixture
def photo(tmp_path: Path) -> Photo:
    """One in `photos`."""
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.jpg").write_bytes(b"photo")
    return Photo(name="a.jpg", alias="000.jpg", width=4, height=3, camera=())


def is_capture(folder: Path) -> bool:
    """Check for the photo, the cameras and the report, and no other files."""
    files = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    return files == {"images/a.jpg", "sparse/0/cameras.bin", SEARCH_RECORD}


@pytest.mark.parametrize("kind", ["new", "empty", "link", "dangling"])
def test_the_capture_takes_the_place_it_was_given(tmp_path: Path, photo: Photo, kind: str) -> None:
    """Oracle: the capture behind the name; a link stays a link, with no other files next to it."""
    place = tmp_path / "capture"
    if kind == "empty":
        place.mkdir()
    elif kind in ("link", "dangling"):
        place.symlink_to(tmp_path / "elsewhere")
    if kind == "link":
        (tmp_path / "elsewhere").mkdir()
    published(Workspace(place, tmp_path / "photos"), photo)
    assert is_capture(place) and place.is_symlink() == (kind in ("link", "dangling"))
    left = {path.name for path in tmp_path.iterdir()} - {"elsewhere"}
    assert left == {"photos", "capture"}


@pytest.mark.parametrize("in_place", [False, True])
def test_a_folder_that_is_a_file_system_of_its_own(
    tmp_path: Path, photo: Photo, monkeypatch: pytest.MonkeyPatch, in_place: bool
) -> None:
    """Oracle: no change outside it, because renaming across file systems fails."""
    place, root = tmp_path / "capture", tmp_path / "photos"
    place.mkdir()
    if in_place:
        root = root.rename(place / "images")
    monkeypatch.setattr(os.path, "ismount", lambda path: Path(path) == place)
    real = Path.rename

    def within(self: Path, target: Path) -> Path:
        assert place in self.parents and place in Path(target).parents
        return real(self, target)

    monkeypatch.setattr(Path, "rename", within)
    space = Workspace(place, root)
    assert space.folder.parent == place
    space.open({"options": 1})
    space.close()
    again = Workspace(place, root)
    assert again.open({"options": 1}) is True  # files of a stopped search
    again.discard()
    published(Workspace(place, root), photo)
    assert is_capture(place)


def test_a_place_that_is_taken(tmp_path: Path, photo: Photo) -> None:
    """Oracle: a sentence for a file, and for a folder that is not empty."""
    (tmp_path / "file").write_text("x")
    for name in ("file", "photos"):
        with pytest.raises(ConfigError, match="is not empty"):
            Workspace(tmp_path / name, tmp_path / "elsewhere")
