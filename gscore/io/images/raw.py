"""Full-size picture of raw photos, and of TIFFs that begin with a thumbnail.

Raw files of most cameras are TIFFs (tags of TIFF 6.0, TIFF/EP and DNG 1.7) whose first directory is
a preview, which Pillow would read as the photo.
"""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from ...errors import BackendError, FormatError
from ...extras import install_hint, need
from ..files import open_regular
from .image_header import ImageInfo

RAW_ENDINGS = (
    *(".dng", ".cr2", ".cr3", ".nef", ".nrw", ".arw", ".srf", ".sr2", ".raf", ".orf", ".rw2"),
    *(".pef", ".srw", ".3fr", ".fff", ".iiq", ".rwl", ".mrw", ".erf", ".mos", ".x3f"),
)
"""File endings of raw photos, lower case."""
_OTHER_RAW = (b"IIRO", b"IIRS", b"MMOR", b"IIU\0", b"FUJIFILMCCD-RAW")
"""First bytes of raw photos without the magic number of TIFF: Olympus, Panasonic, Fujifilm."""
_TIFF = {b"II*\0": "<HI", b"MM\0*": ">HI", b"II+\0": "<QQ", b"MM\0+": ">QQ"}
"""Byte order and types of the number of tags and of offsets by first bytes: TIFF and BigTIFF."""
_SUBFILE, _OLD_SUBFILE, _WIDTH, _HEIGHT, _COLOURS, _CHILDREN, _DNG = (
    *(254, 255, 256, 257, 262, 330, 50706),
)
_MOSAIC = frozenset({32803, 34892})
"""PhotometricInterpretation of a colour filter array and of linear raw values."""
_SIZES = {1: 1, 3: 2, 4: 4, 13: 4, 16: 8, 18: 8}
"""Bytes per number, by type."""
_MOST, _MOST_TAGS = 64, 0xFFFF
"""Most directories that are read, and most tags of one."""
_FLIPS = {3: 3, 5: 8, 6: 6}
"""EXIF orientation by LibRaw's flip."""


_SETTINGS: dict[str, Any] = {
    "use_camera_wb": True,
    "no_auto_bright": True,  # no adjustments that differ between photos of a scene
    "adjust_maximum_thr": 0.0,
    "gamma": (2.4, 12.92),  # sRGB
    "user_flip": 0,
}


@dataclass(frozen=True)
class _Directory:
    tags: dict[int, tuple[int, ...]]
    page: int | None
    """Index among the pages of the TIFF; None: a child of a page."""

    @property
    def is_reduced(self) -> bool:
        return bool(self._first(_SUBFILE) & 1) or self._first(_OLD_SUBFILE) == 2

    @property
    def is_raw(self) -> bool:
        return _DNG in self.tags or self._first(_COLOURS) in _MOSAIC

    @property
    def pixels(self) -> int:
        return self._first(_WIDTH) * self._first(_HEIGHT)

    def _first(self, tag: int) -> int:
        return (*self.tags.get(tag, ()), 0)[0]


def is_raw(path: Path) -> bool:
    """True if the content of a file is a raw photo; TIFFs also count if their ending is that of a
    raw photo.

    Raises:
        DatasetError: it is not a regular file.
    """
    try:
        with open_regular(path) as file:
            head = file.read(16)
            if head.startswith(_OTHER_RAW) or head[4:11] == b"ftypcrx" or head[8:11] == b"CR\2":
                return True
            if head[:4] not in _TIFF:
                return False
            return path.suffix.lower() in RAW_ENDINGS or any(d.is_raw for d in _directories(file))
    except OSError:
        return False


def full_size_page(path: Path) -> int:
    """Page of a TIFF with the photo: the first, unless that is a reduced picture.

    Raises:
        FormatError: the full-size picture is not a page of its own.
    """
    with open_regular(path) as file:
        directories = _directories(file)
    if not directories:
        return 0
    first = directories[0]
    larger = [d for d in directories if not d.is_reduced and d.pixels > first.pixels]
    children = [d for d in larger if d.page is None]
    if not (first.is_reduced or children) or not larger:
        return 0
    best = max(larger, key=lambda d: d.pixels)
    if best.page is None:
        raise FormatError(
            f"{path} begins with a reduced picture, and its full-size picture is in a "
            "sub-directory, which is not supported. Save it as a TIFF, PNG or JPEG of one picture "
            "under the same name."
        )
    return best.page


