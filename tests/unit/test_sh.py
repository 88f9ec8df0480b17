"""Spherical harmonics against scipy's complex ones, quadrature and hand-computed values."""

import math

import numpy as np
import pytest
from scipy.special import sph_harm_y

from gscore.errors import ShapeError
from gscore.sh import rgb_to_sh0, sh0_to_rgb, sh_basis, sh_count


@pytest.fixture
def dirs(rng: np.random.Generator) -> np.ndarray:
    vectors = rng.standard_normal((200, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 4])
def test_equals_real_form_of_scipy(degree: int, dirs: np.ndarray) -> None:
    """Oracle: scipy.special.sph_harm_y, combined into real harmonics by their definition."""
    theta, phi = np.arccos(dirs[:, 2]), np.arctan2(dirs[:, 1], dirs[:, 0])
    expected = []
    for band in range(degree + 1):
        for m in range(-band, band + 1):
            y = sph_harm_y(band, abs(m), theta, phi)  # has the Condon-Shortley sign (-1)^m
            part = y.real if m == 0 else math.sqrt(2) * (y.imag if m < 0 else y.real)
            expected.append(part)
    np.testing.assert_allclose(sh_basis(degree, dirs), np.stack(expected, -1), atol=1e-13)


def test_signs_of_3dgs() -> None:
    """Oracle: the first band of the 3DGS paper's code, -y, z, -x times 0.4886025119."""
    values = sh_basis(1, np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]))
    c = 0.4886025119029199
    np.testing.assert_allclose(values[:, 1:], [[0, 0, -c], [-c, 0, 0], [0, c, 0]], atol=1e-15)


def test_orthonormal() -> None:
    """Oracle: the identity as the integral of products over the sphere (Gauss-Legendre, exact)."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    phi = np.arange(16) * (2 * np.pi / 16)
    z, p = np.meshgrid(nodes, phi, indexing="ij")
    r = np.sqrt(1 - z**2)
    values = sh_basis(4, np.stack([r * np.cos(p), r * np.sin(p), z], -1))
    gram = np.einsum("ijk,ijl,i->kl", values, values, weights) * (2 * np.pi / 16)
    np.testing.assert_allclose(gram, np.eye(25), atol=1e-13)


def test_keeps_float32_and_batch_shape(dirs: np.ndarray) -> None:
    """Oracle: the float64 result."""
    single = sh_basis(4, dirs.astype(np.float32).reshape(2, 100, 3))
    assert single.dtype == np.float32
    assert single.shape == (2, 100, sh_count(4))
    np.testing.assert_allclose(single.reshape(200, 25), sh_basis(4, dirs), atol=2e-6)


def test_color_of_constant_coefficient() -> None:
    """Oracle: 0.5 + 0.28209479177387814 f_dc, the formula of viewers."""
    rgb = np.array([0.0, 0.5, 1.0])
    np.testing.assert_allclose(rgb_to_sh0(rgb), (rgb - 0.5) / 0.28209479177387814, atol=1e-15)
    np.testing.assert_allclose(sh0_to_rgb(rgb_to_sh0(rgb)), rgb, atol=1e-15)


@pytest.mark.parametrize(
    ("degree", "dirs"), [(5, np.zeros((1, 3))), (0, np.zeros(2)), (0, np.zeros((2, 3), int))]
)
def test_refuses(degree: int, dirs: np.ndarray) -> None:
    """Oracle: the documented limits."""
    with pytest.raises(ShapeError, match=r"degree|dirs"):
        sh_basis(degree, dirs)
