"""Rule of depth supervision: whether a capture needs it, with the reason for the user."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...config import Switch
from ...scene import Scene
from ...text_format import count_text, number

DENSE_VIEWS = 30
"""Median number of training views of a point from which photos alone determine the geometry."""
DENSE_POINTS = 100
"""Median number of points in a view below which SfM is too sparse, for any number of views."""
_SAMPLE = 5000
"""Most points that are evaluated, a random sample."""


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """Coverage of the SfM points by the training views; ignores occlusion."""

    views: int
    """Training views."""
    views_of_point: float
    """Median number of training views that have a point in their frame."""
    points_in_view: float
    """Median number of points in the frame of a training view."""

    @property
    def is_dense(self) -> bool:
        """True if depth maps are unlikely to improve the result."""
        return self.views_of_point >= DENSE_VIEWS and self.points_in_view >= DENSE_POINTS

    def __str__(self) -> str:
        return (
            f"{count_text(self.views, 'training view')}, {self.views_of_point:.0f} of them on a "
            f"median point, {number(round(self.points_in_view))} points in a median view"
        )


def coverage(scene: Scene, train: Sequence[int]) -> Coverage:
    """Count the points in the frame of each training view, and the views of each point."""
    points = scene.points.points[np.isfinite(scene.points.points).all(axis=1)]
    share = min(1.0, _SAMPLE / max(len(points), 1))
    if share < 1:
        chosen = np.random.default_rng(0).choice(len(points), _SAMPLE, replace=False)
        points = points[chosen]
    cameras, inside = scene.cameras, np.zeros((len(train), len(points)), bool)
    for row, i in enumerate(train):
        x, y, z = cameras.viewmats[i, :3, :3] @ points.T + cameras.viewmats[i, :3, 3:]
        front = z > 0
        z = np.where(front, z, 1.0)
        K = cameras.Ks[i]
        u, v = K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]
        width, height = cameras.widths[i], cameras.heights[i]
        inside[row] = front & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    return Coverage(
        views=len(train),
        views_of_point=float(np.median(inside.sum(axis=0))) if len(points) else 0.0,
        points_in_view=float(np.median(inside.sum(axis=1)) / share) if len(train) else 0.0,
    )


def decide(mode: Switch, facts: Coverage, *, usable: int) -> tuple[bool, str]:
    """Decide whether to supervise depth, with the reason as a sentence.

    Args:
        mode: The option `depth_mode`.
        facts: Coverage of the capture.
        usable: Number of training views with a depth map that the loss can use.
    """
    if usable == 0:
        return False, "No training view has a usable depth map, so depth is not used."
    if mode is Switch.OFF:
        return False, "Depth maps are read for the report only (depth_mode off)."
    if mode is Switch.AUTO and facts.is_dense:
        return False, (
            f"The capture is dense ({facts}), so the photos determine the geometry and depth is "
            f"not used; `--depth-mode on` uses it anyway."
        )
    return True, f"Depth supervises {count_text(usable, 'training view')} ({facts})."
