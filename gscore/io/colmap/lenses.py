"""Lens models of COLMAP: distortion and undistortion of pixels; numpy alone."""

from collections.abc import Callable, Sequence

import numpy as np

from .camera_models import MODELS_BY_NAME

Bend = Callable[[np.ndarray, dict[str, float]], np.ndarray]
"""From rays x / z, y / z to what the lens makes of them, both [P, 2]."""
_TURNS, _STEP = 100, 1e-6
"""Most turns of Newton's method, and how far apart its differences are taken."""
_ACROSS, _DOWN = np.array([_STEP, 0.0]), np.array([0.0, _STEP])
_SOLVED = 1e-10
"""Distance from what is looked for at which it is found, focal lengths."""
_WIDEST = np.pi / 2 - 1e-6
"""Angle to the axis up to which a ray has an x / z, radians."""


def bent_pixels(model: str, params: Sequence[float], rays: np.ndarray) -> np.ndarray:
    """Pixels of rays x / z, y / z, both [P, 2] float64.

    Args:
        model: One of `BENT`.
        params: In COLMAP's order.
        rays: Of the camera; NaN or infinity gives some number or NaN.
    """
    of = _named(model, params)
    with np.errstate(all="ignore"):
        return _BENDS[model](rays, of) * _focal(of) + [of["cx"], of["cy"]]


def straight_rays(model: str, params: Sequence[float], pixels: np.ndarray) -> np.ndarray:
    """The way back: rays x / z, y / z of pixels, both [P, 2] float64.

    By Newton's method from what a lens without a bend would see there.

    Args:
        model: One of `BENT`.
        params: In COLMAP's order.
        pixels: Of the camera, centres at + 0.5.

    Returns:
        NaN where no ray is found: beyond what the formula reaches, or at a right angle to the axis
        and more.
    """
    of = _named(model, params)
    with np.errstate(all="ignore"):
        wanted = (pixels - [of["cx"], of["cy"]]) / _focal(of)
        if _BENDS[model] is _division:
            return wanted / (1 + of["k"] * (wanted * wanted).sum(axis=1))[:, None]
        # Rays far from the axis of a wide lens are nearly even in their angles, not in x / z.
        ray = _tangents if _BENDS[model] is not _radial else _same
        return ray(_solve(lambda at: _BENDS[model](ray(at), of), wanted))


def _named(model: str, params: Sequence[float]) -> dict[str, float]:
    return dict(zip(MODELS_BY_NAME[model].params, map(float, params), strict=True))


def _focal(of: dict[str, float]) -> np.ndarray:
    return np.array([of.get("fx", of.get("f")), of.get("fy", of.get("f"))], np.float64)


def _solve(bend: Callable[[np.ndarray], np.ndarray], wanted: np.ndarray) -> np.ndarray:
    """Places [P, 2] that `bend` takes to `wanted` [P, 2], looked for from there; NaN: none."""
    found, at = np.full(wanted.shape, np.nan), np.array(wanted, np.float64)
    left = np.arange(len(at))
    for _ in range(_TURNS):
        here = bend(at)
        off = here - wanted[left]
        a, c = ((bend(at + _ACROSS) - here) / _STEP).T
        b, d = ((bend(at + _DOWN) - here) / _STEP).T
        area = a * d - b * c
        done = np.hypot(*off.T) < _SOLVED
        # Beyond a fold the formula is mirrored, or it has gone through the axis.
        good = done & (area > 0) & ((at * wanted[left]).sum(axis=1) >= 0)
        found[left[good]] = at[good]
        x, y = off.T
        at = at - np.stack([d * x - b * y, a * y - c * x], axis=1) / area[:, None]
        going = ~done & np.isfinite(at).all(axis=1)
        if not going.any():
            break
        left, at = left[going], at[going]
    return found


def _same(rays: np.ndarray) -> np.ndarray:
    return rays


def _tangents(angles: np.ndarray) -> np.ndarray:
    """Rays of angles to the axis, both [P, 2] in directions from it; NaN beyond `_WIDEST`."""
    angle = np.hypot(*angles.T)
    tangent = np.where(angle < _WIDEST, np.tan(angle), np.nan)
    return angles * np.where(angle > 0, tangent / angle, 1.0)[:, None]


