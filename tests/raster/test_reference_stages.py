"""Oracles: gradcheck for each stage's gradient, scipy and numpy for each stage's value."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y
from torch.autograd import gradcheck

from gscore.raster import reference
from gscore.raster.request import Settings

WIDTH, HEIGHT = 40, 30
K = torch.tensor([[35.0, 0, 17.0], [0, 42.0, 16.5], [0, 0, 1]], dtype=torch.float64)


def normal(*shape, seed=0):
    rng = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=rng, dtype=torch.float64)


def leaf(tensor):
    return tensor.clone().requires_grad_()


def rigid(seed):
    """[4, 4] world-to-camera matrix from scipy's rotations."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    matrix[:3, 3] = [0.3, -0.2, 5.0]
    return torch.from_numpy(matrix)


def points_in_view(seed=1):
    """[12, 3] camera-frame points: inside the image, and beyond the Jacobian clamp on each side."""
    z = normal(12, seed=seed).abs() + 1.5
    slope_x = torch.linspace(-2.0, 2.0, 12).double()
    slope_y = torch.tensor([0.1, -1.7, 0.2, 1.9] * 3).double()
    return torch.stack([slope_x * z, slope_y * z, z], 1)


def check(function, *inputs):
    """gradcheck at the accuracy that central differences of double precision allow."""
    assert gradcheck(function, inputs, eps=1e-6, atol=2e-9, rtol=1e-7)


def test_quaternions_give_scipys_rotations():
    quats = normal(50, 4) * 3.0
    expected = Rotation.from_quat(quats.numpy(), scalar_first=True).as_matrix()
    assert np.abs(reference.quat_to_rotmat(quats).numpy() - expected).max() < 1e-14


def test_quaternion_length_and_sign_do_not_matter():
    quats = normal(20, 4)
    base = reference.quat_to_rotmat(quats)
    assert (reference.quat_to_rotmat(quats * 1e3) - base).abs().max() < 1e-14
    assert torch.equal(reference.quat_to_rotmat(-quats), base)


def test_quaternion_gradient():
    check(reference.quat_to_rotmat, leaf(normal(6, 4)))
    check(reference.quat_to_rotmat, leaf(normal(6, 4) * 0.2 + torch.tensor([1.0, 0, 0, 0])))


def test_covariance_has_the_splats_axes():
    """Eigen-decomposition of Sigma gives back scales and axes."""
    quats = normal(10, 4)
    scales = torch.tensor([0.1, 0.5, 2.0]).double() * (1 + normal(10, 1).abs())
    values, vectors = np.linalg.eigh(reference.covariance(quats, scales).numpy())
    assert np.allclose(np.sqrt(values), scales.numpy(), rtol=1e-10)
    along = np.abs(np.einsum("nij,nij->nj", vectors, reference.quat_to_rotmat(quats).numpy()))
    assert np.allclose(along, 1, atol=1e-10)


def test_covariance_gradient():
    check(reference.covariance, leaf(normal(5, 4)), leaf(normal(5, 3).exp()))


def test_covariance_gradient_of_a_needle():
    scales = torch.tensor([[2.0, 1e-4, 1e-6]], dtype=torch.float64)
    check(reference.covariance, leaf(normal(1, 4)), leaf(scales))


def test_camera_transform_gradients():
    viewmat = rigid(3)
    check(reference.means_to_camera, leaf(normal(5, 3)), leaf(viewmat))
    covars = reference.covariance(normal(4, 4), normal(4, 3).exp())
    check(reference.covariance_to_camera, leaf(covars), leaf(viewmat))


def test_jacobian_is_the_derivative_of_the_projection_inside_the_image():
    points = points_in_view()
    points = points[(points[:, :2] / points[:, 2:]).abs().amax(1) < 0.6]
    assert len(points) >= 2
    jacobian = reference.projection_jacobian(points, K, WIDTH, HEIGHT)
    for point, actual in zip(points, jacobian, strict=True):
        expected = torch.autograd.functional.jacobian(
            lambda p: reference.project_means(p[None], K)[0], point
        )
        assert (actual - expected).abs().max() < 1e-13


