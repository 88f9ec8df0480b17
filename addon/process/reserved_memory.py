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
    """So many float32 of 0, whose memory is there."""
    array = np.empty(size, np.float32)
    array.fill(0)
    return array


class Memory:
    """Arrays that a thread makes one after the other, and writes to before anyone else does."""

    def __init__(self, sizes: Sequence[int]) -> None:
        """Begin.

        Args:
            sizes: How many float32 each array has.
        """
        made: deque[np.ndarray | int] = deque()  # a size where there was no memory for it
        dropped = threading.Event()

        def make() -> None:
            for size in sizes:
                if dropped.is_set():
                    return
                try:
                    made.append(written(size))
                except MemoryError:  # which the owner shall hear of, and not wait for ever
                    made.append(size)

        self._made = made
        weakref.finalize(self, dropped.set)
        threads.start(make, "gscore-memory", cancel=dropped.set)

    @property
    def ready(self) -> bool:
        """Whether the next array is there."""
        return bool(self._made)

    def take(self) -> np.ndarray:
        """The next array, of zeros; only where it is `ready`.

        Raises:
            MemoryError: there was none in the thread, and there is none now.
        """
        made = self._made.popleft()
        return np.zeros(made, np.float32) if isinstance(made, int) else made
