"""Axes of formats: exact half turns between them, by sign changes only."""

from dataclasses import replace

import numpy as np

from ..sh import sh_basis
from ..splats import Splats
from ..transforms import quat_to_rotmat

X, Z = 0, 2
"""Axes of rotation. A 3DGS PLY is right-down-front, as COLMAP's cameras: a half turn about x gives
right-up-back (SPZ, OpenGL, USD), one about z left-up-front (glTF)."""
_HALF = 0.5**0.5
UPRIGHT = {
    "-Y": (0.0, 0.0, 0.0, 1.0),
    "Y": (0.0, 0.0, 1.0, 0.0),
    "Z": (0.0, _HALF, _HALF, 0.0),
    "-Z": (_HALF, 0.0, 0.0, _HALF),
    "X": (0.0, 0.0, -_HALF, _HALF),
    "-X": (0.0, 0.0, _HALF, _HALF),
}
"""Quaternions, xyzw, that turn numbers in left-up-front to y up, by the up axis of the splats. Of Z
up, which is Blender's, (x, z, -y) results, as in Blender's own glTF files."""
UP = "up"
"""Key in the facts of a node of glTF or a prim of USD: up axis of the splats' world, to which its
rotation belongs."""
_DIRECTION = np.array([0.36, 0.48, 0.8])
"""A unit vector at which no basis function is zero."""


def upright_matrix(up: str) -> np.ndarray:
    """Rotation [3, 3] that turns numbers in right-up-back to y up, as glTF's: by the up axis of
    the splats; of zeros and ones, so that it is exact."""
    x, y, z, w = UPRIGHT[up]
    turn = quat_to_rotmat(np.array([w, x, y, z]))
    return np.round(turn @ np.diag([-1.0, 1.0, -1.0])) + 0.0  # no -0


def half_turn(splats: Splats, axis: int) -> Splats:
    """The model rotated by 180 degrees about an axis; twice is bit-identical to the original.

    Quaternions are conjugated by the rotation, which also rotates a splat's own axes; this has no
    effect, because a Gaussian is symmetric along each of them.
    """
    signs = np.array([1.0 if k == axis else -1.0 for k in range(3)], np.float32)
    return replace(
        splats,
        means=splats.means * signs,
        quats=splats.quats * np.concatenate([np.ones(1, np.float32), signs]),
        shN=splats.shN * harmonic_signs(splats.sh_degree, axis)[:, None],
    )


def harmonic_signs(degree: int, axis: int) -> np.ndarray:
    """[K-1] float32: sign, 1 or -1, of each SH basis function beyond degree 0 after a half turn."""
    turned = np.where(np.arange(3) == axis, _DIRECTION, -_DIRECTION)
    product = sh_basis(degree, turned)[1:] * sh_basis(degree, _DIRECTION)[1:]
    return np.sign(product).astype(np.float32)
