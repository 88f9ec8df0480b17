"""Transforms: rotations, camera axes and the training frame; no other module converts frames."""

import math
from dataclasses import dataclass, replace

import numpy as np

from .errors import ShapeError
from .scene import FARTHEST, Cameras
from .sh import sh_rotation
from .splats import Splats, check_array

CAMERA_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
"""Change between OpenCV (+y down, +z forward) and OpenGL/Blender (+y up) camera axes."""

SMALLEST = 1e-30
"""Smallest usable length, world units; its inverse is far from overflow."""
_UNEVEN = 1e-4
"""Relative deviation from a similarity that float32 object matrices may have."""
_BLOCK = 1 << 11
"""Splats per block when SH coefficients are rotated."""


def unit_quats(quats: np.ndarray) -> np.ndarray:
    """Quaternions [..., 4] of any finite non-zero length at length 1, of the same dtype.

    They are scaled by a power of two first, which is exact: squares of very large or small
    components are out of range.
    """
    exponents = np.frexp(np.abs(quats).max(axis=-1, keepdims=True, initial=0))[1]
    scaled = np.ldexp(quats, -exponents)
    return scaled / np.linalg.norm(scaled, axis=-1, keepdims=True)


@np.errstate(under="ignore")  # underflow to zero is exact enough
def quat_to_rotmat(quats: np.ndarray) -> np.ndarray:
    """Rotation matrices of quaternions of any non-zero length.

    Args:
        quats: [..., 4] float, wxyz.

    Returns:
        [..., 3, 3] of the same dtype.
    """
    w, x, y, z = np.moveaxis(unit_quats(quats), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rotmat_to_quat(rotations: np.ndarray) -> np.ndarray:
    """Unit quaternions of rotation matrices, with w >= 0.

    Each of the four formulas of Shepperd (1978) divides by another component; the largest divisor
    is used, so no rotation loses digits.

    Args:
        rotations: [..., 3, 3] float.

    Returns:
        [..., 4] of the same dtype, wxyz.
    """
    m = rotations
    m00, m11, m22 = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    wx, xy = m[..., 2, 1] - m[..., 1, 2], m[..., 1, 0] + m[..., 0, 1]
    wy, xz = m[..., 0, 2] - m[..., 2, 0], m[..., 0, 2] + m[..., 2, 0]
    wz, yz = m[..., 1, 0] - m[..., 0, 1], m[..., 2, 1] + m[..., 1, 2]
    # Row i is 4 q_i q; its norm is 4 |q_i|, so the longest row is the best conditioned one.
    rows = np.stack(
        [
            np.stack([1 + m00 + m11 + m22, wx, wy, wz], axis=-1),
            np.stack([wx, 1 + m00 - m11 - m22, xy, xz], axis=-1),
            np.stack([wy, xy, 1 - m00 + m11 - m22, yz], axis=-1),
            np.stack([wz, xz, yz, 1 - m00 - m11 + m22], axis=-1),
        ],
        axis=-2,
    )  # [..., 4, 4]
    norms = np.linalg.norm(rows, axis=-1)
    best = np.argmax(norms, axis=-1)[..., None, None]
    quats = np.take_along_axis(rows, best, axis=-2)[..., 0, :]
    quats = quats / np.linalg.norm(quats, axis=-1, keepdims=True)
    return np.where(quats[..., :1] < 0, -quats, quats)


def invert_rigid(matrix: np.ndarray) -> np.ndarray:
    """Inverse of [..., 4, 4] rigid transforms, by transposition: exact for exact rotations."""
    out = np.zeros_like(matrix)
    rotation = np.swapaxes(matrix[..., :3, :3], -1, -2)
    out[..., :3, :3] = rotation
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", rotation, matrix[..., :3, 3])
    out[..., 3, 3] = 1
    return out


def viewmat_from_opengl(world_from_camera: np.ndarray) -> np.ndarray:
    """World-to-camera in OpenCV axes from camera-to-world in OpenGL axes, rigid [..., 4, 4]."""
    return invert_rigid(world_from_camera @ CAMERA_FLIP.astype(world_from_camera.dtype))


def opengl_from_viewmat(viewmat: np.ndarray) -> np.ndarray:
    """Camera-to-world in OpenGL axes from world-to-camera in OpenCV axes, rigid [..., 4, 4]."""
    return invert_rigid(viewmat) @ CAMERA_FLIP.astype(viewmat.dtype)


@dataclass(frozen=True, kw_only=True)
class Similarity:
    """training = scale * (world - shift): recentring and scaling without rotation.

    Without rotation the inverse changes neither quaternions nor SH coefficients.
    """

    scale: float
    """Training units per world unit, > 0."""
    shift: np.ndarray
    """[3] float64, world point that becomes the training origin."""

    def __post_init__(self) -> None:
        check_array("shift", self.shift, (3,), np.float64)
        if not (math.isfinite(self.scale) and self.scale > 0 and np.isfinite(self.shift).all()):
            raise ShapeError(
                f"scale must be finite and positive, shift finite, got {self.scale}, {self.shift}."
            )

    @classmethod
    def fit(cls, centers: np.ndarray) -> "Similarity":
        """The similarity that moves camera centres [C, 3] float64 into the unit ball.

        The scale is a power of two, so multiplication and division by it are exact.

        Raises:
            ShapeError: a coordinate is not finite or beyond `FARTHEST`.
        """
        check_array("centers", centers, ("C", 3), np.float64)
        if not (np.abs(centers) <= FARTHEST).all():
            raise ShapeError(
                f"centers must be finite and within {FARTHEST:g}, got {np.abs(centers).max():g}."
            )
        if len(centers) == 0:
            return cls(scale=1.0, shift=np.zeros(3))
        shift = centers.mean(axis=0)
        radius = float(np.linalg.norm(centers - shift, axis=1).max())
        # One camera, or all in one place: no length defines a scale.
        if not radius > max(SMALLEST, 1e-12 * float(np.abs(centers).max())):
            return cls(scale=1.0, shift=shift)
        return cls(scale=2.0 ** -math.ceil(math.log2(radius)), shift=shift)

    def points_to_training(self, points: np.ndarray) -> np.ndarray:
        """World points [..., 3] in training units, float64."""
        moved = np.asarray(points, np.float64) - self.shift
        moved *= self.scale
        return moved

    def points_from_training(self, points: np.ndarray) -> np.ndarray:
        """Training points [..., 3] in world units, float64."""
        return np.asarray(points, np.float64) / self.scale + self.shift

    def viewmats_to_training(self, viewmats: np.ndarray) -> np.ndarray:
        """World-to-camera [..., 4, 4] float64 to training-to-camera; camera space is scaled too."""
        out = viewmats.copy()
        moved = viewmats[..., :3, :3] @ self.shift + viewmats[..., :3, 3]
        out[..., :3, 3] = moved * self.scale
        return out

    def viewmats_from_training(self, viewmats: np.ndarray) -> np.ndarray:
        """Undo `viewmats_to_training`."""
        out = viewmats.copy()
        out[..., :3, 3] = viewmats[..., :3, 3] / self.scale - viewmats[..., :3, :3] @ self.shift
        return out

    def cameras_to_training(self, cameras: Cameras) -> Cameras:
        """The same cameras in the training world; K does not change."""
        return replace(cameras, viewmats=self.viewmats_to_training(cameras.viewmats))

    def cameras_from_training(self, cameras: Cameras) -> Cameras:
        """Undo `cameras_to_training`."""
        return replace(cameras, viewmats=self.viewmats_from_training(cameras.viewmats))

    def splats_to_training(self, splats: Splats) -> Splats:
        """World splats in training units: means moved and scaled, log scales plus log(scale)."""
        return replace(
            splats,
            means=self.points_to_training(splats.means).astype(np.float32),
            scales=(splats.scales + np.float64(math.log(self.scale))).astype(np.float32),
        )

    def splats_from_training(self, splats: Splats) -> Splats:
        """Undo `splats_to_training`."""
        return replace(
            splats,
            means=self.points_from_training(splats.means).astype(np.float32),
            scales=(splats.scales - np.float64(math.log(self.scale))).astype(np.float32),
        )


def transform_splats(splats: Splats, matrix: np.ndarray) -> Splats:
    """Move, turn, mirror and evenly scale a model, exactly.

    A mirror image of a Gaussian is a Gaussian: with the orthogonal part Q of `matrix` (det -1), the
    rotation R of a splat becomes -Q R, and SH coefficients follow Q itself.

    Args:
        splats: Raw parameters.
        matrix: [4, 4], acts on column vectors: new = matrix @ old. Upper left: a positive factor
            times an orthogonal matrix.

    Returns:
        Raw parameters; computed in float64. Quaternions keep their length; positions beyond
        float32 are infinite.

    Raises:
        ShapeError: the matrix stretches or shears, which SH coefficients cannot represent; or it
            is singular, not finite or a projection.
    """
    matrix = np.asarray(matrix, np.float64)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ShapeError(f"matrix must be [4, 4] and finite, got {matrix.tolist()}.")
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise ShapeError(f"matrix must end in the row 0 0 0 1, got {matrix[3].tolist()}.")
    linear, shift = matrix[:3, :3], matrix[:3, 3]
    scale, orthogonal = _similarity_parts(linear)
    turn = rotmat_to_quat(orthogonal if np.linalg.det(orthogonal) > 0 else -orthogonal)
    with np.errstate(over="ignore"):
        means = (splats.means.astype(np.float64) @ linear.T + shift).astype(np.float32)
    return replace(
        splats,
        means=means,
        quats=quat_multiply(turn, splats.quats.astype(np.float64)).astype(np.float32),
        scales=(splats.scales + np.float64(math.log(scale))).astype(np.float32),
        shN=_turn_harmonics(splats.shN, orthogonal),
    )


def _similarity_parts(linear: np.ndarray) -> tuple[float, np.ndarray]:
    """Factor and orthogonal [3, 3] nearest to a [3, 3] matrix, or ShapeError."""
    u, stretches, vt = np.linalg.svd(linear)
    scale = float(np.cbrt(stretches.prod()))
    if not scale > 0:
        raise ShapeError("The matrix has a scale of 0: give the object a scale above 0.")
    if stretches[0] - stretches[2] > _UNEVEN * scale:
        raise ShapeError(
            f"The matrix stretches space unevenly, by {stretches[0]:.6g}, {stretches[1]:.6g} and "
            f"{stretches[2]:.6g} along three directions; the view-dependent colours of splats "
            f"cannot follow that exactly. Make the scale the same on all axes (of the parents "
            f"too) and remove shear."
        )
    return scale, u @ vt


def quat_multiply(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Hamilton product of quaternions [..., 4] wxyz: the rotation `right`, then `left`."""
    a, b, c, d = np.moveaxis(left, -1, 0)
    w, x, y, z = np.moveaxis(right, -1, 0)
    parts = [
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    ]
    return np.stack(parts, axis=-1)


def _turn_harmonics(rest: np.ndarray, orthogonal: np.ndarray) -> np.ndarray:
    """Coefficients [N, K-1, 3] float32 of the rotated functions."""
    out = np.empty_like(rest)
    rows, turned = (array.reshape(len(rest), 3 * rest.shape[1]) for array in (rest, out))
    degree = math.isqrt(rest.shape[1] + 1) - 1
    for band in range(1, degree + 1):
        columns = slice(3 * (band * band - 1), 3 * ((band + 1) ** 2 - 1))
        # All channels together in memory order: four times faster than channel by channel.
        turn = np.kron(sh_rotation(band, orthogonal), np.eye(3)).T
        for at in range(0, len(rest), _BLOCK):
            part = slice(at, at + _BLOCK)
            turned[part, columns] = rows[part, columns].astype(np.float64) @ turn
    return out
