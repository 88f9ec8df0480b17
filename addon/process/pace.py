"""Pace of a timer: work per step, larger where redraws are slow; no bpy."""

import time

FAST = 0.05
"""Lateness of a call up to which redraws count as fast, seconds."""
SHARE = 0.25
"""Share of further lateness for work beyond one step."""
LONGEST = 0.1
"""Upper limit of that work, seconds."""
_IDLE = 5e-4
"""Longest duration of a step without work, seconds."""


class Pace:
    """Time budget of a timer's calls.

    Blender calls timers between redraws: with one step per call, a hundred steps take a hundred
    redraws. The lateness of a call measures the duration of a redraw.
    """

    def __init__(self) -> None:
        """Initialise; the first call is never late."""
        self._due = float("inf")
        self._until = self._began = 0.0
        self.spare = 0.0
        """Seconds of this call beyond one step; 0 if redraws are fast."""

    def begin(self) -> None:
        """Note the start of a call."""
        self._began = time.monotonic()
        self.spare = min(SHARE * max(self._began - self._due - FAST, 0.0), LONGEST)
        self._until = self._began + self.spare

    def more(self, *, did: bool = False) -> bool:
        """True if this call has time for another step; call after each step.

        Args:
            did: True if the last step did any work, however short.
        """
        began, self._began = self._began, time.monotonic()
        return self._began < self._until and (did or self._began - began > _IDLE)

    def end(self, interval: float | None) -> None:
        """Note the end of a call and the delay of the next one, seconds; None: any."""
        if interval is None:
            self._due, self.spare = float("inf"), 0.0
        else:
            self._due = time.monotonic() + interval