def raw_info(path: Path) -> ImageInfo:
    """Size and EXIF orientation of the full-size picture of a raw photo; raises as `read_raw`."""
    with _opened(path) as raw:
        turn = _FLIPS.get(raw.sizes.flip, 1)
        return ImageInfo(raw.sizes.width, raw.sizes.height, False, turn)


def read_raw(path: Path) -> tuple[Any, int]:
    """Full-size picture of a raw photo as stored, and its EXIF orientation.

    Returns:
        [H, W, 3] uint8 sRGB with the camera's white balance, and 1, 3, 6 or 8.

    Raises:
        FormatError: rawpy is not installed, or cannot read it.
    """
    with _opened(path) as raw:
        turn = _FLIPS.get(raw.sizes.flip, 1)
        try:
            rgb = raw.postprocess(**_SETTINGS)
        except Exception as error:  # LibRaw's errors have no other common base
            raise _unread(path, str(error)) from error
        if rgb.shape[:2] != (raw.sizes.height, raw.sizes.width):
            raise _unread(path, "its pixels are not square")
        return rgb, turn


def _opened(path: Path) -> Any:
    try:
        rawpy = need("rawpy", "Reading raw photos")
    except BackendError as error:
        raise FormatError(
            f"{path} is a raw photo, and without rawpy only its preview can be read. Convert the "
            "raw photos to JPEG, PNG or TIFF at full size and without cropping, under the same "
            f"names, and move the raw ones away; or install rawpy: {install_hint('rawpy')}"
        ) from error
    try:
        return rawpy.imread(str(path))
    except Exception as error:
        raise _unread(path, str(error)) from error


def _unread(path: Path, reason: str) -> FormatError:
    return FormatError(
        f"{path} cannot be read as a raw photo ({reason.rstrip('.')}). Convert it to JPEG, PNG or "
        "TIFF at full size, under the same name, and move the raw one away."
    )


def _directories(file: BinaryIO) -> list[_Directory]:
    """Directories of a TIFF including sub-directories, up to the first damaged one."""
    file.seek(0)
    layout = _TIFF.get(file.read(4))
    directories: list[_Directory] = []
    visited: set[int] = set()
    try:
        if layout is None:
            return []
        (at,) = _next(file, layout[0] + ("4xQ" if "Q" in layout else "I"))
        while at and at not in visited and len(directories) < _MOST:
            visited.add(at)
            tags, at = _tags(file, layout, at)
            page = sum(d.page is not None for d in directories)
            directories.append(_Directory(tags, page))
            for child in tags.get(_CHILDREN, ())[:_MOST]:
                directories.append(_Directory(_tags(file, layout, child)[0], None))
    except (OSError, OverflowError, ValueError, struct.error):
        pass
    return directories


def _tags(file: BinaryIO, layout: str, at: int) -> tuple[dict[int, tuple[int, ...]], int]:
    """The needed tags of a directory, and the offset of the next directory."""
    order, counts, offsets = layout
    file.seek(at)
    (count,) = _next(file, order + counts)
    entry = f"{order}HH{offsets}{struct.calcsize(order + offsets)}s"
    entries = [_next(file, entry) for _ in range(min(count, _MOST_TAGS))]
    (following,) = _next(file, order + offsets)
    tags = {}
    for tag, kind, number, value in entries:
        size = _SIZES.get(kind, 0)
        if tag not in (_SUBFILE, _OLD_SUBFILE, _WIDTH, _HEIGHT, _COLOURS, _CHILDREN, _DNG):
            continue
        if not size or not 0 < number <= _MOST:
            continue
        if size * number > len(value):
            file.seek(struct.unpack(order + offsets, value)[0])
            value = file.read(size * number)
        letter = {1: "B", 2: "H", 4: "I", 8: "Q"}[size]
        tags[tag] = struct.unpack_from(f"{order}{number}{letter}", value)
    return tags, following


def _next(file: BinaryIO, layout: str) -> tuple[Any, ...]:
    """The next values of a file, by struct's format."""
    return struct.unpack(layout, file.read(struct.calcsize(layout)))
