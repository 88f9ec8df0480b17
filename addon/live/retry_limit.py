"""Retry limit: number of graphics card failures before live drawing is paused; no bpy, no gpu."""

from dataclasses import dataclass

PAUSES = (0.25, 1.0, 4.0)
"""Seconds until the next attempt, after the first and further failures."""
FORGIVEN = 60.0
"""Seconds without a failure after which the count starts again."""


@dataclass
class Attempts:
    """Attempts of a session to draw live."""

    count: int = 0
    """Consecutive failures."""
    rests_until: float = float("-inf")
    """Monotonic seconds before which nothing is drawn."""

    def failed(self, now: float) -> float | None:
        """Count a failure.

        Args:
            now: Monotonic seconds.

        Returns:
            Seconds to wait; None: do not try again.
        """
        if now - self.rests_until > FORGIVEN:
            self.count = 0
        self.count += 1
        if self.count > len(PAUSES):
            return None
        pause = PAUSES[self.count - 1]
        self.rests_until = now + pause
        return pause

    def rests(self, now: float) -> bool:
        """Whether live drawing is paused."""
        return now < self.rests_until
