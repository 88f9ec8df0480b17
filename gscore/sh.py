"""Real spherical harmonics with the signs of 3D Gaussian Splatting, and colour to coefficient."""

import numpy as np

from .errors import ShapeError
from .shared_constants import SH_C0, SH_C1, SH_C2, SH_C3, SH_C4

MAX_DEGREE = 4
"""Highest degree of stored splats. Trainers of the 3DGS family write at most 3."""


def sh_count(degree: int) -> int:
    """Number of basis functions up to and including `degree`."""
    return (degree + 1) ** 2


def sh_basis(degree: int, dirs: np.ndarray) -> np.ndarray:
    """Values of the basis functions in given directions.

    Source: the real spherical harmonics with the Condon-Shortley sign kept (Sloan, "Efficient
    Spherical Harmonic Evaluation", JCGT 2013), ordered l = 0..degree, m = -l..l as in 3DGS files.

    Args:
        degree: 0 to 4.
        dirs: [..., 3] float32 or float64 unit vectors from the camera to the splat.

    Returns:
        [..., (degree + 1)²] of the dtype of `dirs`.

    Raises:
        ShapeError: degree out of range or `dirs` not [..., 3] of floats.
    """
    if degree not in range(MAX_DEGREE + 1):
        raise ShapeError(f"degree must be 0 to {MAX_DEGREE}, got {degree!r}.")
    if dirs.ndim < 1 or dirs.shape[-1] != 3 or dirs.dtype.kind != "f":
        raise ShapeError(f"dirs must be [..., 3] of floats, got {list(dirs.shape)} {dirs.dtype}.")
    x, y, z = dirs[..., 0], dirs[..., 1], dirs[..., 2]
    out = [np.full_like(x, SH_C0)]
    if degree >= 1:
        out += [-SH_C1 * y, SH_C1 * z, -SH_C1 * x]
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        out += [
            SH_C2[0] * x * y,
            SH_C2[1] * y * z,
            SH_C2[2] * (2.0 * zz - xx - yy),
            SH_C2[3] * x * z,
            SH_C2[4] * (xx - yy),
        ]
        if degree >= 3:
            out += [
                SH_C3[0] * y * (3.0 * xx - yy),
                SH_C3[1] * x * y * z,
                SH_C3[2] * y * (4.0 * zz - xx - yy),
                SH_C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
                SH_C3[4] * x * (4.0 * zz - xx - yy),
                SH_C3[5] * z * (xx - yy),
                SH_C3[6] * x * (xx - 3.0 * yy),
            ]
        if degree >= 4:
            out += _fourth_band(x, y, z)
    return np.stack(out, axis=-1)


def _fourth_band(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> list[np.ndarray]:
    """The nine functions of degree 4."""
    xx, yy, zz = x * x, y * y, z * z
    rr, odd = xx + yy, 4.0 * zz - 3.0 * (xx + yy)
    return [
        SH_C4[0] * x * y * (xx - yy),
        SH_C4[1] * y * z * (3.0 * xx - yy),
        SH_C4[2] * x * y * (6.0 * zz - rr),
        SH_C4[3] * y * z * odd,
        SH_C4[4] * (8.0 * zz * (zz - 3.0 * rr) + 3.0 * rr * rr),
        SH_C4[5] * x * z * odd,
        SH_C4[6] * (xx - yy) * (6.0 * zz - rr),
        SH_C4[7] * x * z * (xx - 3.0 * yy),
        SH_C4[8] * (xx * (xx - 6.0 * yy) + yy * yy),
    ]


def sh_rotation(degree: int, rotation: np.ndarray) -> np.ndarray:
    """Matrix that rotates the coefficients of one band with the world.

    With f(d) = sum of c_i Y_i(d), the rotated function is g(d) = f(rotation^T d); its coefficients
    are `sh_rotation(degree, rotation) @ c`. The integral of Y_i(d) Y_j(rotation^T d) over the
    sphere is computed by a quadrature that is exact for these polynomials.

    Args:
        degree: The band, 0 to 4.
        rotation: [3, 3] float64, orthogonal; reflections are allowed.

    Returns:
        [2 degree + 1, 2 degree + 1] float64, orthogonal.

    Raises:
        ShapeError: degree out of range or `rotation` not [3, 3] of floats.
    """
    if rotation.shape != (3, 3):
        raise ShapeError(f"rotation must be [3, 3], got {list(rotation.shape)}.")
    nodes, weights = np.polynomial.legendre.leggauss(2 * MAX_DEGREE)
    turns = np.arange(4 * MAX_DEGREE) * (2 * np.pi / (4 * MAX_DEGREE))
    z, phi = np.meshgrid(nodes, turns, indexing="ij")
    r = np.sqrt(1 - z * z)
    dirs = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1).reshape(-1, 3)
    area = np.repeat(weights, len(turns)) * (2 * np.pi / len(turns))
    band = slice(degree * degree, (degree + 1) ** 2)
    here = sh_basis(degree, dirs)[:, band]
    there = sh_basis(degree, dirs @ rotation)[:, band]
    return here.T @ (there * area[:, None])


def rgb_to_sh0(rgb: np.ndarray) -> np.ndarray:
    """Constant coefficient of a colour in [0, 1] (sRGB values), of any shape: (rgb - 0.5) / C0."""
    return (rgb - 0.5) / SH_C0


def sh0_to_rgb(sh0: np.ndarray) -> np.ndarray:
    """Colour in [0, 1] (sRGB values, not clamped) of a constant coefficient: C0 sh0 + 0.5."""
    return sh0 * SH_C0 + 0.5
