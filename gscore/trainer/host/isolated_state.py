"""Isolated torch and numpy state: a host program's settings are set aside during a training.

Torch's default dtype and device are not among it: they hold for all threads of the host, so that
they are left alone, and every tensor is made with its own (`raster.memory`, `host.random`).
"""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
import torch


@contextmanager
def isolated_torch_state() -> Iterator[None]:
    """Gradients can be taken, numbers have the precision of their dtype, numpy raises nothing.

    Torch uses one thread: it does little here, and its waiting threads would take cores from the
    rasterizer.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with ExitStack() as stack:
            stack.enter_context(torch.inference_mode(False))
            stack.enter_context(torch.enable_grad())
            stack.enter_context(torch.autocast("cpu", enabled=False))
            stack.enter_context(isolated_numpy_state())
            yield
    finally:
        torch.set_num_threads(threads)


def isolated_numpy_state() -> np.errstate:
    """Numpy's own choice of what to do about numbers out of range."""
    return np.errstate(divide="warn", over="warn", under="ignore", invalid="warn")
