"""Straggler monitor: finds the rank that the others wait for."""

from collections.abc import Sequence

import numpy as np

_BATCHES = 20
_SECONDS = 10.0
"""What is compared goes over so many batches and so many seconds of work of the slowest: in fewer,
chance decides."""
_MUCH = 1.5
"""Times what the others work, from which on a rank is told to be slow."""


class StragglerMonitor:
    """Compares how long the ranks work on the batches of a training."""

    def __init__(self, hosts: Sequence[str]) -> None:
        """`hosts`: of the ranks, for the sentence."""
        self._hosts = hosts
        self._told: set[int] = set()
        self._before: np.ndarray | None = None
        self._batches = 0

    def met(self, worked: np.ndarray) -> str:
        """A sentence about a rank for which the others wait; empty mostly.

        Args:
            worked: [N] seconds that each rank has worked on all batches so far. Called once a
                batch.
        """
        self._batches += 1
        if self._before is None:
            self._before, self._batches = worked.copy(), 0
            return ""
        lately = worked - self._before
        if self._batches < _BATCHES or lately.max() < _SECONDS:
            return ""
        self._before, self._batches = worked.copy(), 0
        return self._slow(lately)

    def _slow(self, worked: np.ndarray) -> str:
        rank = int(worked.argmax())
        others = float(np.median(np.delete(worked, rank)))
        if worked[rank] < _MUCH * others or rank in self._told:
            return ""
        self._told.add(rank)
        return (
            f"All wait for rank {rank} ({self._hosts[rank]}), which works "
            f"{min(worked[rank] / max(others, 1e-9), 99):.1f} times as long on its photos as the "
            "others. Look at what else its machine does, and at the threads that it has."
        )
