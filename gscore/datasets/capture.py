"""Capture: views, points and split, the common result of the readers of all layouts."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..io.colmap.model import ColmapCamera
from ..quoting import brief
from ..scene import PointCloud


@dataclass(frozen=True, kw_only=True)
class View:
    """One posed photo as the capture states it, before undistortion and scaling."""

    name: str
    """Unique in the capture, sub-folders with '/'."""
    image: Path
    """File of the photo; where the reader did not require it, perhaps not there."""
    viewmat: np.ndarray
    """[4, 4] float64, world to camera, OpenCV axes."""
    camera: ColmapCamera
    """Intrinsics at the camera's own size."""
    mask: Path | None = None
    """File of the mask that the capture states for this view."""
    seen: np.ndarray | None = None
    """[M] int64, indices of the points observed in this view; None: unknown, or nobody asks,
    because the points have colours."""

    def fits(self, width: int, height: int) -> bool:
        """Whether a photo of this size is the camera's up to one scale, within rounding."""
        scale = width / self.camera.width
        return abs(self.camera.height * scale - height) <= 1.0 + 0.5 * scale


@dataclass(frozen=True, kw_only=True)
class Capture:
    """A capture as stated by its files."""

    root: Path
    """Folder with everything."""
    views: list[View]
    """In any order."""
    points: PointCloud
    """World points; may be empty."""
    up: np.ndarray | None = None
    """[3] float64, unit: up in the world, where the capture states it."""
    origin: np.ndarray | None = None
    """[3] float64, where the origin of views and points lies in the coordinates of the capture;
    None: it is that of these."""
    error_px: float | None = None
    """Mean reprojection error of the points, pixels; None: not stated."""
    test_names: frozenset[str] = frozenset()
    """Views the capture itself calls test views."""
    masks_are: str = ""
    """What masks mean unless the user says: `ignore`, or `composite` for mattes of the subject;
    empty: that is seen from what they show."""
    warnings: tuple[str, ...] = field(default=())
    """Sentences for the user."""


def listing(names: list[str], most: int = 5) -> str:
    """The first few names for a message."""
    return ", ".join(map(brief, names[:most])) + (", ..." if len(names) > most else "")


def repeated(names: list[str]) -> list[str]:
    """Names that are there more than once, sorted."""
    return sorted(name for name, count in Counter(names).items() if count > 1)