def test_jacobian_clamp_is_measured_from_the_principal_point():
    """Closed form: slopes stop at the image edge plus 0.3 tan(fov/2), on each side separately."""
    z = 2.0
    points = torch.tensor([[-50.0, -50.0, z], [50.0, 50.0, z]], dtype=torch.float64)
    jacobian = reference.projection_jacobian(points, K, WIDTH, HEIGHT)
    left, right = -17.0 / 35 - 0.3 * 20 / 35, (40 - 17.0) / 35 + 0.3 * 20 / 35
    top, bottom = -16.5 / 42 - 0.3 * 15 / 42, (30 - 16.5) / 42 + 0.3 * 15 / 42
    expected = torch.tensor([[left, top], [right, bottom]], dtype=torch.float64)
    assert torch.allclose(jacobian[:, 0, 2], -35.0 * expected[:, 0] / z, rtol=1e-14)
    assert torch.allclose(jacobian[:, 1, 2], -42.0 * expected[:, 1] / z, rtol=1e-14)
    assert torch.equal(jacobian[:, 0, 0], torch.full((2,), 35.0 / z, dtype=torch.float64))
    assert torch.equal(jacobian[:, 1, 1], torch.full((2,), 42.0 / z, dtype=torch.float64))


def test_projection_gradients_inside_and_beyond_the_clamp():
    points = points_in_view()
    check(lambda p: reference.project_means(p, K), leaf(points))
    check(lambda p: reference.projection_jacobian(p, K, WIDTH, HEIGHT), leaf(points))


def test_image_covariance_gradient():
    covars = reference.covariance(normal(4, 4), normal(4, 3).exp())
    jacobian = reference.projection_jacobian(points_in_view()[:4], K, WIDTH, HEIGHT)
    check(reference.project_covariance, leaf(covars), leaf(jacobian))


def image_covariances(count=8, seed=4):
    axes = normal(count, 2, 2, seed=seed) * 3
    return axes @ axes.transpose(1, 2)


def test_conic_is_numpys_inverse():
    covars = image_covariances()
    conics, compensation = reference.conic(covars, 0.3)
    filtered = covars.numpy() + 0.3 * np.eye(2)
    inverse = np.linalg.inv(filtered)
    expected = np.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], 1)
    assert np.allclose(conics.numpy(), expected, rtol=1e-11)
    ratio = np.linalg.det(covars.numpy()) / np.linalg.det(filtered)
    assert np.allclose(compensation.numpy(), np.sqrt(ratio), rtol=1e-10)


def symmetric(entries):
    """[N, 2, 2] from (xx, xy, yy): both off-diagonal entries move together, as in use."""
    xx, xy, yy = entries.unbind(1)
    return torch.stack([xx, xy, xy, yy], 1).reshape(-1, 2, 2)


def test_conic_gradient():
    covars = image_covariances()
    entries = torch.stack([covars[:, 0, 0], covars[:, 0, 1], covars[:, 1, 1]], 1)
    check(lambda e: reference.conic(symmetric(e), 0.3), leaf(entries))


def test_conic_gradient_of_a_needle_and_of_a_dot():
    """100 : 1 in pixels at 30 degrees; and a splat far below one pixel, above the floor."""
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    turn = torch.tensor([[c, -s], [s, c]])
    needle = turn @ torch.diag(torch.tensor([100.0, 0.01]).double()) @ turn.T
    dot = torch.diag(torch.tensor([0.01, 0.02]).double())
    for covar in (needle, dot):
        entries = torch.stack([covar[0, 0], covar[0, 1], covar[1, 1]])[None]
        assert reference.conic(symmetric(entries), 0.3)[1] > 0.006
        check(lambda e: reference.conic(symmetric(e), 0.3), leaf(entries))


def test_compensation_floor_has_no_gradient():
    entries = leaf(torch.tensor([[1e-4, 0.0, 1e-4]], dtype=torch.float64))
    compensation = reference.conic(symmetric(entries), 0.3)[1]
    assert float(compensation.detach()) == 0.005
    (gradient,) = torch.autograd.grad(compensation.sum(), entries)
    assert not gradient.any()


