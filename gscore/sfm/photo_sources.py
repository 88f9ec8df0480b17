"""Photo sources other than one folder: video, several folders, converted photos; staged first."""

import contextlib
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from ..control import Control
from ..datasets.masks import MASK_FOLDER
from ..errors import DatasetError
from ..events import Event
from ..video import is_video
from .search_request import SearchRequest
from .staging import IMAGES, is_staged, remove_empty, stage_photos, with_frames
from .workspace import check_without_cameras


@contextlib.contextmanager
def photos_from(
    request: SearchRequest,
    sources: Sequence[Path],
    *,
    frames: int = 0,
    on_event: Callable[[Event], None] = lambda event: None,
    control: Control | None = None,
) -> Iterator[SearchRequest]:
    """Context manager that stages the photos of all sources; yields the request to search them.

    If the block raises DatasetError, because the photos give no model, the staged files are
    removed. A stopped or killed search keeps them to resume from.

    Args:
        request: Its output is the capture.
        sources: Folders of photos, and videos.
        frames: Maximum number per video; 0: chosen by the motion.
        on_event: Receiver of progress events.
        control: Source of stop requests.

    Raises:
        As `stage_photos` and `with_frames`.
    """
    if not (is_staged(request, sources) or is_video(sources[0])):
        yield request
        return
    capture = request.output
    check_without_cameras(capture)
    whole = capture.absolute()
    made = [p for p in (whole / MASK_FOLDER, whole / IMAGES) if not p.exists()]
    above = [p for p in (whole, *whole.parents) if not p.exists()]
    try:
        if is_staged(request, sources):
            request = stage_photos(
                request, sources, frames=frames, on_event=on_event, control=control
            )
        else:
            request = with_frames(request, frames=frames, on_event=on_event, control=control)
        yield request
    except DatasetError:
        for folder in made:
            shutil.rmtree(folder, ignore_errors=True)
        remove_empty(above)
        raise