def _angles(rays: np.ndarray) -> np.ndarray:
    """The inverse of `_tangents`."""
    radius = np.hypot(*rays.T)
    return rays * np.where(radius > 0, np.arctan(radius) / radius, 1.0)[:, None]


def _radial(rays: np.ndarray, of: dict[str, float]) -> np.ndarray:
    """Powers of the squared radius, as a fraction where there are six, and the tilt of the lens."""
    x, y = rays.T
    r2 = x * x + y * y
    k1 = of.get("k1", of.get("k", 0.0))
    factor = 1 + r2 * (k1 + r2 * (of.get("k2", 0.0) + r2 * of.get("k3", 0.0)))
    factor /= 1 + r2 * (of.get("k4", 0.0) + r2 * (of.get("k5", 0.0) + r2 * of.get("k6", 0.0)))
    return rays * factor[:, None] + _tilt(rays, of.get("p1", 0.0), of.get("p2", 0.0))


def _tilt(rays: np.ndarray, p1: float, p2: float) -> np.ndarray:
    """What a lens that stands askew adds."""
    x, y = rays.T
    r2 = x * x + y * y
    across = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    return np.stack([across, 2 * p2 * x * y + p1 * (r2 + 2 * y * y)], axis=1)


def _fisheye(rays: np.ndarray, of: dict[str, float]) -> np.ndarray:
    """Powers of the squared angle to the axis; a thin prism and the tilt of the lens."""
    angles = _angles(rays)
    a2 = (angles * angles).sum(axis=1)
    k1 = of.get("k1", of.get("k", 0.0))
    further = of.get("k2", 0.0) + a2 * (of.get("k3", 0.0) + a2 * of.get("k4", 0.0))
    bent = angles * (1 + a2 * (k1 + a2 * further))[:, None]
    if "sx1" in of:
        prism = a2[:, None] * [of["sx1"], of["sy1"]]
        bent += _tilt(angles, of["p1"], of["p2"]) + prism
    return bent


def _fisheye_of_six(rays: np.ndarray, of: dict[str, float]) -> np.ndarray:
    """Six powers of the squared angle; tilt and prism of what these make of it."""
    angles = _angles(rays)
    a2 = (angles * angles).sum(axis=1)
    factor = np.ones_like(a2)
    for n in range(6):
        factor += of[f"k{n}"] * a2 ** (n + 1)
    bent = angles * factor[:, None]
    b2 = (bent * bent).sum(axis=1)[:, None]
    prism = b2 * [of["s0"], of["s2"]] + b2 * b2 * [of["s1"], of["s3"]]
    return bent + _tilt(bent, of["p1"], of["p0"]) + prism


def _field_of_view(rays: np.ndarray, of: dict[str, float]) -> np.ndarray:
    """A lens whose picture is even in the angle `omega` that it sees."""
    omega = of["omega"]
    if omega == 0:
        return rays
    radius, slope = np.hypot(*rays.T), 2 * np.tan(omega / 2)
    return rays * np.where(radius > 0, np.arctan(radius * slope) / radius, slope)[:, None] / omega


def _division(rays: np.ndarray, of: dict[str, float]) -> np.ndarray:
    """The inverse of a ray d / (1 + k d^2)."""
    r2 = (rays * rays).sum(axis=1)
    return rays * (2 / (1 + np.sqrt(1 - 4 * of["k"] * r2)))[:, None]


def _unified(rays: np.ndarray, of: dict[str, float]) -> np.ndarray:
    """Rays cut with an ellipsoid, seen from between its centre and its pole."""
    r2 = (rays * rays).sum(axis=1)
    depth = of["alpha"] * np.sqrt(of["beta"] * r2 + 1) + (1 - of["alpha"])
    return rays / depth[:, None]


_FISHEYES = (
    *("SIMPLE_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"),
    *("OPENCV_FISHEYE", "THIN_PRISM_FISHEYE"),
)
_BENDS: dict[str, Bend] = {
    **dict.fromkeys(("SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"), _radial),
    **dict.fromkeys(_FISHEYES, _fisheye),
    "RAD_TAN_THIN_PRISM_FISHEYE": _fisheye_of_six,
    "FOV": _field_of_view,
    **dict.fromkeys(("SIMPLE_DIVISION", "DIVISION"), _division),
    "EUCM": _unified,
}
BENT = frozenset(_BENDS)
"""All models that bend lines and have a focal length."""