def real_harmonics(directions, degree):
    """[N, (degree+1)^2] from scipy's complex harmonics: sqrt 2 Re for m > 0, sqrt 2 Im for m < 0.

    scipy includes the Condon-Shortley phase, and so does the convention of 3DGS.
    """
    x, y, z = directions.T
    polar, azimuth = np.arccos(z), np.arctan2(y, x)
    columns = []
    for order in range(degree + 1):
        for m in range(-order, order + 1):
            value = sph_harm_y(order, abs(m), polar, azimuth)
            part = value.imag if m < 0 else value.real
            columns.append(part * (np.sqrt(2) if m else 1))
    return np.stack(columns, 1)


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 4])
def test_harmonics_are_scipys(degree):
    directions = normal(200, 3)
    directions = directions / directions.norm(dim=1, keepdim=True)
    poles = torch.tensor([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0], [0, -1.0, 0]]).double()
    directions = torch.cat([directions, poles])
    expected = real_harmonics(directions.numpy(), degree)
    actual = reference.sh_basis(directions, degree).numpy()
    assert actual.shape == (204, (degree + 1) ** 2)
    assert np.abs(actual - expected).max() < 1e-12


def test_harmonics_are_orthonormal():
    """Exact quadrature over the sphere: Gauss-Legendre in z, equal steps in azimuth."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    angles = np.arange(16) * 2 * np.pi / 16
    z, angle = np.meshgrid(nodes, angles, indexing="ij")
    radius = np.sqrt(1 - z * z)
    directions = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1).reshape(-1, 3)
    basis = reference.sh_basis(torch.from_numpy(directions), 4).numpy()
    area = (weights[:, None] * np.full(16, 2 * np.pi / 16)).reshape(-1)
    assert np.abs(basis.T @ (area[:, None] * basis) - np.eye(25)).max() < 1e-13


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 4])
def test_color_gradient(degree):
    """All inputs, with colours away from the clamp at zero."""
    means, viewmat = normal(5, 3), rigid(5)
    sh0, shN = normal(5, 1, 3), normal(5, 24, 3) * 0.3
    colors = reference.sh_colors(means, viewmat, sh0, shN, degree)
    assert (colors > 0).any()
    assert (colors == 0).any()
    check(
        lambda *tensors: reference.sh_colors(*tensors, degree),
        *(leaf(tensor) for tensor in (means, viewmat, sh0, shN)),
    )


def test_color_is_clamped_at_zero_without_gradient():
    sh0 = leaf(torch.tensor([[[-3.0, 0.0, 3.0]]], dtype=torch.float64))
    colors = reference.sh_colors(normal(1, 3), rigid(1), sh0, torch.zeros(1, 0, 3).double(), 0)
    constant = 0.5 / np.sqrt(np.pi)
    expected = torch.tensor([[0.0, 0.5, 0.5 + 3 * constant]], dtype=torch.float64)
    assert torch.allclose(colors.detach(), expected, rtol=1e-15)
    (gradient,) = torch.autograd.grad(colors.sum(), sh0)
    expected = torch.tensor([[[0.0, constant, constant]]], dtype=torch.float64)
    assert torch.allclose(gradient, expected, rtol=1e-15)


def test_alpha_and_blend_gradients(smooth_scene):
    """Every input of the blend stage, on a scene without jumps."""
    scene = smooth_scene(800, count=5, width=9, height=8, sh_degree=0)
    splats = reference.project(*scene.tensors(), Settings())
    pixels = reference.pixel_centers(scene.width, scene.height, like=scene.means)
    geometry = (splats.means2d, splats.conics, splats.opacities)
    assert reference.gaussian_alpha(pixels, *geometry).max() > 0.1
    check(lambda *g: reference.gaussian_alpha(pixels, *g), *(leaf(g) for g in geometry))

    def sums_and_light(means2d, conics, opacities, features):
        out = reference.blend_pixels(pixels, means2d, conics, opacities, splats.depths, features)
        return out.sums, out.transmittance

    check(sums_and_light, *(leaf(t) for t in (*geometry, splats.colors)))
