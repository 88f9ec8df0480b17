"""Straggler monitor: finds the rank that the others wait for."""

from collections.abc import Sequence

import numpy as np

_BATCHES = 20
_SECONDS = 10.0
"""Least batches and seconds of work of the slowest rank in a comparison; fewer are noise."""
_SLOW = 1.5
"""Work of a rank relative to the median of the others, from which it is reported as slow."""


class StragglerMonitor:
    """Compares how long the ranks work on the batches of a training."""

    def __init__(self, hosts: Sequence[str]) -> None:
        """`hosts`: Host names of the ranks, for the message."""
        self._hosts = hosts
        self._reported: set[int] = set()
        self._before: np.ndarray | None = None
        self._batches = 0

    def straggler_message(self, worked: np.ndarray) -> str:
        """Return a message about a rank that the others wait for, or an empty string.

        Args:
            worked: [N] total seconds of work of each rank. Call this once per batch.
        """
        self._batches += 1
        if self._before is None:
            self._before, self._batches = worked.copy(), 0
            return ""
        recent = worked - self._before
        if self._batches < _BATCHES or recent.max() < _SECONDS:
            return ""
        self._before, self._batches = worked.copy(), 0
        return self._slow(recent)

    def _slow(self, worked: np.ndarray) -> str:
        rank = int(worked.argmax())
        others = float(np.median(np.delete(worked, rank)))
        if worked[rank] < _SLOW * others or rank in self._reported:
            return ""
        self._reported.add(rank)
        return (
            f"All wait for rank {rank} ({self._hosts[rank]}), which works "
            f"{min(worked[rank] / max(others, 1e-9), 99):.1f} times as long on its photos as the "
            "others. Check the load of its machine and its number of threads."
        )
