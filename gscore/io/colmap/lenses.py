"""Lens models of COLMAP: distortion and undistortion of pixels; numpy only."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np


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


Distortion = Callable[[np.ndarray, dict[str, float]], np.ndarray]
"""Maps rays x / z, y / z to distorted ones, both [P, 2]."""
_MAX_ITERATIONS, _STEP = 100, 1e-6
"""Most iterations of Newton's method, and the step of its finite differences."""
_STEP_X, _STEP_Y = np.array([_STEP, 0.0]), np.array([0.0, _STEP])
_TOLERANCE = 1e-10
"""Largest residual of a solution, focal lengths."""
_WIDEST = np.pi / 2 - 1e-6
"""Largest angle to the axis at which a ray has an x / z, radians."""


def distorted_pixels(model: str, params: Sequence[float], rays: np.ndarray) -> np.ndarray:
    """Distorted pixels of rays x / z, y / z, both [P, 2] float64.

    Args:
        model: One of `DISTORTED_MODELS`.
        params: Parameters in COLMAP's order.
        rays: Rays in the camera's frame; NaN or infinity gives some number or NaN.
    """
    of = _named(model, params)
    with np.errstate(all="ignore"):
        return _DISTORTIONS[model](rays, of) * _focal(of) + [of["cx"], of["cy"]]


def undistorted_rays(model: str, params: Sequence[float], pixels: np.ndarray) -> np.ndarray:
    """Undistorted rays x / z, y / z of pixels, both [P, 2] float64: inverse of `distorted_pixels`.

    Solved by Newton's method, starting at the ray of a lens without distortion.

    Args:
        model: One of `DISTORTED_MODELS`.
        params: Parameters in COLMAP's order.
        pixels: Pixels of the camera, centres at + 0.5.

    Returns:
        Rays; NaN if none was found, because the pixel is outside the range of the formula or its
        ray is at a right angle to the axis or more.
    """
    of = _named(model, params)
    with np.errstate(all="ignore"):
        target = (pixels - [of["cx"], of["cy"]]) / _focal(of)
        if _DISTORTIONS[model] is _division:
            return target / (1 + of["k"] * (target * target).sum(axis=1))[:, None]
        # Far from the axis of a wide lens, the formula is nearly linear in angles, not in x / z.
        ray = _tangents if _DISTORTIONS[model] is not _radial else np.asarray
        return ray(_solve(lambda at: _DISTORTIONS[model](ray(at), of), target))


def _named(model: str, params: Sequence[float]) -> dict[str, float]:
    return dict(zip(MODELS_BY_NAME[model].params, map(float, params), strict=True))


def _focal(of: dict[str, float]) -> np.ndarray:
    return np.array([of.get("fx", of.get("f")), of.get("fy", of.get("f"))], np.float64)


def _solve(distort: Callable[[np.ndarray], np.ndarray], target: np.ndarray) -> np.ndarray:
    """Points [P, 2] that `distort` maps to `target` [P, 2], starting there; NaN: none found."""
    solution, at = np.full(target.shape, np.nan), np.array(target, np.float64)
    left = np.arange(len(at))
    for _ in range(_MAX_ITERATIONS):
        here = distort(at)
        residual = here - target[left]
        a, c = ((distort(at + _STEP_X) - here) / _STEP).T
        b, d = ((distort(at + _STEP_Y) - here) / _STEP).T
        det = a * d - b * c
        done = np.hypot(*residual.T) < _TOLERANCE
        # Past a fold of the formula the image is mirrored, or the point has crossed the axis.
        good = done & (det > 0) & ((at * target[left]).sum(axis=1) >= 0)
        solution[left[good]] = at[good]
        x, y = residual.T
        at = at - np.stack([d * x - b * y, a * y - c * x], axis=1) / det[:, None]
        going = ~done & np.isfinite(at).all(axis=1)
        if not going.any():
            break
        left, at = left[going], at[going]
    return solution


def _tangents(angles: np.ndarray) -> np.ndarray:
    """Rays x / z, y / z of angles to the axis along x and y, both [P, 2]; NaN beyond `_WIDEST`."""
    angle = np.hypot(*angles.T)
    tangent = np.where(angle < _WIDEST, np.tan(angle), np.nan)
    return angles * np.where(angle > 0, tangent / angle, 1.0)[:, None]


