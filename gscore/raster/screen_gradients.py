"""Screen-space gradient sums of splats over views, natively on torch tensors."""

from torch import Tensor

from . import _native, arguments
from .buffers import INT32, address


def add_screen_gradients(
    grad2d: Tensor,
    views: Tensor,
    v_means2d: Tensor,
    radii: Tensor,
    scale: tuple[float, float],
    *,
    threads: int = 0,
) -> None:
    """Accumulate one view: add |v * scale| to `grad2d`, and 1 to `views`, of splats it drew.

    Args:
        grad2d: [N] float32, changed in place.
        views: [N] float32, changed in place.
        v_means2d: [N, 2] float32, gradient in the projected means.
        radii: [N] int32, 0 where a splat was not drawn.
        scale: Factors on x and y of the gradients.
        threads: 0: all cores; results do not depend on it.

    Raises:
        ShapeError: a tensor has a wrong shape, dtype or layout.
    """
    n = len(grad2d)
    status = _native.library().gs_add_screen_gradients(
        n,
        address("v_means2d", v_means2d, (n, 2)),
        address("radii", radii, (n,), INT32),
        address("grad2d", grad2d, (n,)),
        address("views", views, (n,)),
        *scale,
        arguments.library_threads(threads),
    )
    _native.raise_status(status)
