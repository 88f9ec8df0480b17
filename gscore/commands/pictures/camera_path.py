"""Camera paths for videos: through the cameras of a capture, or an orbit around their target."""

import math

import numpy as np

from ...errors import ConfigError
from ...quoting import quoted
from ...transforms import invert_rigid, quat_to_rotmat, rotmat_to_quat
from ...upright import find_up

_GAP = math.radians(100)
"""Arc without cameras beyond which the capture is not a full circle."""
_FACING = math.radians(45)
"""Angle to the middle beyond which a camera does not face it."""
_SWING = 0.9
"""Share of the arc with cameras that such an orbit uses; its ends appear from one side only."""
_NEARBY = math.radians(35)
"""Standard deviation of the weights of cameras that determine the orbit's distance and height."""
_CLOSE = 0.25
"""Quantile of camera distances that is the minimum distance of the orbit."""


def spline_path(viewmats: np.ndarray, Ks: np.ndarray, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """A smooth path through all cameras in their order, at constant speed.

    Positions, rotations and focal lengths are Catmull-Rom curves over the centripetal chord length
    (Yuksel et al. 2011), without cusps or overshoot between unevenly spaced cameras. Rotations
    are interpolated as quaternions of aligned signs and normalised, within a degree of the slerp
    for neighbours less than 60 degrees apart.

    Args:
        viewmats: [C, 4, 4] float64, world to camera; at least two.
        Ks: [C, 3, 3] float64, for one picture size.
        frames: Number of cameras of the path; the first and the last are the capture's.

    Returns:
        [frames, 4, 4] float64 viewmats, [frames, 3, 3] float64 Ks.

    Raises:
        ConfigError: Fewer than two cameras or frames.
    """
    _check(viewmats, frames)
    poses = invert_rigid(viewmats)
    quats = rotmat_to_quat(poses[:, :3, :3])
    for i in range(1, len(quats)):
        if quats[i] @ quats[i - 1] < 0:  # q and -q are one rotation; use the nearer one
            quats[i] = -quats[i]
    moves = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    unit = float(np.median(moves)) or 1.0
    lenses = Ks[:, [0, 1, 0, 1], [0, 1, 2, 2]]  # fx, fy, cx, cy
    keys = np.concatenate([poses[:, :3, 3] / unit, quats, lenses], axis=1)
    knots = np.concatenate([[0.0], np.cumsum(np.sqrt(_lengths(keys)) + 1e-6)])
    dense = np.interp(np.linspace(0, len(knots) - 1, 50 * len(knots)), range(len(knots)), knots)
    passed = np.concatenate([[0.0], np.cumsum(_lengths(_catmull_rom(knots, keys, dense)))])
    at = np.interp(np.linspace(0, passed[-1], frames), passed, dense)
    values = _catmull_rom(knots, keys, at)
    out = np.tile(np.eye(4), (frames, 1, 1))
    out[:, :3, :3] = quat_to_rotmat(values[:, 3:7])
    out[:, :3, 3] = values[:, :3] * unit
    path_Ks = np.tile(np.eye(3), (frames, 1, 1))
    path_Ks[:, [0, 1, 0, 1], [0, 1, 2, 2]] = values[:, 7:]
    return invert_rigid(out), path_Ks


def _lengths(keys: np.ndarray) -> np.ndarray:
    """[C-1] path length between neighbours: distance plus angle, so rotation takes time too."""
    quats = keys[:, 3:7] / np.linalg.norm(keys[:, 3:7], axis=1, keepdims=True)
    halves = np.linalg.norm(np.diff(quats, axis=0), axis=1) / 2
    turns = 4 * np.arcsin(np.minimum(halves, 1.0))  # exact for small angles, unlike arccos
    return np.linalg.norm(np.diff(keys[:, :3], axis=0), axis=1) + turns


def _catmull_rom(knots: np.ndarray, keys: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Cubic Hermite curve with the tangents of parabolas through three neighbouring keys.

    Args:
        knots: [C] increasing.
        keys: [C, D].
        at: [F] within the knots.

    Returns:
        [F, D].
    """
    steps = np.diff(knots)[:, None]  # [C-1, 1]
    slopes = np.diff(keys, axis=0) / steps  # [C-1, D]
    inner = (slopes[:-1] * steps[1:] + slopes[1:] * steps[:-1]) / (steps[1:] + steps[:-1])
    tangents = np.concatenate([slopes[:1], inner, slopes[-1:]])  # [C, D]
    left = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(knots) - 2)
    step = steps[left]  # [F, 1]
    t = (at[:, None] - knots[left][:, None]) / step
    return (
        (1 + 2 * t) * (1 - t) ** 2 * keys[left]
        + t * (1 - t) ** 2 * step * tangents[left]
        + t**2 * (3 - 2 * t) * keys[left + 1]
        + t**2 * (t - 1) * step * tangents[left + 1]
    )


def orbit_path(viewmats: np.ndarray, frames: int, *, up: np.ndarray | None = None) -> np.ndarray:
    """A closed path around the focus point, near the cameras of the capture.

    Distance and height at each angle are those of the cameras near that angle. If the capture has
    a wide arc without cameras, the path swings back and forth within the arc with cameras, because
    photos show nothing beyond it.

    Args:
        viewmats: [C, 4, 4] float64, world to camera; at least two.
        frames: Number of cameras of the path.
        up: [3], unit, up in the world if the capture states it; None: from the cameras.

    Returns:
        [frames, 4, 4] float64, world to camera. The frame after the last would be the first.

    Raises:
        ConfigError: Fewer than two cameras or frames, or cameras without a common focus.
    """
    _check(viewmats, frames)
    centers = invert_rigid(viewmats)[:, :3, 3]
    focus, up = focus_point(viewmats), find_up(viewmats) if up is None else up
    ahead = _across(up)
    side = np.cross(up, ahead)
    offsets = centers - focus
    x, y, heights = offsets @ ahead, offsets @ side, offsets @ up
    radii, angles = np.hypot(x, y), np.arctan2(y, x)
    if not np.median(radii) > 1e-9 * max(1.0, float(np.abs(centers).max())):
        raise ConfigError(
            "All cameras are at their focus point, so there is no orbit; use `--path spline`."
        )
    toward = -offsets / np.maximum(np.linalg.norm(offsets, axis=1, keepdims=True), 1e-12)
    facing = np.einsum("ci,ci->c", viewmats[:, 2, :3], toward)
    start, sweep, second_gap = _covered_arc(angles)
    if (facing < math.cos(_FACING)).mean() > 0.25 or second_gap > _GAP:
        raise ConfigError(
            "The cameras do not face a common middle, so an orbit would show parts that no photo "
            "shows; use `--path spline`."
        )
    phases = np.arange(frames) / frames * 2 * math.pi
    if 2 * math.pi - sweep > _GAP:
        swing = 0.5 - 0.5 * _SWING * np.cos(phases)
        orbit = start + sweep * swing
    else:
        orbit = angles[0] + phases
    away = np.angle(np.exp(1j * (orbit[:, None] - angles[None, :])))  # [frames, C] in (-pi, pi]
    weights = np.exp(-0.5 * (away / _NEARBY) ** 2) + 1e-12
    weights /= weights.sum(axis=1, keepdims=True)
    # Photos of details are close: an orbit that followed them would zoom in and out.
    far_enough = np.maximum(radii, np.quantile(radii, _CLOSE))
    radius, height = weights @ far_enough, weights @ heights
    eyes = (
        focus
        + (radius * np.cos(orbit))[:, None] * ahead
        + (radius * np.sin(orbit))[:, None] * side
        + height[:, None] * up
    )
    return np.stack([look_at(eye, focus, up) for eye in eyes])


def look_at(eye: np.ndarray, target: np.ndarray, up: np.ndarray) -> np.ndarray:
    """[4, 4] float64 world to camera, OpenCV axes, at `eye` with `target` in the middle."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9:
        right = _across(forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation
    viewmat[:3, 3] = -rotation @ eye
    return viewmat


def focus_point(viewmats: np.ndarray) -> np.ndarray:
    """[3] world point nearest to all optical axes in the least-squares sense.

    For parallel axes the distance is undetermined; a weak prior on a point ahead of the cameras, at
    the size of the capture, determines it.
    """
    poses = invert_rigid(viewmats)
    centers, forward = poses[:, :3, 3], poses[:, :3, 2]
    across = np.eye(3) - forward[:, :, None] * forward[:, None, :]  # [C, 3, 3] projectors
    middle = centers.mean(axis=0)
    size = float(np.linalg.norm(centers - middle, axis=1).max())
    mean_forward = forward.mean(axis=0)
    length = float(np.linalg.norm(mean_forward))
    ahead = middle + (mean_forward / length * size * min(1.0, length) if length > 1e-9 else 0.0)
    pull = 1e-3 * len(viewmats)
    matrix = across.sum(axis=0) + pull * np.eye(3)
    return np.linalg.solve(matrix, np.einsum("cij,cj->i", across, centers) + pull * ahead)


def _covered_arc(angles: np.ndarray) -> tuple[float, float, float]:
    """Start and width of the smallest arc that contains all angles, and the widest gap within."""
    ordered = np.sort(np.mod(angles, 2 * math.pi))
    gaps = np.diff(np.concatenate([ordered, ordered[:1] + 2 * math.pi]))
    widest = int(np.argmax(gaps))
    start = float(ordered[(widest + 1) % len(ordered)])
    inner = np.delete(gaps, widest)
    return start, float(2 * math.pi - gaps[widest]), float(inner.max(initial=0.0))


def _across(direction: np.ndarray) -> np.ndarray:
    """A unit vector perpendicular to `direction`."""
    other = np.eye(3)[int(np.argmin(np.abs(direction)))]
    result = np.cross(direction, other)
    return result / np.linalg.norm(result)


def _check(viewmats: np.ndarray, frames: int) -> None:
    if len(viewmats) < 2:
        raise ConfigError(f"A path needs at least two cameras, got {len(viewmats)}.")
    if frames < 2:
        raise ConfigError(
            f"A path needs at least two frames, got {quoted(frames)}; `--view N` renders a single "
            "picture."
        )
