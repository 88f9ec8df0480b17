"""Photos of a folder: listed, checked for completeness, grouped by camera."""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..datasets.capture import listing
from ..datasets.dataset import map_threads
from ..datasets.folder import without_masks
from ..datasets.shots import Shot, moment_of, repeats, shot_of, stem_of
from ..errors import Cancelled, DatasetError, FormatError
from ..io.images.pillow_images import load_complete, opened_picture
from ..io.images.raw import RAW_ENDINGS
from ..io.images.read_image import IMAGE_ENDINGS
from ..text_format import count_text, number
from .heic import conversion_hint, is_heic
from .panorama import panorama_of
from .photo_quality import PhotoQuality, measure_quality

LEAST = 3
"""Minimum number of photos; with two, wrong matches cannot be detected."""
UNREAD = (".heic", ".heif", ".avif", *RAW_ENDINGS)
"""File name endings of unsupported photo formats."""
_EXIF_BLOCK = 0x8769
_MAKE, _MODEL = 0x010F, 0x0110
_FOCAL, _FOCAL_35, _LENS = 0x920A, 0xA405, 0xA434


@dataclass(frozen=True)
class Photo:
    """A photo of the search."""

    name: str
    """Path below the folder, with '/'."""
    alias: str
    """Name for COLMAP, without spaces, which its pair lists do not support; in natural order."""
    width: int
    """Stored width, px; COLMAP ignores the EXIF orientation, and so does gscore."""
    height: int
    camera: tuple[str, ...]
    """Make, model, lens and focal lengths from EXIF; photos of one camera have these and the size
    in common."""
    quality: PhotoQuality | None = None
    """Sharpness and brightness; None if only the header was read."""
    shot: Shot | None = None
    """Key to detect copies of one exposure; None if only the header was read."""
    moment: tuple[str, ...] = ()
    """Time of the exposure and camera from EXIF; empty: not stated."""
    panorama: str = ""
    """Evidence that it is a panorama, from `panorama_of`; empty: none."""


def photo_folder(path: Path) -> Path:
    """The folder of the photos: `path`, or its `images` or `input` if it has no photos itself.

    Raises:
        DatasetError: the folder does not exist.
    """
    if not path.is_dir():
        raise DatasetError(
            f"There is no folder {path}. Give the folder of the photos."
            if not path.exists()
            else f"{path} is a file. Give the folder of the photos."
        )
    if not any(_is_photo(file) for file in path.iterdir()):
        for inner in (path / "images", path / "input"):
            if inner.is_dir():
                return inner
    return path


def list_photos(root: Path, leave_out: tuple[Path, ...]) -> tuple[list[str], list[str]]:
    """Names of the photos below a folder, and of photos in unsupported formats, in natural order;
    hidden files, the folders `leave_out`, masks next to their photos and raw files of listed photos
    are skipped."""
    skipped = {folder.resolve() for folder in leave_out}
    names, unread = [], []
    for folder, below, files in os.walk(root):
        here = Path(folder)
        below[:] = [n for n in below if n[0] != "." and (here / n).resolve() not in skipped]
        for name in files:
            relative = (here / name).relative_to(root).as_posix()
            if _is_photo(here / name):
                names.append(relative)
            elif name[0] != "." and name.lower().endswith(UNREAD):
                unread.append(relative)
    names = without_masks(names, unread)
    stems = set(map(stem_of, names))
    unread = [name for name in unread if is_heic(name) or stem_of(name) not in stems]
    return sorted(names, key=natural), sorted(unread, key=natural)


def natural(name: str) -> tuple[list[tuple[int, str]], str]:
    """Sort key of the natural order: view_9 before view_10."""
    parts = re.split(r"(\d+)", name.lower())
    return [(int(p), "") if p.isdecimal() else (0, p) for p in parts if p], name


def check_photo_count(root: Path, names: list[str], unread: list[str]) -> None:
    """Raise DatasetError if there are too few photos to find cameras."""
    if len(names) >= LEAST:
        return
    other = ""
    if unread:
        other = (
            f" {count_text(len(unread), 'photo is', 'photos are')} in an unsupported format "
            f"({listing(unread, 2)}): {conversion_hint(unread)}."
        )
    raise DatasetError(
        f"{root} contains {count_text(len(names), 'photo') if names else 'no photos'}, but at "
        f"least {LEAST} that overlap are needed to find cameras.{other} Take 30 or more from "
        "different places."
    )


