"""malloc settings: large blocks of the C library come from mmap."""

import contextlib
import ctypes
import sys

_LARGE = 1 << 20
_M_MMAP_THRESHOLD = -3


def mmap_large_blocks() -> None:
    """From now on, have pieces of a megabyte and more mapped each on its own and given back to the
    system when they are freed.

    glibc takes pieces of up to 32 MB from its heap once it has seen such pieces freed; the
    temporary arrays of a refinement then leave holes there that nothing fills again. Other C
    libraries cannot be told.
    """
    if sys.platform == "linux":
        with contextlib.suppress(AttributeError, OSError):
            ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _LARGE)
