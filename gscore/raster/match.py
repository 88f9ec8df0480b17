"""Feature matches between two photos, by the native library."""

import ctypes as ct

import numpy as np

from . import _native, header
from .buffers import INT32, UINT8, address


def match_descriptors(
    first: np.ndarray, second: np.ndarray, *, max_distance: float, max_ratio: float
) -> np.ndarray:
    """Mutual nearest neighbours among the features of two photos, by their descriptors.

    Exact: all pairs are compared, in integers. Single-threaded, so that callers can match several
    pairs of photos in parallel.

    Args:
        first: [n, 128] uint8.
        second: [m, 128] uint8.
        max_distance: Maximum distance of matching descriptors, in units of their numbers.
        max_ratio: Maximum ratio of the distance to that of the second nearest, in both directions
            (Lowe 2004, section 7.1); 0 to 1. A photo of one feature has no second.

    Returns:
        [k, 2] int32, rows of `first`, ascending, and of `second`.

    Raises:
        ShapeError: an array has a wrong shape or dtype, or a number is out of range.
        BackendError: the native library is missing, or memory ran out.
    """
    matches = np.empty(len(first), np.int32)
    _native.raise_status(
        _native.library().gs_match_descriptors(
            ct.byref(_descriptors("first", first)),
            ct.byref(_descriptors("second", second)),
            max_distance,
            max_ratio,
            address("matches", matches, matches.shape, INT32),
        )
    )
    rows = np.flatnonzero(matches >= 0).astype(np.int32)
    return np.stack([rows, matches[rows]], axis=1)


def _descriptors(name: str, values: np.ndarray) -> ct.Structure:
    shape = (len(values), header.DESCRIPTOR_SIZE)
    return header.DescriptorsStruct(
        count=min(len(values), np.iinfo(np.int32).max), values=address(name, values, shape, UINT8)
    )
