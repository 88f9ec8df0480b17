"""Pose math: small camera motions as rotation vectors, and distances between poses."""

import numpy as np

from ...scene import camera_centers


def cross_matrix(vectors: np.ndarray) -> np.ndarray:
    """Return skew-symmetric matrices, [..., 3, 3], of the cross products with vectors [..., 3]."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def moved_pose(viewmat: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Apply a motion in camera axes to a pose.

    Args:
        viewmat: [..., 4, 4] float64, world to camera.
        motion: [..., 6] float64: rotation vector (Rodrigues), rad, then translation, world units.

    Returns:
        [..., 4, 4] float64: `[R | t] viewmat`.
    """
    vector = motion[..., :3]
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    cross = cross_matrix(vector)
    # sin(a) / a and (1 - cos(a)) / a^2 = (sin(a / 2) / (a / 2))^2 / 2, valid at 0 too.
    first, half = np.sinc(angle / np.pi), np.sinc(angle / (2 * np.pi))
    rotation = np.eye(3) + first * cross + 0.5 * half**2 * (cross @ cross)
    out = np.zeros(np.broadcast_shapes(viewmat.shape, (*motion.shape[:-1], 4, 4)))
    out[..., :3, :] = rotation @ viewmat[..., :3, :]
    out[..., :3, 3] += motion[..., 3:]
    out[..., 3, 3] = 1.0
    return out


def pose_distances(viewmats: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distances between poses [V, 4, 4]: angles [V], rad, and of the centres [V]."""
    turn = viewmats[:, :3, :3] @ others[:, :3, :3].transpose(0, 2, 1)
    # The sine is exact for small angles, where the cosine is not.
    skew = np.stack(
        [
            turn[:, 2, 1] - turn[:, 1, 2],
            turn[:, 0, 2] - turn[:, 2, 0],
            turn[:, 1, 0] - turn[:, 0, 1],
        ],
        axis=1,
    )
    cosine = (np.trace(turn, axis1=1, axis2=2) - 1) / 2
    angle = np.arctan2(np.linalg.norm(skew, axis=1) / 2, cosine)
    return angle, np.linalg.norm(camera_centers(viewmats) - camera_centers(others), axis=1)


def pose_gradient(viewmat: np.ndarray, v_viewmat: np.ndarray) -> np.ndarray:
    """Return the derivative [6] of a loss in the motion of `moved_pose`, at zero motion.

    Args:
        viewmat: [4, 4] float64, world to camera.
        v_viewmat: [4, 4] derivative in its entries.
    """
    turning = np.cross(viewmat[:3].T, v_viewmat[:3].T).sum(axis=0)
    return np.concatenate([turning, v_viewmat[:3, 3]])
