"""Where lenses that bend lines put what a straight one would see; numpy alone.

Trainings undistort with pycolmap, which knows all models; this is for those who have numpy only.
"""

from collections.abc import Callable, Sequence

import numpy as np

from .camera_models import MODELS_BY_NAME

Bend = Callable[[np.ndarray, dict[str, float]], np.ndarray]
"""From rays x / z, y / z to what the lens makes of them, both [P, 2]."""


def bent_pixels(model: str, params: Sequence[float], rays: np.ndarray) -> np.ndarray:
    """Pixels of rays x / z, y / z, both [P, 2] float64.

    Args:
        model: One of `BENT`.
        params: In COLMAP's order.
        rays: Of the camera; NaN or infinity gives some number or NaN.
    """
    of = dict(zip(MODELS_BY_NAME[model].params, params, strict=True))
    focal = np.array([of.get("fx", of.get("f")), of.get("fy", of.get("f"))], np.float64)
    with np.errstate(all="ignore"):
        return _BENDS[model](rays, of) * focal + [of["cx"], of["cy"]]


def _radial(rays: np.ndarray, of: dict[str, float]) -> np.ndarray:
    """Powers of the squared radius, as a fraction where there are six, and the tilt of the lens."""
    x, y = rays.T
    r2 = x * x + y * y
    k1 = of.get("k1", of.get("k", 0.0))
    factor = 1 + r2 * (k1 + r2 * (of.get("k2", 0.0) + r2 * of.get("k3", 0.0)))
    factor /= 1 + r2 * (of.get("k4", 0.0) + r2 * (of.get("k5", 0.0) + r2 * of.get("k6", 0.0)))
    p1, p2 = of.get("p1", 0.0), of.get("p2", 0.0)
    tilt = np.stack(
        [
            2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            2 * p2 * x * y + p1 * (r2 + 2 * y * y),
        ],
        axis=1,
    )
    return rays * factor[:, None] + tilt


def _fisheye(rays: np.ndarray, of: dict[str, float]) -> np.ndarray:
    """Powers of the squared angle to the axis."""
    radius = np.hypot(*rays.T)
    angle = np.arctan(radius)
    a2 = angle * angle
    k1 = of.get("k1", of.get("k", 0.0))
    further = of.get("k2", 0.0) + a2 * (of.get("k3", 0.0) + a2 * of.get("k4", 0.0))
    bent = angle * (1 + a2 * (k1 + a2 * further))
    return rays * np.where(radius > 0, bent / radius, 1.0)[:, None]


_BENDS: dict[str, Bend] = {
    **dict.fromkeys(("SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"), _radial),
    **dict.fromkeys(("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"), _fisheye),
}
BENT = frozenset(_BENDS)
"""The models that are known here."""
