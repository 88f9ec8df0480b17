"""COLMAP model: a reconstruction as plain numpy arrays."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ...scene import moved_viewmats, offset_between
from ...splats import check_array
from ...transforms import quat_to_rotmat
from .lenses import MODELS_BY_NAME, PINHOLE_WITHOUT_DISTORTION


@dataclass(frozen=True, kw_only=True)
class ColmapCamera:
    """One set of intrinsics, shared by any number of images."""

    model: str
    """Name of the camera model, a key of `MODELS_BY_NAME`."""
    width: int
    """Pixels."""
    height: int
    """Pixels."""
    params: np.ndarray
    """[D] float64 in the order of the model; pixels for focal lengths and principal point."""

    def __post_init__(self) -> None:
        check_array("params", self.params, (len(MODELS_BY_NAME[self.model].params),), np.float64)

    @property
    def named_params(self) -> dict[str, float]:
        """The parameters by name."""
        names = MODELS_BY_NAME[self.model].params
        return dict(zip(names, self.params.tolist(), strict=True))

    @property
    def is_pinhole(self) -> bool:
        """True if `K` alone describes the camera: a pinhole model, or one whose distortion is 0."""
        if self.model not in PINHOLE_WITHOUT_DISTORTION:
            return False
        named = self.named_params
        return all(named[name] == 0 for name in named if name not in _INTRINSICS)

    @property
    def K(self) -> np.ndarray:  # noqa: N802  the field's name for the matrix
        """[3, 3] float64, pixels, centres of pixels at +0.5; distortion left out."""
        named = self.named_params
        fx, fy = named.get("fx", named.get("f")), named.get("fy", named.get("f"))
        return np.array([[fx, 0, named["cx"]], [0, fy, named["cy"]], [0, 0, 1]], np.float64)


_INTRINSICS = frozenset({"f", "fx", "fy", "cx", "cy"})


@dataclass(frozen=True, kw_only=True)
class ColmapImage:
    """One posed image and its observations of points."""

    id: int
    """Number in the model's files."""
    name: str
    """File name as in the model, sub-folders separated by '/'."""
    camera_id: int
    """Key of the camera."""
    qvec: np.ndarray
    """[4] float64, wxyz, rotation world to camera; of any non-zero length."""
    tvec: np.ndarray
    """[3] float64, translation world to camera, world units."""
    xys: np.ndarray
    """[M, 2] float64, observed positions, pixels of the camera's size, before undistortion."""
    point3D_ids: np.ndarray
    """[M] int64, id of the observed point; -1: none."""

    @property
    def viewmat(self) -> np.ndarray:
        """[4, 4] float64, world to camera, OpenCV axes."""
        out = np.eye(4)
        out[:3, :3] = quat_to_rotmat(self.qvec)
        out[:3, 3] = self.tvec
        return out


@dataclass(frozen=True, kw_only=True)
class ColmapPoints:
    """All points of the reconstruction."""

    ids: np.ndarray
    """[P] int64, unique."""
    xyz: np.ndarray
    """[P, 3] float64, world units."""
    rgb: np.ndarray
    """[P, 3] uint8, sRGB."""
    error: np.ndarray
    """[P] float64, mean reprojection error, pixels; -1: unknown."""
    track_lengths: np.ndarray
    """[P] int32, number of observations."""

    def __post_init__(self) -> None:
        check_array("ids", self.ids, ("P",), np.int64)
        count = len(self.ids)
        check_array("xyz", self.xyz, (count, 3), np.float64)
        check_array("rgb", self.rgb, (count, 3), np.uint8)
        check_array("error", self.error, (count,), np.float64)
        check_array("track_lengths", self.track_lengths, (count,), np.int32)

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def none(cls) -> "ColmapPoints":
        """No points at all."""
        return cls(
            ids=np.zeros(0, np.int64),
            xyz=np.zeros((0, 3)),
            rgb=np.zeros((0, 3), np.uint8),
            error=np.zeros(0),
            track_lengths=np.zeros(0, np.int32),
        )


class PointIndex:
    """Index of point rows by id; built once for all images, because it sorts the ids."""

    def __init__(self, points: ColmapPoints) -> None:
        self._order = np.argsort(points.ids, kind="stable")
        self._ids = points.ids[self._order]

    def find(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mask [M] bool of the ids [M] that are known, and the rows of those, [K] int64."""
        at = np.searchsorted(self._ids, ids)
        known = (ids != -1) & (at < len(self._ids))
        known[known] = self._ids[at[known]] == ids[known]
        return known, self._order[at[known]]


def keep_longest_tracks(
    image: ColmapImage, points: ColmapPoints, index: PointIndex, most: int
) -> ColmapImage:
    """The image with at most `most` of its observations of known points, in their order.

    Points with the longest tracks are kept, because they connect it to the most other images. Ties
    go to the earlier rows of the model, so that all images keep the same points.
    """
    known, rows = index.find(image.point3D_ids)
    at = np.flatnonzero(known)
    if len(at) > most:
        first = np.lexsort((rows, -points.track_lengths[rows]))[:most]
        at = at[np.sort(first)]
    return replace(image, xys=image.xys[at], point3D_ids=image.point3D_ids[at])


@dataclass(frozen=True, kw_only=True)
class ColmapModel:
    """Cameras, images and points of one reconstruction."""

    cameras: dict[int, ColmapCamera]
    """Cameras by id."""
    images: list[ColmapImage]
    """Images in file order."""
    points: ColmapPoints
    """Points of the model, possibly none."""
    path: Path = field(default=Path())
    """Folder the model was read from."""
    warnings: tuple[str, ...] = ()
    """Messages for the user about choices made while reading."""
    up: np.ndarray | None = None
    """[3] float64, unit: up direction in the world, if known from more than the cameras."""
    origin: np.ndarray | None = None
    """[3] float64, local origin that the coordinates are relative to, as `Cameras.origin`."""

    def about(self, origin: np.ndarray | None) -> "ColmapModel":
        """The same model, relative to another local origin."""
        shift = offset_between(origin, self.origin)
        if not shift.any():
            return self
        images = [
            replace(image, tvec=moved_viewmats(image.viewmat, shift)[:3, 3])
            for image in self.images
        ]
        points = replace(self.points, xyz=self.points.xyz - shift)
        return replace(self, images=images, points=points, origin=origin)
