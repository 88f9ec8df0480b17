"""Isolated torch and numpy state: replaces a host program's settings during a training.

Torch's default dtype and device stay, because they apply to all threads of the host. Every tensor
is created with an explicit dtype and device instead (`raster.memory`, `engine.random`).
"""

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
            stack.enter_context(isolated_numpy_state())
            yield
    finally:
        torch.set_num_threads(threads)


def isolated_numpy_state() -> np.errstate:
    """Numpy's default handling of floating-point errors."""
    return np.errstate(divide="warn", over="warn", under="ignore", invalid="warn")
