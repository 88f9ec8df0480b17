"""Feature matches between two photos, by the native library."""

import ctypes as ct

import numpy as np

from . import _native, header
from .buffers import INT32, UINT8, address


def match_descriptors(
    first: np.ndarray, second: np.ndarray, *, max_distance: float, max_ratio: float
) -> np.ndarray:
    """Pairs of features of two photos that are each other's nearest, by their descriptors.

    Exact: each is compared with each, in whole numbers. Takes one thread, so that pairs of photos
    can be compared side by side.

    Args:
        first: [n, 128] uint8.
        second: [m, 128] uint8.
        max_distance: Of descriptors that match, in units of their numbers.
        max_ratio: The distance is less than so many times that to the second nearest, seen from
            both (Lowe 2004, section 7.1); 0 to 1. A photo of one feature has no second.

    Returns:
        [k, 2] int32, rows of `first`, rising, and of `second`.

    Raises:
        ShapeError: an array of another shape or dtype, or a number out of its range.
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


def _descriptors(name: str, values: np.ndarray) -> header.DescriptorsStruct:
    shape = (len(values), header.DESCRIPTOR_SIZE)
    return header.DescriptorsStruct(
        count=min(len(values), np.iinfo(np.int32).max), values=address(name, values, shape, UINT8)
    )
