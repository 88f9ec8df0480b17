"""Isolated state: replaces a host program's settings of torch, numpy and malloc during a training.

Torch's default dtype and device stay, because they apply to all threads of the host. Every tensor
is created with an explicit dtype and device instead (`raster.memory`, `engine.random`).
"""

import contextlib
import ctypes
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
import torch


@contextmanager
def isolated_torch_state() -> Iterator[None]:
    """Enable gradients, disable autocast and numpy errors, and limit torch to one thread.

    Torch does little work here, and its waiting threads would take cores from the rasterizer.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with ExitStack() as stack:
            stack.enter_context(torch.inference_mode(False))
            stack.enter_context(torch.enable_grad())
            stack.enter_context(torch.autocast("cpu", enabled=False))
            # Numpy's default handling of errors.
            stack.enter_context(np.errstate(all="warn", under="ignore"))
            yield
    finally:
        torch.set_num_threads(threads)


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
