"""Report pictures: thumbnails of photo, render and error of a view as JPEG data URIs."""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..extras import need
from ..io.images.pixels import as_uint8
from .colormap import colorize

MAX_WIDTH = 640
"""Widest thumbnail, pixels."""
MAX_VIEWS = 60
"""Maximum number of views with pictures, evenly spaced. All views have their numbers."""
BYTES_IN_ALL = 7_000_000
"""Budget of all thumbnails of a report as base64 text."""
BYTES_EACH = 120_000
"""Maximum size of a thumbnail."""
ERROR_GAIN = 4.0
"""Factor of error pictures: mean absolute difference of the channels times this; 1 = white."""
_WIDTHS = (640, 512, 400, 320, 240, 160)
_QUALITY = 82


@dataclass(frozen=True, kw_only=True)
class ViewPictures:
    """One row of the report's views."""

    name: str
    """Name of the view."""
    numbers: dict[str, Any]
    """The view's entry in metrics.json."""
    width: int = 0
    """Size of the thumbnails, pixels; 0: this view has numbers only."""
    height: int = 0
    photo: str = ""
    """`data:image/jpeg;base64,...` of the target picture of the metrics."""
    render: str = ""
    error: str = ""


@dataclass(kw_only=True)
class PictureCollector:
    """An `on_view` hook for `evaluate` that keeps thumbnails of the pictures."""

    count: int
    """Expected number of views; determines which get pictures, and their size."""
    views: list[ViewPictures] = field(default_factory=list)
    """`Report.views`, in the order of the views."""

    def __call__(
        self,
        place: int,
        target: np.ndarray,
        render: np.ndarray,
        weights: np.ndarray | None,
        numbers: dict[str, Any],
    ) -> None:
        """Add the pictures of one view, [H, W, 3] float in [0, 1] each; `weights`, [H, W] uint8,
        masks the error."""
        if not has_pictures(place, self.count):
            self.views.append(ViewPictures(name=numbers["name"], numbers=numbers))
            return
        render = np.clip(render, 0.0, 1.0)
        error = np.abs(render - target).mean(axis=2)
        if weights is not None:
            error *= weights / 255.0
        budget = budget_each(min(self.count, MAX_VIEWS))
        uris, size = thumbnails([target, render, error * ERROR_GAIN], budget, colored=(2,))
        self.views.append(
            ViewPictures(
                name=numbers["name"],
                numbers=numbers,
                width=size[0],
                height=size[1],
                photo=uris[0],
                render=uris[1],
                error=uris[2],
            )
        )


def thumbnails(
    pictures: Sequence[np.ndarray], budget: int, *, colored: Sequence[int] = ()
) -> tuple[list[str], tuple[int, int]]:
    """Thumbnails of a view at the largest standard width that fits the budget.

    Args:
        pictures: [H, W, 3] float in [0, 1], of one size, or [H, W].
        budget: Bytes of one picture's JPEG, on average.
        colored: Indices of [H, W] pictures to show in the error colormap.

    Returns:
        Data URIs; width and height, px.
    """
    encoded, size = [], (0, 0)
    height, width = pictures[0].shape[:2]
    for widest in _WIDTHS:
        size = size_within(width, height, min(widest, MAX_WIDTH))
        small = [shrink(as_uint8(picture), size) for picture in pictures]
        # Errors are averaged before they are coloured, because colours cannot be averaged.
        small = [colorize(p / 255.0) if i in colored else p for i, p in enumerate(small)]
        encoded = [_jpeg(picture) for picture in small]
        if sum(map(len, encoded)) <= len(pictures) * budget:
            break
    return [_uri(e) for e in encoded], size


def budget_each(shown: int) -> int:
    """JPEG bytes per picture for `shown` views of three pictures each; base64 adds a third."""
    return min(BYTES_EACH, BYTES_IN_ALL // (3 * shown)) * 3 // 4


def has_pictures(place: int, count: int) -> bool:
    """Whether view `place` of `count` has pictures: all, or `MAX_VIEWS` evenly spaced ones."""
    shown = min(count, MAX_VIEWS)
    # Exactly `shown` of `count` places satisfy this, including the first.
    return place * shown % count < shown


def data_uri(picture: np.ndarray) -> str:
    """A picture, [H, W, 3] uint8, as `data:image/jpeg;base64,...`."""
    return _uri(_jpeg(picture))


def _uri(jpeg: bytes) -> str:
    return "data:image/jpeg;base64," + base64.b64encode(jpeg).decode("ascii")


def size_within(width: int, height: int, widest: int) -> tuple[int, int]:
    """Size within a square of `widest` pixels at the same aspect; never enlarged."""
    scale = min(1.0, widest / max(width, height))
    return max(1, round(width * scale)), max(1, round(height * scale))


def _pil() -> Any:
    return need("PIL.Image", "Every picture in the report")


def shrink(picture: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """[H, W, ...] uint8 averaged down to width and height `size`."""
    image = _pil().fromarray(picture)
    if image.size == size:
        return picture
    return np.asarray(image.resize(size, _pil().Resampling.BOX))


def _jpeg(picture: np.ndarray) -> bytes:
    stream = io.BytesIO()
    _pil().fromarray(picture).save(stream, "JPEG", quality=_QUALITY, optimize=True)
    return stream.getvalue()
