"""Reserved memory, allocated before its use; no bpy.

A system allocates a page of memory at the first write to it. For the 12 MB of one attribute of a
million splats that takes ten to seventy milliseconds, and copying them one.
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
    """Arrays that a thread allocates one after the other, with a first write to each page."""

    def __init__(self, sizes: Sequence[int]) -> None:
        """Begin.

        Args:
            sizes: Number of float32 in each array.
        """
        made: deque[np.ndarray | int] = deque()  # a size where there was no memory for it
        dropped = threading.Event()

        def make() -> None:
            for size in sizes:
                if dropped.is_set():
                    return
                try:
                    made.append(written(size))
                except MemoryError:  # passed on to the owner, who would wait for ever
                    made.append(size)

        self._made = made
        weakref.finalize(self, dropped.set)
        threads.start(make, "gscore-memory", cancel=dropped.set)

    @property
    def ready(self) -> bool:
        """True if the next array is allocated."""
        return bool(self._made)

    def take(self) -> np.ndarray:
        """The next array, of zeros; only where it is `ready`.

        Raises:
            MemoryError: the allocation failed in the thread and fails now.
        """
        made = self._made.popleft()
        return np.zeros(made, np.float32) if isinstance(made, int) else made
