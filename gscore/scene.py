"""Scene: cameras and points of a capture, COLMAP world, float64."""

import hashlib
from dataclasses import dataclass, field, replace

import numpy as np

from .errors import ShapeError
from .quoting import quoted
from .splats import check_array

FARTHEST = 1e30
"""Largest coordinate of a camera or point, world units: beyond it squares leave float64 sooner or
later, and no capture is measured in such units."""

FOCAL_RANGE = (1e-3, 1e5)
"""Focal lengths as multiples of the picture's longer side that any lens may have: from views of
179.9 degrees, beyond which no pinhole camera serves, to telescopes that see a few arc seconds."""


def is_focal(focal: float, width: float, height: float) -> bool:
    """Whether a lens may have a focal length, in pixels, for such a picture; NaN is none."""
    side = max(width, height)
    return FOCAL_RANGE[0] * side <= focal <= FOCAL_RANGE[1] * side


NEAR = 0.01
"""Near plane where none is known, world units."""


def near_plane(near: float, extent: float) -> float:
    """A near plane, lowered where it is more than a hundredth of the extent of a scene."""
    return min(near, 0.01 * extent)


def splat_near(means: np.ndarray) -> float:
    """Near plane for splats of unknown cameras, world units.

    Their extent is the median distance of the means [N, 3] from the median of these.
    """
    if not len(means):
        return NEAR
    extent = float(np.median(distances(means, np.median(means, axis=0))))
    return near_plane(NEAR, extent) if extent > 0 else NEAR


_BLOCK = 1 << 16
"""Points that are computed with together: no second copy of millions of them is made."""


def within_reach(points: np.ndarray) -> np.ndarray:
    """[P] bool: which of the points [P, 3] are finite and no farther than `FARTHEST`."""
    good = np.empty(len(points), bool)
    for at in range(0, len(points), _BLOCK):
        part = slice(at, at + _BLOCK)
        good[part] = (np.abs(points[part]) <= FARTHEST).all(axis=1)  # NaN is not
    return good


def distances(points: np.ndarray, place: np.ndarray) -> np.ndarray:
    """[P] float64: how far the points [P, 3] are from a place [3]; infinite beyond float64."""
    found = np.empty(len(points))
    with np.errstate(over="ignore"):
        for at in range(0, len(points), _BLOCK):
            part = slice(at, at + _BLOCK)
            found[part] = np.linalg.norm(points[part] - place, axis=1)
    return found


def offset_between(origin: np.ndarray | None, other: np.ndarray | None) -> np.ndarray:
    """[3] float64, `origin` less `other`: local origins in the coordinates of a capture, where None
    is the origin of these themselves."""
    zero = np.zeros(3)
    return (zero if origin is None else origin) - (zero if other is None else other)


def moved_viewmats(viewmats: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """World to camera [..., 4, 4] float64 where `shift` [3] was subtracted from the world."""
    out = viewmats.copy()
    out[..., :3, 3] += viewmats[..., :3, :3] @ shift
    return out


def checked_origin(values: object) -> np.ndarray:
    """[3] float64, a local origin as a file states it.

    Raises:
        ValueError: these are no three numbers up to `FARTHEST`.
    """
    origin = np.asarray(values)
    if origin.shape != (3,) or origin.dtype.kind not in "if":
        raise ValueError(f"origin, {quoted(values)}")
    if not within_reach(origin[None].astype(np.float64)).all():
        raise ValueError(f"origin, {quoted(values)}")
    return origin.astype(np.float64)


def lie_about(places: np.ndarray, origin: np.ndarray | None) -> bool:
    """Whether places [P, 3], of which nothing is stated, are about a local origin already: half of
    them are nearer to it than to the origin of the capture's own coordinates."""
    if origin is None or not len(places):
        return False
    middle = np.median(places.astype(np.float64), axis=0)
    return bool(np.linalg.norm(middle) < np.linalg.norm(middle - origin))


def origin_words(origin: np.ndarray) -> str:
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
    """[3] float64, unit: up in the world, where the capture states it; else the cameras tell."""
    origin: np.ndarray | None = None
    """[3] float64, where the origin of the world lies in the coordinates of the capture, for
    captures that are far from their own; None: it is that."""

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
            raise ShapeError(f"names must hold {c} entries, one a camera, got {len(self.names)}.")

    def __len__(self) -> int:
        return len(self.names)

    @property
    def centers(self) -> np.ndarray:
        """[C, 3] float64, camera positions in the world."""
        return camera_centers(self.viewmats)

    def of_splats(self, origin: np.ndarray | None) -> "Cameras":
        """The cameras in the world of splats that are about a local origin. Cameras of a file that
        states none are about it where `lie_about` says so."""
        if self.origin is None and lie_about(self.centers, origin):
            return replace(self, origin=origin)
        return self.about(origin)

    def about(self, origin: np.ndarray | None) -> "Cameras":
        """The same cameras in a world about another local origin, [3], None as in `origin`."""
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
    """Places drawn at random for want of points: they tell nothing about surfaces."""

    def __post_init__(self) -> None:
        check_array("points", self.points, ("P", 3), np.float64)
        check_array("colors", self.colors, (len(self.points), 3), np.uint8)

    def __len__(self) -> int:
        return len(self.points)

    @property
    def given(self) -> int:
        """How many the capture has: none where they are made up."""
        return 0 if self.made_up else len(self)

    def with_more(self, more: "PointCloud") -> "PointCloud":
        """These and `more`."""
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
    """What structure from motion knows about a capture."""

    cameras: Cameras
    points: PointCloud
    warnings: tuple[str, ...] = field(default=())
    """Sentences for the user about what was mended or left out while reading."""
