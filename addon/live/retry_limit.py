"""Retry limit: number of graphics card failures before live drawing is paused; no bpy, no gpu."""

from dataclasses import dataclass

PAUSES = (0.25, 1.0, 4.0)
"""Seconds after the first and further failures until it is asked again."""
FORGIVEN = 60.0
"""Seconds without a failure after which they are counted anew."""


@dataclass
class Attempts:
    """Of a session."""

    count: int = 0
    """Failures in a row."""
    rests_until: float = float("-inf")
    """Monotonic seconds before which nothing is drawn."""

    def failed(self, now: float) -> float | None:
        """Note a failure.

        Args:
            now: Monotonic seconds.

        Returns:
            Seconds to rest; None: there is no use in asking again.
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
        """Whether nothing is to be drawn."""
        return now < self.rests_until
