"""COLMAP camera models: ids, names and the meaning of their parameters."""

from typing import NamedTuple


class CameraModel(NamedTuple):
    """Camera model with COLMAP's id, name and order of parameters."""

    id: int
    """Number in binary files."""
    name: str
    """Name in text files."""
    params: tuple[str, ...]
    """Names of the parameters in file order; a single `f` serves both axes."""


_RADIAL = ("f", "cx", "cy")
_FULL = ("fx", "fy", "cx", "cy")

CAMERA_MODELS: tuple[CameraModel, ...] = (
    CameraModel(0, "SIMPLE_PINHOLE", _RADIAL),
    CameraModel(1, "PINHOLE", _FULL),
    CameraModel(2, "SIMPLE_RADIAL", (*_RADIAL, "k")),
    CameraModel(3, "RADIAL", (*_RADIAL, "k1", "k2")),
    CameraModel(4, "OPENCV", (*_FULL, "k1", "k2", "p1", "p2")),
    CameraModel(5, "OPENCV_FISHEYE", (*_FULL, "k1", "k2", "k3", "k4")),
    CameraModel(6, "FULL_OPENCV", (*_FULL, "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    CameraModel(7, "FOV", (*_FULL, "omega")),
    CameraModel(8, "SIMPLE_RADIAL_FISHEYE", (*_RADIAL, "k")),
    CameraModel(9, "RADIAL_FISHEYE", (*_RADIAL, "k1", "k2")),
    CameraModel(
        10, "THIN_PRISM_FISHEYE", (*_FULL, "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1")
    ),
    CameraModel(
        11,
        "RAD_TAN_THIN_PRISM_FISHEYE",
        (*_FULL, "k0", "k1", "k2", "k3", "k4", "k5", "p0", "p1", "s0", "s1", "s2", "s3"),
    ),
    CameraModel(12, "SIMPLE_DIVISION", (*_RADIAL, "k")),
    CameraModel(13, "DIVISION", (*_FULL, "k")),
    CameraModel(14, "SIMPLE_FISHEYE", _RADIAL),
    CameraModel(15, "FISHEYE", _FULL),
    CameraModel(16, "EUCM", (*_FULL, "alpha", "beta")),
    CameraModel(17, "EQUIRECTANGULAR", ("w", "h")),
)
"""Every COLMAP has 0 to 10; 11 and up were added in versions 3.12 to 4.x."""

MODELS_BY_ID = {model.id: model for model in CAMERA_MODELS}
MODELS_BY_NAME = {model.name: model for model in CAMERA_MODELS}

PINHOLE_WITHOUT_DISTORTION = frozenset(
    {"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"}
)
"""Models that are a pinhole camera if every distortion parameter is 0."""
NO_PINHOLE = frozenset({"EQUIRECTANGULAR"})
"""Camera models without focal length and principal point."""