def read_photos(
    root: Path,
    names: list[str],
    *,
    on_photo: Callable[[int], None],
    cancelled: Callable[[], bool],
    whole: bool = True,
) -> list[Photo]:
    """Decode all photos once, to report damaged ones before the long work; if not `whole`, only
    read their headers.

    Raises:
        DatasetError: photos cannot be read.
        Cancelled: `cancelled` returned True.
    """

    def quality(i: int) -> Photo | str:
        if cancelled():
            raise Cancelled("Reading the photos was stopped.")
        try:
            with opened_picture(root / names[i]) as image:
                quality, shot = None, None
                if image.format == "TIFF" and image.tell():
                    raise FormatError(
                        f"{root / names[i]} starts with a reduced picture, which COLMAP would "
                        "read. Save it as a TIFF, PNG or JPEG of one picture."
                    )
                if whole:
                    load_complete(root / names[i], image)
                    quality, shot = measure_quality(image), shot_of(names[i], image)
                return photo_of(names[i], i, image, quality, shot)
        except (DatasetError, FormatError) as error:
            return str(error)

    photos, broken = [], []
    for i, found in enumerate(map_threads(quality, list(range(len(names))))):
        (broken if isinstance(found, str) else photos).append(found)
        on_photo(i + 1)
    if broken:
        more = f" {count_text(len(broken), 'photo')} cannot be read." if len(broken) > 1 else ""
        raise DatasetError(f"{broken[0]}{more}")
    return photos


def photo_of(
    name: str,
    index: int,
    image: Any,
    quality: PhotoQuality | None = None,
    shot: Shot | None = None,
) -> Photo:
    """A photo from Pillow's image, from its header unless `quality` and `shot` are given."""
    camera, alias = _camera(image), f"{index:06}{Path(name).suffix.lower()}"
    panorama = panorama_of(image, camera, whole=quality is not None)
    size = image.width, image.height
    return Photo(name, alias, *size, camera, quality, shot, moment_of(image), panorama)


def one_of_each_name(photos: list[Photo]) -> list[Photo]:
    """Photos without copies of a larger or earlier one of the same moment and name but for the
    ending. Of photos read from their headers, `one_of_each` finds only these."""
    kept: dict[tuple, Photo] = {}
    for photo in sorted(photos, key=lambda photo: -photo.width * photo.height):
        kept.setdefault((stem_of(photo.name), photo.moment or photo.name), photo)
    names = {photo.name for photo in kept.values()}
    return [photo for photo in photos if photo.name in names]


def one_of_each(root: Path, photos: list[Photo]) -> tuple[list[Photo], list[str]]:
    """Photos without copies of a larger or earlier one, such as HEIC and JPEG of one shot; and
    messages on the copies.

    Raises:
        DatasetError: fewer than `LEAST` are left.
    """
    first = sorted(photos, key=lambda photo: -photo.width * photo.height)
    pairs = repeats([photo.shot for photo in first if photo.shot is not None])
    if not pairs:
        return photos, []
    kept = len(photos) - len(pairs)
    if kept < LEAST:
        raise DatasetError(
            f"{number(len(pairs))} of the {count_text(len(photos), 'photo')} in {root} are copies "
            f"of others, and only {kept} {'is' if kept == 1 else 'are'} left. Take photos from "
            "different places."
        )
    left_out = {first[copy].name for _, copy in pairs}
    named = [f"{first[copy].name} of {first[one].name}" for one, copy in pairs]
    return [photo for photo in photos if photo.name not in left_out], [
        f"{count_text(len(pairs), 'photo shows', 'photos show')} the same picture as another and "
        f"{'is' if len(pairs) == 1 else 'are'} left out: {listing(named, 3)}."
    ]


def by_camera(photos: list[Photo]) -> list[list[Photo]]:
    """Photos grouped by camera and lens, in the order of their first ones."""
    groups: dict[tuple, list[Photo]] = {}
    for photo in photos:
        groups.setdefault((photo.width, photo.height, photo.camera), []).append(photo)
    return list(groups.values())


def _is_photo(path: Path) -> bool:
    return path.name[0] != "." and path.suffix.lower() in IMAGE_ENDINGS and path.is_file()


def _camera(image: Any) -> tuple[str, ...]:
    try:
        exif = image.getexif()
        block = exif.get_ifd(_EXIF_BLOCK)
        tags = (exif.get(_MAKE), exif.get(_MODEL), *map(block.get, (_LENS, _FOCAL, _FOCAL_35)))
        return tuple("" if tag is None else str(tag).strip("\0 ") for tag in tags)
    except Exception:  # damaged EXIF does not make the picture unusable
        return ()
