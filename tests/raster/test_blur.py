"""Oracles: the two passes in float64 torch with autograd; the density of a Gaussian."""

from collections.abc import Sequence

import numpy as np
import pytest
import torch

from gscore.errors import GsError, ShapeError
from gscore.raster.blur import blur_image
from gscore.raster.reference.blur import blur_reference

COVARIANCES = [
    (0.0, 0.0, 0.0),
    (4.0, 0.0, 4.0),
    (9.0, 3.0, 2.0),
    (2.0, -2.5, 7.0),
    (0.3, 0.1, 0.2),
    (25.0, 25.0, 25.0),
    (1e-3, 0.0, 5.0),
    (200.0, 90.0, 90.0),
]


def picture(height: int, width: int, seed: int = 0) -> torch.Tensor:
    """[H, W, 3] of random colours."""
    return torch.rand(height, width, 3, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("covariance", COVARIANCES)
@pytest.mark.parametrize("size", [(1, 1), (1, 9), (40, 57), (7, 130)])
def test_picture_and_gradient(size: tuple[int, int], covariance: Sequence[float]) -> None:
    """Oracle: the reference and its gradient by autograd, to 1e-6."""
    image, v = picture(*size), picture(*size, seed=1)
    exact = image.double().requires_grad_()
    expected = blur_reference(exact, covariance)
    (gradient,) = torch.autograd.grad((expected * v).sum(), exact)
    assert (blur_image(image, covariance) - expected).abs().max() < 1e-6
    assert (blur_image(v, covariance, adjoint=True) - gradient).abs().max() < 1e-6


def test_gradient_by_finite_differences() -> None:
    """The adjoint is the derivative of a sum of the blurred picture's products."""
    image, v = picture(9, 11), picture(9, 11, seed=1)
    gradient = blur_image(v, (3.0, 1.0, 2.0), adjoint=True)
    for y, x, c in [(0, 0, 0), (4, 5, 1), (8, 10, 2), (0, 6, 1)]:
        moved = image.clone()
        moved[y, x, c] += 1.0
        change = blur_image(moved, (3.0, 1.0, 2.0)) - blur_image(image, (3.0, 1.0, 2.0))
        assert (change * v).sum().item() == pytest.approx(gradient[y, x, c].item(), abs=1e-5)


@pytest.mark.parametrize("covariance", [(4.0, 0.0, 4.0), (16.0, 12.0, 16.0), (9.0, -3.0, 5.0)])
def test_a_dot_becomes_the_gaussian(covariance: Sequence[float]) -> None:
    """Oracle: the density of the Gaussian at the pixels, to 5 % of its peak: the reach and the
    interpolation between two pixels change the rest."""
    image = torch.zeros(61, 61, 3)
    image[30, 30] = 1
    xx, xy, yy = covariance
    precision = np.linalg.inv([[xx, xy], [xy, yy]])
    at = np.stack(np.meshgrid(np.arange(-30, 31), np.arange(-30, 31)), axis=-1)
    density = np.exp(-0.5 * np.einsum("yxi,ij,yxj->yx", at, precision, at))
    density /= density.sum()
    found = blur_image(image, covariance)[..., 1].numpy()
    assert np.abs(found - density).max() < 0.05 * density.max()


def test_threads_do_not_change_a_bit() -> None:
    """Oracle: one thread."""
    image = picture(70, 33)
    for adjoint in (False, True):
        one = blur_image(image, (5.0, 2.0, 3.0), adjoint=adjoint, threads=1)
        assert torch.equal(one, blur_image(image, (5.0, 2.0, 3.0), adjoint=adjoint, threads=5))


def test_bad_arguments() -> None:
    """Shapes and covariances are named."""
    with pytest.raises(ShapeError, match=r"image must be \[H, W, 3\]"):
        blur_image(torch.zeros(4, 4), (1.0, 0.0, 1.0))
    for covariance in [(-1.0, 0.0, 1.0), (1.0, 2.0, 1.0), (5000.0, 0.0, 1.0), (np.nan, 0.0, 1.0)]:
        with pytest.raises(GsError, match="covariance of a blur"):
            blur_image(torch.zeros(4, 4, 3), covariance)
