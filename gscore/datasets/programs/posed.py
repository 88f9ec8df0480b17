"""Posed photos: results of the readers of other programs, with COLMAP lens models."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...errors import FormatError
from ...io.colmap.lenses import MODELS_BY_NAME
from ...io.colmap.model import ColmapCamera
from ...quoting import quoted
from ...scene import FARTHEST, PointCloud
from ..poses import check_focal

Size = tuple[int, int]
"""Width and height, pixels."""
Values = Sequence[float] | np.ndarray
"""Some numbers."""


@dataclass(frozen=True, kw_only=True)
class PosedPhoto:
    """One posed photo as in the program's file."""

    name: str
    """File of the photo: a name with or without ending, or a path, perhaps on another machine."""
    viewmat: np.ndarray
    """[4, 4] float64, world to camera, OpenCV axes."""
    camera: Callable[[Size], ColmapCamera]
    """Returns the camera for the size of the photo, which some formats do not state."""
    size: Size | None = None
    """Width and height of the camera, pixels; None: not stated."""


@dataclass(frozen=True, kw_only=True)
class PosedPhotos:
    """All posed photos of a file."""

    photos: list[PosedPhoto]
    """Photos in file order."""
    points: PointCloud | None = None
    """Points in world coordinates; None: the format has none."""
    up: np.ndarray | None = None
    """[3] float64, unit: up direction in the world, if the format defines it."""
    warnings: tuple[str, ...] = field(default=())
    """Messages for the user."""


def numbers(where: str, key: str, value: object, count: int) -> np.ndarray:
    """Parse [count] float64 from a text of numbers or a list of them.

    Raises:
        FormatError: the count differs, or a number is not finite or beyond `FARTHEST`.
    """
    try:
        words = value.split() if isinstance(value, str) else value
        values = np.array(words, np.float64).reshape(-1)
    except (TypeError, ValueError, OverflowError):
        values = np.zeros(0)
    if len(values) != count or not (np.abs(values) <= FARTHEST).all():
        raise FormatError(
            f"{where}: {key} is {quoted(value)}, expected {count} numbers up to {FARTHEST:g}. "
            "Export the cameras again."
        )
    return values


def brown_camera(
    where: str,
    size: Size,
    *,
    focal: Values,
    center: Values,
    radial: Values = (),
    tilt: Values = (0.0, 0.0),
    skew: float = 0.0,
) -> ColmapCamera:
    """A lens of Brown's model, as the simplest of COLMAP's models that is exactly equal.

    Args:
        where: Location in the file, for messages.
        size: Width and height, pixels.
        focal: fx and fy, pixels.
        center: cx and cy, pixels, centres of pixels at + 0.5.
        radial: k1, k2, ... of r^2, r^4, ...
        tilt: Tangential p1 and p2 in OpenCV's order.
        skew: Skew, pixels.

    Raises:
        FormatError: it has a skew or an r^8 term, which none of COLMAP's models has, or an
            implausible focal length.
    """
    k1, k2, k3, k4 = (*radial, *(0.0,) * (4 - len(radial)))
    for name, value in (("the r^8 term (k4)", k4), ("the skew (b2)", skew)):
        if value != 0:
            raise FormatError(
                f"{where}: {name} of the lens is {value:g}, which no camera model of COLMAP has; "
                "expected 0. Export undistorted photos with their cameras in COLMAP's format, or "
                "align again without this term."
            )
    values = {"fx": focal[0], "fy": focal[1], "cx": center[0], "cy": center[1]}
    values |= {"k1": k1, "k2": k2, "k3": k3, "p1": tilt[0], "p2": tilt[1]}
    distorted = any((k1, k2, *tilt))
    model = "FULL_OPENCV" if k3 else "OPENCV" if distorted else "PINHOLE"
    return colmap_camera(where, model, size, values)


def colmap_camera(where: str, model: str, size: Size, values: dict[str, float]) -> ColmapCamera:
    """A checked camera of one of COLMAP's models; missing parameters are 0.

    Raises:
        FormatError: the size or the focal lengths are invalid.
    """
    width, height = size
    if not (0 < width < 2**31 and 0 < height < 2**31):
        raise FormatError(
            f"{where}: the size {width} x {height} must be positive, and sides below 2^31 pixels. "
            "Export the cameras again."
        )
    check_focal(where, (values["fx"], values["fy"]), width, height)
    params = [float(values.get(name, 0.0)) for name in MODELS_BY_NAME[model].params]
    return ColmapCamera(model=model, width=width, height=height, params=np.array(params))
