"""Axes of formats: exact half turns between them, which only change signs."""

from dataclasses import replace

import numpy as np

from ..sh import sh_basis
from ..splats import Splats

X, Z = 0, 2
"""Axes to turn about. A 3DGS PLY is right-down-front, as COLMAP's cameras: half a turn about x
leads to right-up-back (SPZ, OpenGL, USD), half a turn about z to left-up-front (glTF)."""
_DIRECTION = np.array([0.36, 0.48, 0.8])
"""Any unit vector in which no basis function is zero."""


def half_turn(splats: Splats, axis: int) -> Splats:
    """The model turned by 180 degrees about an axis; twice is the same to the bit.

    A quaternion is conjugated by the turn, which turns a splat's own axes too: a Gaussian is the
    same along each of them in both directions.
    """
    signs = np.array([1.0 if k == axis else -1.0 for k in range(3)], np.float32)
    return replace(
        splats,
        means=splats.means * signs,
        quats=splats.quats * np.concatenate([np.ones(1, np.float32), signs]),
        shN=splats.shN * harmonic_signs(splats.sh_degree, axis)[:, None],
    )


def harmonic_signs(degree: int, axis: int) -> np.ndarray:
    """[K-1] float32: 1 or -1 for each basis function beyond the constant one."""
    turned = np.where(np.arange(3) == axis, _DIRECTION, -_DIRECTION)
    product = sh_basis(degree, turned)[1:] * sh_basis(degree, _DIRECTION)[1:]
    return np.sign(product).astype(np.float32)
