"""Buffer addresses of arrays for the library, checked for type, shape and layout.

The library trusts the sizes it receives. An array of another dtype, device, layout or size would be
read as garbage, or written beyond its end, without an error; so every address comes from here.
"""

from typing import Any

import numpy as np

from ..errors import ShapeError

Array = Any
"""A numpy.ndarray or a torch.Tensor on the CPU."""
FLOAT32, FLOAT64 = np.dtype(np.float32), np.dtype(np.float64)
INT32, INT64, UINT8 = np.dtype(np.int32), np.dtype(np.int64), np.dtype(np.uint8)
UINT32 = np.dtype(np.uint32)

_of_torch: dict[Any, np.dtype | None] = {}
"""The same dtypes by torch's dtype objects, filled lazily, because this file does not need
torch."""


def address(name: str, array: Array, shape: tuple[int, ...], dtype: np.dtype = FLOAT32) -> int:
    """Address of an array's first number; the array must outlive the native call.

    Args:
        name: Name of the array, for the message.
        array: C-contiguous, aligned, in CPU memory.
        shape: Expected shape.
        dtype: Expected dtype.

    Raises:
        ShapeError: shape, dtype or layout differ.
    """
    if isinstance(array, np.ndarray):
        flags = array.flags
        if array.dtype == dtype and array.shape == shape and flags.c_contiguous and flags.aligned:
            return array.ctypes.data
    elif hasattr(array, "data_ptr") and _is_plain(array, shape, dtype):
        return array.data_ptr()
    found = _described(array)
    raise ShapeError(
        f"{name} must be {list(shape)} {dtype.name}, contiguous, on the CPU, got {found}."
    )


def optional(
    name: str, array: Array | None, shape: tuple[int, ...], dtype: np.dtype = FLOAT32
) -> int | None:
    """Like `address`; None if there is no array."""
    return None if array is None else address(name, array, shape, dtype)


def _is_plain(tensor: Array, shape: tuple[int, ...], dtype: np.dtype) -> bool:
    """Whether a tensor is dense in CPU memory with this shape and dtype."""
    found = tensor.dtype
    if found not in _of_torch:
        _of_torch[found] = _numpy_of(str(found))
    return (
        _of_torch[found] == dtype
        and tensor.shape == shape
        and tensor.is_cpu
        and tensor.is_contiguous()
        and not tensor.is_neg()  # such a view has its signs flipped on read
    )


def _numpy_of(name: str) -> np.dtype | None:
    try:
        return np.dtype(name.removeprefix("torch."))
    except TypeError:
        return None


def _described(array: Array) -> str:
    """Description of an array for messages."""
    if array is None:
        return "none"
    if not hasattr(array, "dtype") or not hasattr(array, "shape"):
        return type(array).__name__
    text = f"{list(array.shape)} {str(array.dtype).removeprefix('torch.')}"
    if isinstance(array, np.ndarray):
        flags = array.flags
        return text if flags.c_contiguous and flags.aligned else f"{text}, not contiguous"
    if not array.is_cpu:
        return f"{text} on {array.device}"
    return text if array.is_contiguous() else f"{text}, not contiguous"
