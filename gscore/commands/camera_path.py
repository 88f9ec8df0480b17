"""Camera paths for videos: through the cameras of a capture, or around what they look at."""

import math

import numpy as np

from ..errors import ConfigError
from ..transforms import invert_rigid, quat_to_rotmat, rotmat_to_quat

_GAP = math.radians(100)
"""An arc this wide without cameras means that the capture did not go all the way round."""


def spline_path(viewmats: np.ndarray, Ks: np.ndarray, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """A smooth path through every camera, in their order, at a steady pace.

    Positions, rotations and focal lengths are Catmull-Rom curves over the centripetal chord length
    (Yuksel et al. 2011), which neither cusps nor overshoots where cameras lie unevenly. Rotations
    are interpolated as quaternions of aligned signs and normalised, which follows the slerp to
    within a degree for neighbours less than 60 degrees apart.

    Args:
        viewmats: [C, 4, 4] float64, world to camera; at least two.
        Ks: [C, 3, 3] float64, of one picture size.
        frames: Number of cameras to make; the first and the last are the capture's.

    Returns:
        [frames, 4, 4] float64 viewmats, [frames, 3, 3] float64 Ks.

    Raises:
        ConfigError: Fewer than two cameras or frames.
    """
    _check(viewmats, frames)
    poses = invert_rigid(viewmats)
    quats = rotmat_to_quat(poses[:, :3, :3])
    for i in range(1, len(quats)):
        if quats[i] @ quats[i - 1] < 0:  # q and -q are one rotation; take the near one
            quats[i] = -quats[i]
    moves = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    unit = float(np.median(moves)) or 1.0
    keys = np.concatenate([poses[:, :3, 3] / unit, quats, Ks.reshape(-1, 9)], axis=1)
    knots = np.concatenate([[0.0], np.cumsum(np.sqrt(_lengths(keys)) + 1e-6)])
    dense = np.interp(np.linspace(0, len(knots) - 1, 50 * len(knots)), range(len(knots)), knots)
    passed = np.concatenate([[0.0], np.cumsum(_lengths(_catmull_rom(knots, keys, dense)))])
    at = np.interp(np.linspace(0, passed[-1], frames), passed, dense)
    values = _catmull_rom(knots, keys, at)
    out = np.tile(np.eye(4), (frames, 1, 1))
    out[:, :3, :3] = quat_to_rotmat(values[:, 3:7])
    out[:, :3, 3] = values[:, :3] * unit
    return invert_rigid(out), values[:, 7:].reshape(frames, 3, 3)


def _lengths(keys: np.ndarray) -> np.ndarray:
    """[C-1] way between neighbours: distance plus angle, so that turning takes its time too."""
    quats = keys[:, 3:7] / np.linalg.norm(keys[:, 3:7], axis=1, keepdims=True)
    halves = np.linalg.norm(np.diff(quats, axis=0), axis=1) / 2
    turns = 4 * np.arcsin(np.minimum(halves, 1.0))  # exact for small angles, unlike arccos
    return np.linalg.norm(np.diff(keys[:, :3], axis=0), axis=1) + turns


def _catmull_rom(knots: np.ndarray, keys: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Cubic Hermite curve with the tangents of parabolas through three neighbouring keys.

    Args:
        knots: [C] rising.
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


def orbit_path(viewmats: np.ndarray, frames: int) -> np.ndarray:
    """A closed path around what the cameras look at, at their mean distance and height.

    Where the capture leaves a wide arc without cameras, the path swings to and fro within the arc
    that has them, because behind it there is nothing to see.

    Args:
        viewmats: [C, 4, 4] float64, world to camera; at least two.
        frames: Number of cameras to make.

    Returns:
        [frames, 4, 4] float64, world to camera. The frame after the last would be the first.

    Raises:
        ConfigError: Fewer than two cameras or frames.
    """
    _check(viewmats, frames)
    centers = invert_rigid(viewmats)[:, :3, 3]
    focus, up = focus_point(viewmats), up_direction(viewmats)
    offsets = centers - focus
    heights = offsets @ up
    flat = offsets - heights[:, None] * up
    radius = float(np.median(np.linalg.norm(flat, axis=1)))
    if radius < 1e-9:
        raise ConfigError(
            "The cameras stand where they look; an orbit is not possible, use spline."
        )
    ahead = flat[0] / max(float(np.linalg.norm(flat[0])), 1e-12)
    if float(np.linalg.norm(flat[0])) < 1e-9:
        ahead = _across(up)
    side = np.cross(up, ahead)
    angles = np.arctan2(flat @ side, flat @ ahead)
    phases = np.arange(frames) / frames * 2 * math.pi
    start, sweep = _covered_arc(angles)
    is_open = 2 * math.pi - sweep > _GAP
    wanted = start + sweep / 2 * (1 - np.cos(phases)) if is_open else phases
    eyes = (
        focus
        + radius * (np.cos(wanted)[:, None] * ahead + np.sin(wanted)[:, None] * side)
        + float(np.median(heights)) * up
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
    """[3] world point nearest to all optical axes, in the least-squares sense.

    Parallel axes leave the distance open; a weak pull to a point ahead of the cameras, at the size
    of the capture, decides it.
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


def up_direction(viewmats: np.ndarray) -> np.ndarray:
    """[3] unit world direction that is up: across the cameras' horizontals, near their verticals.

    People hold cameras level, so the x axes of all cameras are horizontal while they look down or
    up; where the x axes alone do not decide it, the mean of the vertical axes does.
    """
    right, down = viewmats[:, 0, :3], viewmats[:, 1, :3]
    mean_up = -down.mean(axis=0)
    length = np.linalg.norm(mean_up)
    if length < 1e-9:
        return -down[0]
    mean_up = mean_up / length
    spread = np.einsum("ci,cj->ij", right, right) / len(right)
    _, vectors = np.linalg.eigh(spread - 0.05 * np.outer(mean_up, mean_up))
    up = vectors[:, 0]  # of the smallest eigenvalue
    return up if up @ mean_up > 0 else -up


def _covered_arc(angles: np.ndarray) -> tuple[float, float]:
    """Start and width of the smallest arc that holds all angles, radians."""
    ordered = np.sort(np.mod(angles, 2 * math.pi))
    gaps = np.diff(np.concatenate([ordered, ordered[:1] + 2 * math.pi]))
    widest = int(np.argmax(gaps))
    start = ordered[(widest + 1) % len(ordered)]
    return float(start), float(2 * math.pi - gaps[widest])


def _across(direction: np.ndarray) -> np.ndarray:
    """Some unit vector at right angles to `direction`."""
    other = np.eye(3)[int(np.argmin(np.abs(direction)))]
    result = np.cross(direction, other)
    return result / np.linalg.norm(result)


def _check(viewmats: np.ndarray, frames: int) -> None:
    if len(viewmats) < 2:
        raise ConfigError(f"A path needs at least two cameras, got {len(viewmats)}.")
    if frames < 2:
        raise ConfigError(f"A path needs at least two frames, got {frames}.")
