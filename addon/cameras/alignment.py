"""Alignment of a capture: up direction, ground and size from its cameras and points; numpy only.

Structure from motion leaves the world's orientation and scale open. The result is one matrix; no
camera and no point is changed.
"""

from dataclasses import dataclass

import numpy as np

from ..core import find_up

GROUND_TILT = np.cos(np.radians(12))
"""Cosine of the largest angle between the ground's normal and the cameras' up direction."""
GROUND_TOLERANCE = 0.01
"""Half the thickness of the ground, in median diameters of the points around the cameras."""
GROUND_SHARE = 0.08
"""Smallest share of the points on a plane that is the ground."""
BELOW_SHARE = 0.1
"""Largest share of the points, and of the cameras, below the ground."""
_TRIALS, _SAMPLES, _SEED = 1200, 3000, 0


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """Transform of a capture's world to Blender's: z up, ground at z = 0."""

    matrix: np.ndarray
    """[4, 4] float64, rigid, from the capture's world."""
    up: np.ndarray
    """[3] float64, unit, in the capture's world."""
    ground_found: bool
    """True if z = 0 is a plane of points; else it is the height of the lowest points."""


def align(viewmats: np.ndarray, points: np.ndarray, up: np.ndarray | None = None) -> Alignment:
    """Z up, the ground at z = 0, the cameras' subject above the origin, the first camera faces +y.

    Args:
        viewmats: [C, 4, 4] float64, world to camera, OpenCV axes; C >= 1.
        points: [P, 3] float64, world; may be empty.
        up: [3], roughly up in the world; None: estimated from the cameras.

    Raises:
        ValueError: there is no camera, or `up` has no length.
    """
    if len(viewmats) == 0:
        raise ValueError("There are no cameras to align by.")
    up = find_up(viewmats) if up is None else _unit(np.asarray(up, np.float64))
    centers = camera_centers(viewmats)
    ground = find_ground(points, centers, up)
    if ground is not None:
        up, height = ground
    else:
        near, _ = _neighbourhood(points, centers)
        # Of the lowest points, as a low quantile; of cameras without points.
        height = float(np.quantile(near @ up, 0.02) if len(near) else (centers @ up).min())
    origin = focus(viewmats)
    origin = origin + (height - origin @ up) * up
    return Alignment(
        matrix=_upright(up, viewmats[0, 2, :3], origin), up=up, ground_found=ground is not None
    )


def find_ground(
    points: np.ndarray, centers: np.ndarray, up: np.ndarray
) -> tuple[np.ndarray, float] | None:
    """Normal [3] of the ground and its height along it; None if no plane qualifies.

    The nearly level plane with most points and few points or cameras below (RANSAC, Fischler and
    Bolles 1981, with a fixed seed), then fitted to its points.
    """
    near, size = _neighbourhood(points, centers)
    if len(near) < 50:
        return None
    rng = np.random.default_rng(_SEED)
    few = near[rng.permutation(len(near))[:_SAMPLES]]
    a, b, c = few[rng.integers(0, len(few), (3, _TRIALS))]
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals / np.maximum(lengths, 1e-300)[:, None]
    normals *= np.sign(normals @ up)[:, None]
    level = (normals @ up > GROUND_TILT) & (lengths > 1e-6 * size**2)
    best, most, tolerance = None, 0, GROUND_TOLERANCE * size
    for normal, height in zip(normals[level], (normals * a).sum(axis=1)[level], strict=True):
        count = _support(few, centers, normal, height, tolerance)
        if count > most:
            best, most = (normal, height), count
    if best is None or most < max(30, GROUND_SHARE * len(few)):
        return None
    normal, height = best
    for _ in range(3):
        own = near[np.abs(near @ normal - height) < tolerance]
        center = own.mean(axis=0)
        fitted = np.linalg.svd(own - center, full_matrices=False)[2][2]
        normal = fitted * np.sign(fitted @ normal)
        height = float(normal @ center)
    return (normal, height) if normal @ up > GROUND_TILT else None


def focus(viewmats: np.ndarray) -> np.ndarray:
    """The point [3] nearest to all optical axes, or the cameras' centre if they face away."""
    z, centers = viewmats[:, 2, :3], camera_centers(viewmats)
    across = np.eye(3) - z[:, :, None] * z[:, None, :]
    total = across.mean(axis=0)
    middle = np.median(centers, axis=0)
    if np.linalg.eigvalsh(total)[0] < 0.05:
        return middle
    point = np.linalg.solve(total, np.einsum("cij,cj->i", across, centers) / len(z))
    in_front = ((point - centers) * z).sum(axis=1) > 0
    return point if in_front.mean() > 0.7 else middle


def camera_extent(centers: np.ndarray) -> float:
    """The largest distance between two of the camera positions [C, 3], world units."""
    largest = 0.0
    for part in np.array_split(centers, max(1, len(centers) // 256)):
        distances = np.linalg.norm(part[:, None] - centers[None], axis=2)
        largest = max(largest, float(distances.max(initial=0.0)))
    return largest


def _support(
    points: np.ndarray, centers: np.ndarray, normal: np.ndarray, height: float, tolerance: float
) -> int:
    """Number of points on a plane; 0 if it cannot be the ground."""
    above = points @ normal - height
    if (above < -3 * tolerance).mean() > BELOW_SHARE:
        return 0
    if (centers @ normal < height).mean() > BELOW_SHARE:
        return 0
    return int((np.abs(above) < tolerance).sum())


def _neighbourhood(points: np.ndarray, centers: np.ndarray) -> tuple[np.ndarray, float]:
    """Points within twice the median distance from the cameras' centre, and their size."""
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) == 0:
        return points, 0.0
    distances = np.linalg.norm(points - np.median(centers, axis=0), axis=1)
    near = points[distances <= 2 * np.median(distances)]
    return near, 2 * float(np.median(np.linalg.norm(near - np.median(near, axis=0), axis=1)))


def _upright(up: np.ndarray, forward: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """[4, 4] that maps `up` to +z, `forward` above +y and `origin` to 0."""
    ahead = forward - (forward @ up) * up
    if np.linalg.norm(ahead) < 1e-3:  # vertical: any heading will do
        ahead = np.eye(3)[np.argmin(np.abs(up))]
        ahead = ahead - (ahead @ up) * up
    ahead = _unit(ahead)
    matrix = np.eye(4)
    matrix[:3, :3] = [np.cross(ahead, up), ahead, up]
    matrix[:3, 3] = -matrix[:3, :3] @ origin
    return matrix


def camera_centers(viewmats: np.ndarray) -> np.ndarray:
    """Camera positions [C, 3]."""
    return -np.einsum("cji,cj->ci", viewmats[:, :3, :3], viewmats[:, :3, 3])


def _unit(vector: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vector)
    if not (np.isfinite(length) and length > 1e-12):
        raise ValueError(f"A direction needs a length, got {vector.tolist()}.")
    return vector / length
