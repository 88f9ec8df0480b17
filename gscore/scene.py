"""Scene: cameras and points of a capture, COLMAP world, float64."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .errors import ShapeError
from .quoting import quoted
from .splats import check_array

FARTHEST = 1e30
"""Largest coordinate of a camera or point, world units: squares of larger ones may overflow
float64, and no capture has such units."""

FOCAL_RANGE = (1e-3, 1e5)
"""Plausible focal lengths as multiples of the picture's longer side: from fields of view of 179.9
degrees, the limit of a pinhole model, to those of a few arc seconds in telescopes."""


def is_focal(focal: float, width: float, height: float) -> bool:
    """Whether a focal length in pixels is plausible for this picture size; False for NaN."""
    side = max(width, height)
    return FOCAL_RANGE[0] * side <= focal <= FOCAL_RANGE[1] * side


NEAR = 0.01
"""Default near plane, world units."""


def near_plane(near: float, extent: float) -> float:
    """The near plane, at most a hundredth of the extent of the scene."""
    return min(near, 0.01 * extent)


def splat_near(means: np.ndarray) -> float:
    """Near plane for splats of unknown cameras, world units.

    The extent is the median distance of the means [N, 3] from their median.
    """
    if not len(means):
        return NEAR
    with np.errstate(over="ignore"):
        extent = float(np.median(distances(means, np.median(means, axis=0))))
    return near_plane(NEAR, extent) if extent > 0 else NEAR


_BLOCK = 1 << 16
"""Points per block of a computation, which avoids a copy of millions of points."""


def within_reach(points: np.ndarray) -> np.ndarray:
    """[P] bool: the points [P, 3] that are finite with coordinates up to `FARTHEST`."""
    good = np.empty(len(points), bool)
    for at in range(0, len(points), _BLOCK):
        part = slice(at, at + _BLOCK)
        good[part] = (np.abs(points[part]) <= FARTHEST).all(axis=1)  # NaN is not
    return good


def distances(points: np.ndarray, place: np.ndarray) -> np.ndarray:
    """[P] float64: distances of points [P, 3] from a position [3]; infinite beyond float64."""
    result = np.empty(len(points))
    with np.errstate(over="ignore"):
        for at in range(0, len(points), _BLOCK):
            part = slice(at, at + _BLOCK)
            result[part] = np.linalg.norm(points[part] - place, axis=1)
    return result


def offset_between(origin: np.ndarray | None, other: np.ndarray | None) -> np.ndarray:
    """[3] float64, `origin` minus `other`: local origins in the coordinates of a capture; None is
    the origin of these coordinates."""
    zero = np.zeros(3)
    return (zero if origin is None else origin) - (zero if other is None else other)


def moved_viewmats(viewmats: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """World to camera [..., 4, 4] float64 after subtracting `shift` [3] from the world."""
    out = viewmats.copy()
    out[..., :3, 3] += viewmats[..., :3, :3] @ shift
    return out


def checked_origin(values: object) -> np.ndarray:
    """[3] float64, the local origin stated by a file.

    Raises:
        ValueError: not three numbers up to `FARTHEST`.
    """
    origin = np.asarray(values)
    if origin.shape != (3,) or origin.dtype.kind not in "if":
        raise ValueError(f"origin, {quoted(values)}")
    if not within_reach(origin[None].astype(np.float64)).all():
        raise ValueError(f"origin, {quoted(values)}")
    return origin.astype(np.float64)


def are_relative_to(places: np.ndarray, origin: np.ndarray | None) -> bool:
    """Whether positions [P, 3] from a file without a stated origin are relative to this local one:
    their median is nearer to zero than to `origin`."""
    if origin is None or not len(places):
        return False
    middle = np.median(places.astype(np.float64), axis=0)
    return bool(np.linalg.norm(middle) < np.linalg.norm(middle - origin))


def origin_text(origin: np.ndarray) -> str:
    """A local origin for a message."""
    return "(" + ", ".join(f"{value:.15g}" for value in origin) + ")"


def camera_centers(viewmats: np.ndarray) -> np.ndarray:
    """[C, 3] camera positions in the world, from world-to-camera matrices [C, 4, 4]."""
    return -np.einsum("cji,cj->ci", viewmats[:, :3, :3], viewmats[:, :3, 3])


@dataclass(frozen=True, kw_only=True)
class Cameras:
    """C posed pinhole cameras: OpenCV axes (x right, y down, z forward), pixel centres at +0.5."""

    viewmats: np.ndarray
    """[C, 4, 4] float64, world to camera, column vectors."""
    Ks: np.ndarray
    """[C, 3, 3] float64, pixels."""
    widths: np.ndarray
    """[C] int64, pixels."""
    heights: np.ndarray
    """[C] int64, pixels."""
    names: tuple[str, ...]
    """Image names as the capture states them, sub-folders with '/'."""
    up: np.ndarray | None = None
    """[3] float64, unit: up in the world, if the capture states it; None: see `upright.up_of`."""
    origin: np.ndarray | None = None
    """[3] float64, local origin of the world in the coordinates of the capture, for captures far
    from the origin of these; None: the same origin."""

    def __post_init__(self) -> None:
        check_array("viewmats", self.viewmats, ("C", 4, 4), np.float64)
        c = len(self.viewmats)
        check_array("Ks", self.Ks, (c, 3, 3), np.float64)
        check_array("widths", self.widths, (c,), np.int64)
        check_array("heights", self.heights, (c,), np.int64)
        if self.up is not None:
            check_array("up", self.up, (3,), np.float64)
        if self.origin is not None:
            check_array("origin", self.origin, (3,), np.float64)
        if len(self.names) != c:
            raise ShapeError(f"names must have {c} entries, one per camera, got {len(self.names)}.")

    def __len__(self) -> int:
        return len(self.names)

    @property
    def centers(self) -> np.ndarray:
        """[C, 3] float64, camera positions in the world."""
        return camera_centers(self.viewmats)

    def subset(self, indices: Sequence[int]) -> "Cameras":
        """The cameras of `indices`, in this order."""
        at = list(indices)
        names = tuple(self.names[i] for i in at)
        arrays = {k: getattr(self, k)[at] for k in ("viewmats", "Ks", "widths", "heights")}
        return replace(self, names=names, **arrays)

    def of_splats(self, origin: np.ndarray | None) -> "Cameras":
        """The cameras in the world of splats with a local origin. Cameras of a file that states no
        origin already have it where `are_relative_to` is true."""
        if self.origin is None and are_relative_to(self.centers, origin):
            return replace(self, origin=origin)
        return self.about(origin)

    def about(self, origin: np.ndarray | None) -> "Cameras":
        """The same cameras relative to another local origin, [3], None as in `origin`."""
        shift = offset_between(origin, self.origin)
        if not shift.any():
            return self
        return replace(self, viewmats=moved_viewmats(self.viewmats, shift), origin=origin)


@dataclass(frozen=True, kw_only=True)
class PointCloud:
    """P points of structure from motion."""

    points: np.ndarray
    """[P, 3] float64, world units."""
    colors: np.ndarray
    """[P, 3] uint8, sRGB."""
    made_up: bool = False
    """Random positions for a capture without points, which contain no information on surfaces."""

    def __post_init__(self) -> None:
        check_array("points", self.points, ("P", 3), np.float64)
        check_array("colors", self.colors, (len(self.points), 3), np.uint8)

    def __len__(self) -> int:
        return len(self.points)

    @property
    def given(self) -> int:
        """Number of points from the capture: 0 if they are made up."""
        return 0 if self.made_up else len(self)

    def with_more(self, more: "PointCloud") -> "PointCloud":
        """Return these points followed by `more`."""
        return PointCloud(
            points=np.concatenate([self.points, more.points]),
            colors=np.concatenate([self.colors, more.colors]),
            made_up=self.made_up,
        )

    def content_hash(self) -> str:
        """Short hash of positions and colours."""
        digest = hashlib.sha256(np.ascontiguousarray(self.points).data)
        digest.update(np.ascontiguousarray(self.colors).data)
        return digest.hexdigest()[:16]

    @classmethod
    def none(cls) -> "PointCloud":
        """No points."""
        return cls(points=np.zeros((0, 3)), colors=np.zeros((0, 3), np.uint8))


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Cameras and points of a capture."""

    cameras: Cameras
    points: PointCloud
    warnings: tuple[str, ...] = field(default=())
    """Sentences for the user on repaired or skipped content."""