def _angles(rays: np.ndarray) -> np.ndarray:
    """Inverse of `_tangents`."""
    radius = np.hypot(*rays.T)
    return rays * np.where(radius > 0, np.arctan(radius) / radius, 1.0)[:, None]


def _radial(rays: np.ndarray, of: dict[str, float]) -> np.ndarray:
    """Polynomial in the squared radius, rational for six coefficients, plus tangential
    distortion."""
    x, y = rays.T
    r2 = x * x + y * y
    k1 = of.get("k1", of.get("k", 0.0))
    factor = 1 + r2 * (k1 + r2 * (of.get("k2", 0.0) + r2 * of.get("k3", 0.0)))
    factor /= 1 + r2 * (of.get("k4", 0.0) + r2 * (of.get("k5", 0.0) + r2 * of.get("k6", 0.0)))
    return rays * factor[:, None] + _tilt(rays, of.get("p1", 0.0), of.get("p2", 0.0))


def _tilt(rays: np.ndarray, p1: float, p2: float) -> np.ndarray:
    """Tangential distortion, of a tilted lens."""
    x, y = rays.T
    r2 = x * x + y * y
    across = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    return np.stack([across, 2 * p2 * x * y + p1 * (r2 + 2 * y * y)], axis=1)


def _fisheye(rays: np.ndarray, of: dict[str, float]) -> np.ndarray:
    """Polynomial in the squared angle to the axis; thin prism and tangential distortion."""
    angles = _angles(rays)
    a2 = (angles * angles).sum(axis=1)
    k1 = of.get("k1", of.get("k", 0.0))
    higher = of.get("k2", 0.0) + a2 * (of.get("k3", 0.0) + a2 * of.get("k4", 0.0))
    distorted = angles * (1 + a2 * (k1 + a2 * higher))[:, None]
    if "sx1" in of:
        prism = a2[:, None] * [of["sx1"], of["sy1"]]
        distorted += _tilt(angles, of["p1"], of["p2"]) + prism
    return distorted


def _fisheye_of_six(rays: np.ndarray, of: dict[str, float]) -> np.ndarray:
    """Six powers of the squared angle, then tangential distortion and thin prism of the result."""
    angles = _angles(rays)
    a2 = (angles * angles).sum(axis=1)
    factor = np.ones_like(a2)
    for n in range(6):
        factor += of[f"k{n}"] * a2 ** (n + 1)
    radial = angles * factor[:, None]
    r2 = (radial * radial).sum(axis=1)[:, None]
    prism = r2 * [of["s0"], of["s2"]] + r2 * r2 * [of["s1"], of["s3"]]
    return radial + _tilt(radial, of["p1"], of["p0"]) + prism


def _field_of_view(rays: np.ndarray, of: dict[str, float]) -> np.ndarray:
    """FOV model (Devernay and Faugeras 2001): image radius proportional to the angle; `omega` is
    the field of view, radians."""
    omega = of["omega"]
    if omega == 0:
        return rays
    radius, slope = np.hypot(*rays.T), 2 * np.tan(omega / 2)
    return rays * np.where(radius > 0, np.arctan(radius * slope) / radius, slope)[:, None] / omega


def _division(rays: np.ndarray, of: dict[str, float]) -> np.ndarray:
    """Inverse of the ray d / (1 + k d^2)."""
    r2 = (rays * rays).sum(axis=1)
    return rays * (2 / (1 + np.sqrt(1 - 4 * of["k"] * r2)))[:, None]


def _unified(rays: np.ndarray, of: dict[str, float]) -> np.ndarray:
    """Extended unified camera model: rays projected to an ellipsoid, then from a point on its
    axis."""
    r2 = (rays * rays).sum(axis=1)
    depth = of["alpha"] * np.sqrt(of["beta"] * r2 + 1) + (1 - of["alpha"])
    return rays / depth[:, None]


_FISHEYES = (
    *("SIMPLE_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"),
    *("OPENCV_FISHEYE", "THIN_PRISM_FISHEYE"),
)
_DISTORTIONS: dict[str, Distortion] = {
    **dict.fromkeys(("SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"), _radial),
    **dict.fromkeys(_FISHEYES, _fisheye),
    "RAD_TAN_THIN_PRISM_FISHEYE": _fisheye_of_six,
    "FOV": _field_of_view,
    **dict.fromkeys(("SIMPLE_DIVISION", "DIVISION"), _division),
    "EUCM": _unified,
}
DISTORTED_MODELS = frozenset(_DISTORTIONS)
"""Models with lens distortion and a focal length."""
