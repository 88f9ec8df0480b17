"""malloc settings: large blocks of the C library come from mmap."""

import contextlib
import ctypes
import sys

_LARGE = 1 << 20
_M_MMAP_THRESHOLD = -3


def mmap_large_blocks() -> None:
    """Make malloc map each block of at least 1 MB separately, and unmap it when it is freed.

    glibc raises its threshold up to 32 MB once mapped blocks are freed; the temporary arrays of a
    refinement then leave holes in the heap that are never reused. Other C libraries have no such
    setting.
    """
    if sys.platform == "linux":
        with contextlib.suppress(AttributeError, OSError):
            ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _LARGE)
