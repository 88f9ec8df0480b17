"""NPY arrays from untrusted bytes."""

import ast
import math
import struct

import numpy as np

_MAGIC = b"\x93NUMPY"
_LONGEST_HEADER = 1 << 16


def read_npy(raw: bytes) -> np.ndarray:
    """Array of numbers from the bytes of an .npy file.

    Used instead of `numpy.load`, which allocates the size stated in a header before reading, raises
    any error of Python's parser on a bad header, and supports pickled objects.

    Raises:
        ValueError: it is no .npy file, truncated, or has other values than real numbers.
    """
    if len(raw) < 10 or not raw.startswith(_MAGIC):
        raise ValueError("it does not start with NumPy's magic number")
    long = raw[6] >= 2
    (length,) = struct.unpack_from("<I" if long else "<H", raw, 8) if len(raw) >= 12 else (0,)
    at = (12 if long else 10) + length
    if length > _LONGEST_HEADER or at > len(raw):
        raise ValueError("its header is damaged")
    try:
        header = ast.literal_eval(raw[12 if long else 10 : at].decode("latin-1").strip())
        kind, shape = np.dtype(header["descr"]), tuple(header["shape"])
        fortran = bool(header["fortran_order"])
    except Exception as error:  # the parser and numpy raise many kinds
        raise ValueError("its header is damaged") from error
    if kind.kind not in "fiu":
        raise ValueError(f"it is not an array of numbers, but of {kind}")
    if not all(type(side) is int and side >= 0 for side in shape):
        raise ValueError(f"its header states the shape {shape}")
    count = math.prod(shape)
    if count * kind.itemsize > len(raw) - at:
        raise ValueError(f"it is truncated: {len(raw) - at} bytes for the shape {shape}")
    return np.frombuffer(raw, kind, count, at).reshape(shape, order="F" if fortran else "C")
