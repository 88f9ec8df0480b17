"""Photo folder facts: photos or a video without cameras, before structure from motion."""

from collections import Counter
from pathlib import Path

from ..datasets.capture import listing
from ..datasets.shots import stem_of
from ..errors import GsError
from ..io.images.read_image import read_info
from ..io.unsupported_formats import unread_cameras
from ..sfm.heic import conversion_hint, readable, size_of
from ..sfm.photos import LEAST, list_photos, mask_folder, photo_folder, photo_folder_warning
from ..text_format import count_text
from ..video import is_video
from .capture_facts import CaptureFacts, Problem

PHOTOS, VIDEO = "photos", "a video"
"""Values of `CaptureFacts.bare`."""


def photo_folder_facts(source: Path) -> CaptureFacts:
    """Facts of a source without cameras (`has_no_cameras`), from the headers of photos.

    Args:
        source: A video, or a folder of photos.
    """
    if is_video(source):
        return CaptureFacts(source=source, bare=VIDEO)
    root = photo_folder(source)
    masks = mask_folder(root, None)
    names, unread = list_photos(root, (masks,) if masks else ())
    sizes: Counter[tuple[int, int]] = Counter()
    problems = []
    for name in names:
        try:
            info = read_info(root / name)
            sizes[info.width, info.height] += 1
        except GsError as error:
            problems.append(Problem(is_error=True, text=str(error)))
    stems = set(map(stem_of, names))
    changed, unread = readable([name for name in unread if stem_of(name) not in stems])
    sizes.update(size_of(root / name) for name in changed)
    names += changed
    if len(names) < LEAST:
        few = f"Only {count_text(len(names), 'photo')}: at least {LEAST} that overlap are needed, "
        problems.append(Problem(is_error=True, text=f"{few}30 or more are good."))
    for text in filter(
        None, (unread_cameras(source), photo_folder_warning(root, names, len(sizes)))
    ):
        problems.append(Problem(is_error=False, text=text))
    if unread:
        left = count_text(len(unread), "photo is of a kind", "photos are of kinds")
        hint = conversion_hint(unread)
        text = f"{left} that is not read: {listing(unread, 2)}. To use them, {hint}."
        problems.append(Problem(is_error=False, text=text))
    return CaptureFacts(
        source=source,
        bare=PHOTOS,
        photos=len(names),
        sizes=dict(sizes.most_common()),
        problems=tuple(problems[:3]),
    )
