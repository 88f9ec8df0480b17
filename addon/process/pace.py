"""Pace of a timer: work per step, larger where redraws are slow; no bpy."""

import time

FAST = 0.05
"""Seconds by which a call may be late where redraws are fast."""
SHARE = 0.25
"""Of the lateness beyond that, what work may take besides one piece."""
LONGEST = 0.1
"""Seconds that this comes to at most."""
_IDLE = 5e-4
"""Seconds that a piece takes at most that had nothing to do."""


class Pace:
    """Of something that Blender calls when an interval has passed.

    Blender calls timers between two redraws: with one piece a call, work of a hundred pieces takes
    a hundred redraws. How late a call comes is how long redraws take.
    """

    def __init__(self) -> None:
        """The first call is not late."""
        self._due = float("inf")
        self._until = self._began = 0.0
        self.spare = 0.0
        """Seconds that this call may take besides one piece; 0 where redraws are fast."""

    def begin(self) -> None:
        """A call comes."""
        self._began = time.monotonic()
        self.spare = min(SHARE * max(self._began - self._due - FAST, 0.0), LONGEST)
        self._until = self._began + self.spare

    def more(self, *, did: bool = False) -> bool:
        """Whether this call shall do another piece; asked after each.

        Args:
            did: Whether the last one is known to have done something, however short it was.
        """
        began, self._began = self._began, time.monotonic()
        return self._began < self._until and (did or self._began - began > _IDLE)

    def end(self, interval: float | None) -> None:
        """The call ends, and the next one should come after so many seconds; None: whenever."""
        if interval is None:
            self._due, self.spare = float("inf"), 0.0
        else:
            self._due = time.monotonic() + interval
