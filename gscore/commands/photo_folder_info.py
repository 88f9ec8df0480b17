"""Photos and videos in `gscore info`: their sizes, the cost of finding cameras, the next step."""

from collections import Counter
from pathlib import Path
from typing import Any

from ..config import DataConfig
from ..io.unsupported_formats import unread_cameras
from ..quoting import as_typed, first_few
from ..sfm.heic import header_of, readable
from ..sfm.panorama import possible_panoramas, refused_panoramas
from ..sfm.photos import (
    LEAST,
    by_camera,
    excluded_folders,
    list_photos,
    one_of_each_name,
    photo_folder,
    photo_folder_warning,
    photo_of,
    read_photos,
)
from ..sfm.pycolmap_stages import Work
from ..sfm.search_request import SearchRequest, attempts
from ..text_format import count_text, number, time_text
from ..video.source import opened_video


def photos_facts(path: Path, data: DataConfig) -> dict[str, Any]:
    """Facts on photos as JSON values, from their headers.

    Raises:
        DatasetError: a photo cannot be read.
    """
    masks = Path(data.masks) if data.masks else None
    request = SearchRequest(photos=path, output=_capture(path), masks=masks)
    root = photo_folder(path)
    names, unread = list_photos(root, excluded_folders(request, root))
    photos = read_photos(
        root, names, on_photo=lambda done: None, cancelled=lambda: False, whole=False
    )
    changed, unread = readable(unread)
    for i, name in enumerate(changed, len(photos)):
        with header_of(root / name) as image:
            photos.append(photo_of(name, i, image))
    panoramas = {photo.name: photo.panorama for photo in photos}
    refused = refused_panoramas(panoramas, request)
    possible = "" if refused else possible_panoramas(panoramas, request)
    photos = one_of_each_name(photos)
    work = Work(request=request, root=root, photos=photos, masks=None, folder=root)
    first = attempts(request)[0]
    doubtful = photo_folder_warning(root, names, len(by_camera(photos)))
    return {
        "kind": "photos",
        "path": str(path),
        "photos": len(photos),
        "unread": unread,
        "sizes": dict(Counter(f"{p.width} x {p.height}" for p in photos).most_common()),
        "cameras": len(by_camera(photos)),
        "enough": len(photos) >= LEAST,
        "pairs": work.pairs_expected(first),
        "sfm_seconds": round(work.forecast(first).seconds, 1),
        "next": None if doubtful or refused else as_typed("train", path, "-o", "run"),
        "warnings": [text for text in (refused, possible, doubtful, unread_cameras(path)) if text],
    }


def photos_text(facts: dict[str, Any]) -> list[str]:
    """The facts as lines of text."""
    sizes = ", ".join(f"{count} of {size}" for size, count in facts["sizes"].items())
    cameras = count_text(facts["cameras"], "camera and lens", "cameras and lenses")
    lines = [
        f"{facts['path']}: {count_text(facts['photos'], 'photo')} without cameras",
        f"  sizes: {sizes}; {cameras} according to EXIF",
    ]
    if facts["unread"]:
        left_out = count_text(len(facts["unread"]), "photo")
        lines.append(f"  {left_out} of unsupported formats: {first_few(facts['unread'], 3)}")
    if not facts["enough"]:
        least = count_text(LEAST, "photo")
        return [*lines, f"  at least {least} with overlap are needed, better 30 or more"]
    if facts["next"] is None:
        return lines
    about = time_text(float(f"{facts['sfm_seconds']:.1g}"))
    return [
        *lines,
        f"  finding their cameras matches {number(facts['pairs'])} pairs and takes about {about} "
        "on this machine",
        f"Next: {facts['next']}",
    ]


def _capture(path: Path) -> Path:
    whole = path.absolute()
    return whole.with_name(f"{whole.name}-capture")


def video_facts(path: Path) -> dict[str, Any]:
    """Facts on a video as JSON values; only the first frames are decoded.

    Raises:
        BackendError: PyAV is not installed.
        GsError: not a video, damaged, encrypted or of an unsupported codec.
    """
    with opened_video(path) as video:
        facts = video.facts
    width, height = round(facts.width * max(facts.aspect, 1)), facts.height
    if facts.aspect < 1:
        height = round(height / facts.aspect)
    if facts.rotation in (90, 270):
        width, height = height, width
    return {
        "kind": "video",
        "path": str(path),
        "width": width,
        "height": height,
        "frames": facts.frames,
        "seconds": round(facts.seconds, 2),
        "codec": facts.codec,
        "hdr": facts.hdr,
        "interlaced": facts.interlaced,
        "rotation": facts.rotation,
        "next": as_typed("train", path, "-o", "run"),
        "warnings": [],
    }


def video_text(facts: dict[str, Any]) -> list[str]:
    """The facts as lines of text."""
    known = [count_text(facts["frames"], "frame")] if facts["frames"] else []
    known += [time_text(facts["seconds"])] if facts["seconds"] else []
    known += [f"{facts['width']} x {facts['height']} px", facts["codec"]]
    known += [facts["hdr"]] if facts["hdr"] else []
    known += ["interlaced"] if facts["interlaced"] else []
    return [
        f"{facts['path']}: a video, {', '.join(known)}",
        "  training extracts 30 to 300 sharp frames as photos and finds their cameras",
        f"Next: {facts['next']}",
    ]
