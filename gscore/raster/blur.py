"""Blur of a picture by the native library: the convolution with a Gaussian, and its adjoint."""

import ctypes as ct
from collections.abc import Sequence

from torch import Tensor

from ..errors import ShapeError
from . import _native, arguments, header
from .buffers import address
from .memory import empty


def blur_image(
    image: Tensor, covariance: Sequence[float], *, adjoint: bool = False, threads: int = 0
) -> Tensor:
    """Blur a picture by a 2D Gaussian; weights beyond the picture are left out.

    It is two passes of sampled Gaussians, the first along a line between the pixels, the second
    along an axis (Geusebroek et al. 2003), see `raster.reference.blur`.

    Args:
        image: [H, W, 3] float32.
        covariance: xx, xy, yy of the Gaussian, px^2; positive semidefinite, variances at most
            `BLUR_MAX`.
        adjoint: True: the transposed operator, from gradients in the blurred picture to those in
            the sharp one.
        threads: 0: all cores.

    Returns:
        [H, W, 3] float32.

    Raises:
        ShapeError: The image has a wrong shape or dtype.
        GsError: The covariance is not valid.
    """
    shape = tuple(image.shape)
    if len(shape) != 3 or shape[2] != 3:
        raise ShapeError(f"image must be [H, W, 3] float32, got {list(shape)} {image.dtype}.")
    height, width = shape[:2]
    arguments.check_size(width, height)
    image, out = image.contiguous(), empty(*shape)
    args = header.BlurArgsStruct(
        width=width,
        height=height,
        image=address("image", image, shape),
        covariance=(ct.c_float * 3)(*covariance),
        adjoint=adjoint,
        threads=arguments.library_threads(threads),
    )
    _native.blur_image(args, out)
    return out
