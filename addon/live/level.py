"""Level of detail of a view: all splats while it is still, fewer while it moves; no bpy."""

from dataclasses import dataclass

STILL = 0.25
"""Seconds without a change after which a view stands still."""
BUDGET = 0.008
"""Seconds that splats may take of a redraw while a view moves: half of what 60 a second leave."""
FEWEST = 5_000
"""Splats drawn while a view moves, where there are as many."""
COARSEST = 4
"""Largest factor by which a moving view's picture is smaller."""
_NEAR = 0.6, 1.1
"""Shares of the budget between which nothing is changed."""
_STEP = 0.25, 2.0
"""Factors by which one measurement changes how much is drawn, at most."""
_EVERY = 8
"""Redraws of a moving view of which one is measured: that waits for the card."""


@dataclass(frozen=True, kw_only=True)
class Detail:
    """Of one redraw."""

    count: int
    """Splats: the first of the atlas."""
    factor: int
    """How many times fewer pixels a side than the view has."""


@dataclass
class Level:
    """Of one view.

    Pixels become fewer as splats do: a picture of a quarter of the pixels gets along with a quarter
    of the splats, and each costs time.
    """

    moving: bool = False
    share: float = 1.0
    """Of the splats, while the view moves."""
    _total: int = 0
    _known: bool = False
    """Whether anything was measured of so many splats."""
    _turn: int = 0
    _shown: bytes = b""
    _moved: float = float("-inf")

    def look(self, now: float, shown: bytes, total: int) -> Detail:
        """What to draw.

        Args:
            now: Monotonic seconds.
            shown: Differs where the view does.
            total: All splats of the view.
        """
        if total != self._total:
            self._total, self._known = total, False
        if shown != self._shown and self._shown != b"":
            self._moved = now
            self._turn += 1
        self._shown = shown
        self.moving = now - self._moved < STILL
        if not self.moving:
            return Detail(count=total, factor=1)
        factor = min(COARSEST, max(1, round(self.share**-0.5)))
        return Detail(count=self._count(), factor=factor)

    @property
    def measures(self) -> bool:
        """Whether `took` wants to know of this redraw."""
        return not self._known or (self.moving and self._turn % _EVERY == 0)

    def took(self, seconds: float) -> None:
        """Adapt to what the card needed for what `look` said last."""
        aim = BUDGET / max(seconds, 1e-6)
        self._known = True
        if not self.moving:
            self.share = min(1.0, aim)
        elif not _NEAR[0] < 1 / aim < _NEAR[1]:
            self.share = min(1.0, self.share * min(max(aim, _STEP[0]), _STEP[1]))
        self.share = max(self.share, self._count() / max(self._total, 1))

    @property
    def rests_at(self) -> float:
        """Monotonic seconds at which a view that moves stands still, unless it changes again."""
        return self._moved + STILL

    def _count(self) -> int:
        return min(self._total, max(FEWEST, int(self.share * self._total)))
