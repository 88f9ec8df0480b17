"""Buffer addresses of arrays for the library, checked for type, shape and layout.

The library reads and writes as many bytes as the sizes it was given say. An array of another dtype,
device, layout or size would be read as garbage, or written beyond its end, without an error; so
every address comes from here.
"""

from typing import Any

import numpy as np

from ..errors import ShapeError

Array = Any
"""A numpy.ndarray or, where torch is there, a torch.Tensor on the CPU."""
FLOAT32, FLOAT64 = np.dtype(np.float32), np.dtype(np.float64)
INT32, INT64, UINT8 = np.dtype(np.int32), np.dtype(np.int64), np.dtype(np.uint8)

_of_torch: dict[Any, np.dtype | None] = {}
"""The same dtypes by torch's objects, as they come along; this file does without torch."""


def address(name: str, array: Array, shape: tuple[int, ...], dtype: np.dtype = FLOAT32) -> int:
    """Where an array's numbers begin; it must outlive the call that is given this.

    Args:
        name: Of the array, for the message.
        array: C-contiguous, in the machine's memory.
        shape: That it must have.
        dtype: That it must have.

    Raises:
        ShapeError: it is anything else.
    """
    if isinstance(array, np.ndarray):
        flags = array.flags
        if array.dtype == dtype and array.shape == shape and flags.c_contiguous and flags.aligned:
            return array.ctypes.data
    elif hasattr(array, "data_ptr") and _is_plain(array, shape, dtype):
        return array.data_ptr()
    raise ShapeError(
        f"{name} must be {list(shape)} {dtype.name}, contiguous, on the CPU, got {_seen(array)}."
    )


def optional(
    name: str, array: Array | None, shape: tuple[int, ...], dtype: np.dtype = FLOAT32
) -> int | None:
    """As `address`; None where there is no array."""
    return None if array is None else address(name, array, shape, dtype)


def _is_plain(tensor: Array, shape: tuple[int, ...], dtype: np.dtype) -> bool:
    """Whether a tensor's memory holds its numbers as they are, in order."""
    found = tensor.dtype
    if found not in _of_torch:
        _of_torch[found] = _numpy_of(str(found))
    return (
        _of_torch[found] == dtype
        and tensor.shape == shape
        and tensor.is_cpu
        and tensor.is_contiguous()
        and not tensor.is_neg()  # such a view leaves the signs to whoever reads it
    )


def _numpy_of(name: str) -> np.dtype | None:
    try:
        return np.dtype(name.removeprefix("torch."))
    except TypeError:
        return None


def _seen(array: Array) -> str:
    """An array in words."""
    if array is None:
        return "none"
    if not hasattr(array, "dtype") or not hasattr(array, "shape"):
        return type(array).__name__
    words = f"{list(array.shape)} {str(array.dtype).removeprefix('torch.')}"
    if isinstance(array, np.ndarray):
        flags = array.flags
        return words if flags.c_contiguous and flags.aligned else f"{words}, not contiguous"
    if not array.is_cpu:
        return f"{words} on {array.device}"
    return words if array.is_contiguous() else f"{words}, not contiguous"
