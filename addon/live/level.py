"""How many splats a view draws: all of them while it stands still, fewer while it moves; no bpy."""

from dataclasses import dataclass

STILL = 0.25
"""Seconds without a change after which a view stands still."""
FIRST = 250_000
"""Splats drawn while a view moves for the first time."""
FEWEST = 20_000
_SLOW, _QUICK = 1 / 15, 1 / 40
"""Seconds between two redraws above which fewer are drawn, and below which more are."""


@dataclass
class Level:
    """Of one view."""

    moving: bool = False
    count: int = FIRST
    _shown: bytes = b""
    _moved: float = float("-inf")
    _drawn: float = float("-inf")

    def look(self, now: float, shown: bytes, total: int) -> int:
        """How many of `total` splats to draw.

        Args:
            now: Monotonic seconds.
            shown: Differs where the view does.
            total: All splats of the view.
        """
        moved = shown != self._shown and self._shown != b""
        if moved and self.moving:
            self._adapt(now - self._drawn, total)
        if moved:
            self._moved = now
        self._shown, self._drawn = shown, now
        self.moving = now - self._moved < STILL
        return min(self.count, total) if self.moving else total

    @property
    def rests_at(self) -> float:
        """Monotonic seconds at which a view that moves stands still, unless it changes again."""
        return self._moved + STILL

    def _adapt(self, took: float, total: int) -> None:
        if took > _SLOW:
            self.count = max(FEWEST, int(min(self.count, total) * max(0.5, _SLOW / took)))
        elif took < _QUICK:
            self.count = min(max(total, FEWEST), int(self.count * 1.25))
