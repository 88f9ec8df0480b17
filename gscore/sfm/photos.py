"""Photos of a folder: listed, checked, grouped by camera; and folders that are captures."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ..camera_neighbours import natural_key
from ..datasets.dataset import map_threads
from ..datasets.folder import without_masks
from ..datasets.masks import masks_inside
from ..datasets.pku.case import find_video
from ..datasets.programs import find_program
from ..datasets.shots import Shot, moment_of, repeats, shot_of, stem_of
from ..datasets.transforms_json import find_transforms
from ..errors import Cancelled, DatasetError, FormatError, GsError
from ..io.files import read_bytes
from ..io.images.pillow_images import load_complete, opened_picture
from ..io.images.raw import RAW_ENDINGS
from ..io.images.read_image import IMAGE_ENDINGS, read_image, read_info
from ..io.missing_path import missing_path
from ..io.runs import SEARCH_RECORD, is_run
from ..io.unsupported_formats import unread_cameras
from ..json_text import parse_json
from ..quoting import brief, first_few
from ..text_format import count_text, number
from .heic import conversion_hint, is_heic, readable
from .panorama import panorama_of
from .photo_quality import PhotoQuality, measure_quality
from .search_request import SearchRequest

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
            missing_path(path, advice="Give the folder of the photos.")
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

    def order(name: str) -> tuple[list[tuple[int, str]], str]:
        return natural_key(name.lower()), name

    return sorted(names, key=order), sorted(unread, key=order)


def check_photo_count(root: Path, names: list[str], unread: list[str]) -> None:
    """Raise DatasetError if there are too few photos to find cameras."""
    if len(names) >= LEAST:
        return
    other = ""
    if unread:
        other = (
            f" {count_text(len(unread), 'photo is', 'photos are')} in an unsupported format "
            f"({first_few(unread, 2)}): {conversion_hint(unread)}."
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
        f"{'is' if len(pairs) == 1 else 'are'} left out: {first_few(named, 3)}."
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


_FEW_CAMERAS = 3
"""One photographer may carry several cameras; a camera that is turned counts as two."""
_MODELS = ("sparse", "colmap", "cameras.bin", "cameras.txt")
_IN_CAPTURES = ("images", "input", "photos", "rgb")
"""Names of the folder of photos in a capture."""


def is_photo_folder(path: Path) -> bool:
    """Whether a folder contains photos and no camera files, not even unreadable ones."""
    if not path.is_dir() or find_video(path) or find_transforms(path):
        return False
    if any((path / name).exists() for name in _MODELS) or find_program(path):
        return False
    names, unread = list_photos(photo_folder(path), ())
    return bool(names or readable(unread)[0])


def check_no_cameras_above(path: Path) -> None:
    """Check that a folder of plain photos is not part of a capture with their cameras.

    Raises:
        DatasetError: it is; names the folder to give.
    """
    whole = path.absolute()
    if whole.name not in _IN_CAPTURES or not _has_cameras(whole.parent):
        return
    above = path.parent if path.name else whole.parent
    images = "" if whole.name == "images" else f" with `--images {whole.name}`"
    raise DatasetError(
        f"{path} contains only the photos; {above} contains their cameras too: give "
        f"{above}{images}. To find new cameras, copy the photos to a folder of their own."
    )


def captures_inside(root: Path, names: Sequence[str]) -> str:
    """Message on pictures below a folder that are a training's, or belong to captures with cameras;
    empty if none do.

    Args:
        root: The folder.
        names: Paths below it, as returned by `list_photos`.
    """
    if is_run(root):
        return f"{root} is the folder of a training. Give the photos that it was trained on."
    places = {place for name in names for place in PurePosixPath(name).parents if place.parts}
    captures = sorted(str(place) for place in places if _has_cameras(root / place))
    if not captures:
        return ""
    other = f" and {len(captures) - 1} more" if len(captures) > 1 else ""
    return (
        f"{root} is not a folder of photos: it contains a capture, {root / captures[0]}{other}. "
        "Give that folder, or move it away."
    )


def other_cameras(path: Path) -> str:
    """Message on another program's cameras among the photos, which a search does not use; empty if
    there are none.

    Args:
        path: The folder given to the search.
    """
    found = find_program(path) if path.is_dir() else None
    if found is None:
        return unread_cameras(path)
    return (
        f"{found.path} contains cameras of these photos ({found.program}), which gscore train and "
        "the add-on read. This search ignores them and finds new ones, with another scale and "
        "origin."
    )


def photo_folder_warning(root: Path, names: Sequence[str], cameras: int) -> str:
    """Message on why pictures are hardly photos of one scene; empty if there is no sign of it.

    Args:
        root: Their folder.
        names: Paths below it, as returned by `list_photos`.
        cameras: Number of cameras by sizes and EXIF.
    """
    if sentence := captures_inside(root, names):
        return sentence
    if (root / ".git").exists():
        return (
            f"{root} is a git repository, so its {count_text(len(names), 'picture')} are hardly "
            "photos of one scene. Give the folder of the photos."
        )
    if cameras > max(_FEW_CAMERAS, len(names) / 2):
        return (
            f"The {count_text(len(names), 'picture')} in {root} are of {number(cameras)} cameras "
            "or sizes, which is typical of screenshots, not of photos of one scene. Give the "
            "folder of the photos."
        )
    if blank := _blank(root, names):
        return (
            f"Most of the {count_text(len(names), 'photo')} in {root} are blank, a single colour, "
            f"such as {blank}. No cameras can be found for them; take or export them again."
        )
    return ""


_FLAT_BYTES = 0.05
"""Bytes per pixel above which a photo is not blank: a blank JPEG has 0.02, a photo 0.1 or more."""
_BLANK_RANGE = 16
"""Largest range of the 8-bit values of a blank photo."""
_BLANK_SAMPLE = 8
"""Most photos that are decoded in the search for blank ones."""


def _blank(root: Path, names: Sequence[str]) -> str:
    """A blank photo if most are, else empty; decodes only a few photos of small files."""
    small = []
    try:
        for name in names:
            info = read_info(root / name)
            if (root / name).stat().st_size < _FLAT_BYTES * info.width * info.height + 4096:
                small.append(name)
        if not small or len(small) <= len(names) / 2:
            return ""
        sample = small[:: -(-len(small) // _BLANK_SAMPLE)]
        blank = all(np.ptp(read_image(root / name)[..., :3]) <= _BLANK_RANGE for name in sample)
    except (GsError, OSError):  # reading the photos reports it
        return ""
    return small[0] if blank else ""


def _has_cameras(folder: Path) -> bool:
    """Whether a folder is a capture whose cameras are known."""
    stated = any((folder / name).exists() for name in (*_MODELS, "transforms.json"))
    return stated or find_program(folder, below=False) is not None


def photos_of(request: SearchRequest) -> list[list[Any]]:
    """Stamps (`stamp`) of the photos of a search, as JSON values.

    Raises:
        DatasetError: the folder does not exist.
    """
    root = photo_folder(request.photos)
    return [
        stamp(name, root / name) for name in list_photos(root, excluded_folders(request, root))[0]
    ]


def mask_folder(root: Path, requested: Path | None) -> Path | None:
    """The folder of the masks: the requested one, else `masks` or `mask` in `root`, or next to it
    if `root` is a capture's `images`; None: there is none.

    Raises:
        DatasetError: the requested one does not exist.
    """
    if requested is not None:
        for place in (requested, root / requested, root.parent / requested):
            if place.is_dir():
                return place
        raise DatasetError(f"There is no mask folder {requested}. Give its path with `--masks`.")
    found = masks_inside(root)
    if found is None and root.name in ("images", "input"):
        return masks_inside(root.parent)
    return found


def excluded_folders(request: SearchRequest, root: Path) -> tuple[Path, ...]:
    """Folders below the photo folder that are not searched for photos."""
    places = (mask_folder(root, request.masks), request.output, request.excluded)
    return tuple(place for place in places if place is not None)


def stamp(name: str, path: Path) -> list[Any]:
    """Name, size in bytes and modification time in ns of a file, as JSON values.

    Raises:
        DatasetError: it is gone.
    """
    try:
        stat = path.stat()
    except OSError as error:
        raise DatasetError(
            f"{brief(path)} is gone or cannot be read any more. Put it back, or start again "
            "without it, and do not change the photos while their cameras are found."
        ) from error
    return [name, stat.st_size, stat.st_mtime_ns]


def same_photos(capture: Path, photos: list[list[Any]]) -> bool:
    """Whether a capture was made of photos with these stamps (`photos_of`)."""
    try:
        return parse_json(read_bytes(capture / SEARCH_RECORD))["photos_read"] == photos
    except (DatasetError, ValueError, KeyError, TypeError):
        return False
