"""Training frame: recentred and rescaled world of a training, with its extent and near plane."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...scene import Scene, checked_origin, distances, near_plane, within_reach
from ...transforms import SMALLEST, Similarity
from .checkpoint_schema import as_float

_MARGIN = 1.1
_DEGENERATE = 1e-3


@dataclass(frozen=True, kw_only=True)
class TrainingFrame:
    """Recentred and rescaled world in which rates and thresholds suit any capture."""

    similarity: Similarity
    """Transform from COLMAP world to the training frame."""
    extent: float
    """1.1 times the largest distance of a camera from their mean (Kerbl et al. 2023), training
    units."""
    near: float
    """Near plane, training units."""
    origin: np.ndarray | None = None
    """Local origin of the world, as `Cameras.origin`."""

    @property
    def world_near(self) -> float:
        """Near plane, world units of the capture."""
        return self.near / self.similarity.scale

    @classmethod
    def of(cls, scene: Scene, *, near: float) -> "TrainingFrame":
        """Compute the frame of a capture.

        Args:
            scene: Cameras and points in COLMAP world.
            near: Near plane, world units; lowered if it is more than a hundredth of the extent.

        Raises:
            ShapeError: a camera is farther than `FARTHEST`. Points beyond it are ignored.
        """
        centers = scene.cameras.centers
        similarity = Similarity.fit(centers)
        middle = centers.mean(axis=0)
        radius = float(np.linalg.norm(centers - middle, axis=1).max(initial=0.0))
        radius = radius if radius > SMALLEST else 0.0
        points = scene.points.points
        away = distances(points, middle)[within_reach(points)]
        if len(away):
            # With one camera, or all in one position, only the points define a scale.
            distance = float(np.median(away))
            if distance > SMALLEST and radius < _DEGENERATE * distance:
                radius = distance
                scale = 2.0 ** -math.ceil(math.log2(distance))
                similarity = Similarity(scale=scale, shift=middle)
        extent = _MARGIN * (radius or 1.0)
        return cls(
            similarity=similarity,
            extent=extent * similarity.scale,
            near=near_plane(near, extent) * similarity.scale,
            origin=scene.cameras.origin,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the frame as JSON values, from which `from_dict` restores it exactly."""
        facts = {
            "scale": self.similarity.scale,
            "shift": self.similarity.shift.tolist(),
            "extent": self.extent,
            "near": self.near,
        }
        return facts if self.origin is None else facts | {"origin": self.origin.tolist()}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> "TrainingFrame":
        """Create a frame from the values of `to_dict`; ValueError or KeyError if invalid."""
        shift = np.array(data["shift"], np.float64)
        scale, extent, near = (as_float(key, data[key]) for key in ("scale", "extent", "near"))
        if not (extent > 0 and near > 0):
            raise ValueError(f"extent and near must be positive, got {extent} and {near}")
        origin = checkpoint_origin(data) if "origin" in data else None
        similarity = Similarity(scale=scale, shift=shift)
        return cls(similarity=similarity, extent=extent, near=near, origin=origin)


def checkpoint_origin(data: dict[str, Any]) -> np.ndarray:
    """Return the local origin, [3], in the values of `TrainingFrame.to_dict`; zeros without one."""
    return checked_origin(data.get("origin", [0.0, 0.0, 0.0]))
