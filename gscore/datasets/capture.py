"""Capture: views, points and split, the common result of all readers."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..io.colmap.model import ColmapCamera
from ..scene import PointCloud


@dataclass(frozen=True, kw_only=True)
class View:
    """One posed photo as in the capture's files, before undistortion and scaling."""

    name: str
    """Unique in the capture, sub-folders separated by '/'."""
    image: Path
    """File of the photo; may be missing if the reader did not require it."""
    viewmat: np.ndarray
    """[4, 4] float64, world to camera, OpenCV axes."""
    camera: ColmapCamera
    """Intrinsics at the camera's calibrated size."""
    mask: Path | None = None
    """File of the mask stated by the capture for this view."""
    observed: np.ndarray | None = None
    """[M] int64, indices of the points observed in this view; None: unknown, or not needed because
    the points have colours."""

    def fits(self, width: int, height: int) -> bool:
        """True if a photo of this size (px) matches the camera's up to scale and rounding."""
        scale = width / self.camera.width
        return abs(self.camera.height * scale - height) <= 1.0 + 0.5 * scale


@dataclass(frozen=True, kw_only=True)
class Capture:
    """Content of a capture's files."""

    root: Path
    """Folder of the capture."""
    views: list[View]
    """Views in any order."""
    points: PointCloud
    """Points in world coordinates; may be empty."""
    up: np.ndarray | None = None
    """[3] float64, unit: up direction in the world; None: not stated."""
    origin: np.ndarray | None = None
    """[3] float64, local origin of views and points in the coordinates of the capture; None:
    zero."""
    error_px: float | None = None
    """Mean reprojection error of the points, pixels; None: not stated."""
    test_names: frozenset[str] = frozenset()
    """Test views stated by the capture."""
    masks_are: str = ""
    """Default meaning of masks: `ignore`, or `composite` for mattes of the subject; empty: detected
    from their content."""
    warnings: tuple[str, ...] = field(default=())
    """Messages for the user."""


def repeated(names: list[str]) -> list[str]:
    """Names that occur more than once, sorted."""
    return sorted(name for name, count in Counter(names).items() if count > 1)
