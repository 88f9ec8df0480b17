"""Reserved memory, allocated before its use; no bpy.

The operating system allocates a page at the first write to it. For the 12 MB of one attribute of a
million splats this takes 10 to 70 ms; copying them takes 1 ms.
"""

import threading
import weakref
from collections import deque
from collections.abc import Sequence

import numpy as np

from . import threads


def written(size: int) -> np.ndarray:
    """Float32 zeros with allocated memory pages."""
    array = np.empty(size, np.float32)
    array.fill(0)
    return array


class Memory:
    """Arrays that a thread allocates one after the other, writing to each page."""

    def __init__(self, sizes: Sequence[int]) -> None:
        """Start the thread.

        Args:
            sizes: Number of float32 in each array.
        """
        made: deque[np.ndarray | int] = deque()  # the size in place of an array that failed
        dropped = threading.Event()

        def make() -> None:
            for size in sizes:
                if dropped.is_set():
                    return
                try:
                    made.append(written(size))
                except MemoryError:  # raised in `take`; else the owner would wait for ever
                    made.append(size)

        self._made = made
        weakref.finalize(self, dropped.set)
        threads.start(make, "gscore-memory", cancel=dropped.set)

    @property
    def ready(self) -> bool:
        """True if the next array is allocated."""
        return bool(self._made)

    def take(self) -> np.ndarray:
        """The next array, of zeros; requires `ready`.

        Raises:
            MemoryError: the allocation failed in the thread and fails now.
        """
        made = self._made.popleft()
        return np.zeros(made, np.float32) if isinstance(made, int) else made
