"""Arrays passed to the library by address; oracle: messages, numpy and torch.

The library reads or writes each as a number of values of one dtype, so all others must be refused.
"""

from typing import Any

import numpy as np
import pytest
import torch

from gscore.errors import ShapeError
from gscore.raster import _native
from gscore.raster.buffers import FLOAT32, INT32, UINT8, address, optional
from gscore.raster.request import Frustum, Settings
from gscore.splats import PARAMETERS

GOOD: dict[str, tuple[Any, tuple[int, ...], np.dtype]] = {
    "numpy": (np.zeros((4, 3), np.float32), (4, 3), FLOAT32),
    "numpy, read-only": (np.broadcast_to(np.float32(1), (1, 1)), (1, 1), FLOAT32),
    "torch": (torch.zeros(4, 3), (4, 3), FLOAT32),
    "torch, a part": (torch.zeros(9, 3)[2:6], (4, 3), FLOAT32),
    "torch, with gradient": (torch.zeros(2, requires_grad=True), (2,), FLOAT32),
    "bytes": (torch.zeros(5, dtype=torch.uint8), (5,), UINT8),
    "integers": (torch.zeros(5, dtype=torch.int32), (5,), INT32),
    "nothing": (torch.zeros(0, 3), (0, 3), FLOAT32),
}
BAD: dict[str, tuple[Any, str]] = {
    "double": (np.zeros((4, 3)), r"got \[4, 3\] float64"),
    "torch double": (torch.zeros(4, 3, dtype=torch.float64), r"got \[4, 3\] float64"),
    "half": (torch.zeros(4, 3, dtype=torch.bfloat16), r"got \[4, 3\] bfloat16"),
    "other bytes first": (np.zeros((4, 3), ">f4"), r"got \[4, 3\] >f4"),
    "other shape": (torch.zeros(3, 4), r"got \[3, 4\] float32"),
    "one row less": (np.zeros((3, 3), np.float32), r"got \[3, 3\] float32"),
    "transposed": (torch.zeros(3, 4).T, "not contiguous"),
    "expanded": (torch.zeros(1, 3).expand(4, 3), "not contiguous"),
    "numpy, every other": (np.zeros((8, 3), np.float32)[::2], "not contiguous"),
    "between two floats": (
        np.frombuffer(bytes(49), np.uint8)[1:].view(np.float32).reshape(4, 3),
        "not contiguous",
    ),
    "elsewhere": (torch.zeros(4, 3, device="meta"), "on meta"),
    "signs left out": (torch.zeros(4, 3, dtype=torch.complex64).conj().imag, "not contiguous"),
    "a list": ([[0.0] * 3] * 4, "got list"),
    "nothing": (None, "got none"),
}


@pytest.mark.parametrize("name", GOOD)
def test_arrays_that_fit_are_found(name: str) -> None:
    """Oracle: numpy's and torch's own addresses."""
    array, shape, dtype = GOOD[name]
    own = array.ctypes.data if isinstance(array, np.ndarray) else array.data_ptr()
    assert address("a", array, shape, dtype) == own
    assert optional("a", None, shape, dtype) is None


@pytest.mark.parametrize("name", BAD)
def test_arrays_that_do_not_fit_are_named(name: str) -> None:
    """Oracle: the message, with the expected and the actual array."""
    array, message = BAD[name]
    wanted = r"means must be \[4, 3\] float32, contiguous, on the CPU, "
    with pytest.raises(ShapeError, match=wanted + ".*" + message):
        address("means", array, (4, 3))


def test_a_view_whose_signs_are_left_out_is_refused() -> None:
    """Oracle: torch's flag; its memory stores the numbers with the other sign."""
    view = torch.zeros(4, 1, dtype=torch.complex64).conj().imag[:1, 0]
    assert view.is_neg() and view.is_contiguous()
    with pytest.raises(ShapeError, match="v must be"):
        address("v", view, (1,))


def test_outputs_of_another_dtype_or_size_are_refused() -> None:
    """Oracle: a ShapeError with the array's name instead of writes out of bounds."""
    n, size = 5, (6, 7)
    shapes = ((n, 3), (n, 4), (n, 3), (n,), (n, 1, 3), (n, 3, 3))
    splats = [np.ones(shape, np.float32) for shape in shapes]
    view, settings = Frustum(np.eye(4), np.diag([9.0, 9.0, 1.0]), 7, 6), Settings()
    pictures = {"rgb": np.zeros((*size, 3), np.float32), "alpha": np.zeros(size, np.float32)}
    raster = _native.Raster()
    for wrong in ({"rgb": np.zeros((*size, 3))}, {"alpha": np.zeros((6, 6), np.float32)}):
        with pytest.raises(ShapeError, match=f"{next(iter(wrong))} must be"):
            raster.forward(splats, view, settings, pictures | wrong)
    with pytest.raises(ShapeError, match=r"radii must be \[5\] int32"):
        raster.forward(splats, view, settings, pictures | {"radii": np.zeros(5, np.int64)})
    raster.forward(splats, view, settings, pictures)
    grads = {k: np.zeros_like(a) for k, a in zip(PARAMETERS, splats, strict=True)}
    v = {"rgb": pictures["rgb"]}
    with pytest.raises(ShapeError, match=r"v_quats must be \[5, 4\] float32"):
        raster.backward(splats, view, settings, v, grads | {"quats": np.zeros((5, 4))})
    with pytest.raises(ShapeError, match=r"v_rgb must be \[6, 7, 3\]"):
        raster.backward(splats, view, settings, {"rgb": np.zeros((6, 7), np.float32)}, grads)
    with pytest.raises(ShapeError, match="depth, which was not rendered"):
        raster.backward(splats, view, settings, {"depth": pictures["alpha"]}, grads)
    raster.backward(splats, view, settings, v, grads)


@pytest.mark.parametrize("threads", [-1, 1025, 2**32, 2**32 + 2, 2.0, "2"])
def test_threads_that_cannot_be_are_refused(threads: Any) -> None:
    """Oracle: the message. A C integer silently converts 2^32 + 2 to 2."""
    splats = [np.ones(s, np.float32) for s in ((1, 3), (1, 4), (1, 3), (1,), (1, 1, 3), (1, 0, 3))]
    view = Frustum(np.eye(4), np.diag([9.0, 9.0, 1.0]), 2, 2)
    pictures = {"rgb": np.zeros((2, 2, 3), np.float32), "alpha": np.zeros((2, 2), np.float32)}
    with pytest.raises(ShapeError, match=r"threads must be 0 \(all\) to 1024, got"):
        _native.Raster().forward(splats, view, Settings(threads=threads), pictures)
