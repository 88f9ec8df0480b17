"""Level of detail of a view: all splats while it is still, fewer while it moves; no bpy."""

from dataclasses import dataclass

STILL = 0.25
"""Seconds without a change after which a view counts as still."""
BUDGET = 0.008
"""Seconds for splats in a redraw of a moving view: half of a frame at 60 frames per second."""
FEWEST = 5_000
"""Fewest splats drawn while a view moves, if there are as many."""
COARSEST = 4
"""Largest factor by which a moving view's picture is reduced."""
_NEAR = 0.6, 1.1
"""Shares of the budget between which nothing is changed."""
_STEP = 0.25, 2.0
"""Limits of the factor by which one measurement changes the number of splats."""
_EVERY = 8
"""One of this many redraws of a moving view is measured, because measuring waits for the card."""


@dataclass(frozen=True, kw_only=True)
class Detail:
    """Detail of one redraw."""

    count: int
    """Number of splats, from the start of the atlas."""
    factor: int
    """Factor by which each side of the picture is smaller than the view."""


@dataclass
class Level:
    """Level of detail of one view.

    Pixels are reduced together with splats: both cost time, and a picture with a quarter of the
    pixels needs only a quarter of the splats.
    """

    moving: bool = False
    share: float = 1.0
    """Share of the splats drawn while the view moves."""
    _total: int = 0
    _known: bool = False
    """Whether a redraw with this number of splats was measured."""
    _turn: int = 0
    _shown: bytes = b""
    _moved: float = float("-inf")

    def detail(self, now: float, shown: bytes, total: int) -> Detail:
        """Choose the detail of a redraw.

        Args:
            now: Monotonic seconds.
            shown: Key that changes with the view.
            total: Number of all splats of the view.
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
        """Whether this redraw should be measured for `took`."""
        return not self._known or (self.moving and self._turn % _EVERY == 0)

    def took(self, seconds: float) -> None:
        """Adapt to the time that the card needed for the last result of `detail`."""
        aim = BUDGET / max(seconds, 1e-6)
        self._known = True
        if not self.moving:
            self.share = min(1.0, aim)
        elif not _NEAR[0] < 1 / aim < _NEAR[1]:
            self.share = min(1.0, self.share * min(max(aim, _STEP[0]), _STEP[1]))
        self.share = max(self.share, self._count() / max(self._total, 1))

    @property
    def rests_at(self) -> float:
        """Monotonic seconds at which a moving view counts as still, unless it changes again."""
        return self._moved + STILL

    def _count(self) -> int:
        return min(self._total, max(FEWEST, int(self.share * self._total)))
