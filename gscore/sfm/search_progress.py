"""Search progress: events, warnings and remaining time of a camera search."""

import math
import time
from collections.abc import Callable

from ..events import SfmProgress, Show, Warn, seconds_left
from .forecast import Forecast


class SearchProgress:
    """Progress of one camera search, sent as events.

    Args:
        show: Receiver of the events.
    """

    def __init__(self, show: Show) -> None:
        self.show = show
        self.forecast: Forecast | None = None
        """Forecast of the current attempt; None before the first."""
        self.warnings: list[str] = []
        """Messages of all `Warn` events so far."""

    def warn(self, sentence: str) -> None:
        """Record a warning and send it."""
        self.warnings.append(sentence)
        self.show(Warn(message=sentence))

    def counter(self, phase: str, total: int, before: int = 0) -> Callable[..., None]:
        """A function of the items done and the items in progress that reports a phase.

        Args:
            phase: Name of the phase.
            total: Number of its items.
            before: Items done earlier; the remaining time is extrapolated from the others.
        """
        began = time.monotonic()

        def count(done: int, under_way: int = 0) -> None:
            eta = seconds_left(began, done - before, total - before)
            self.report(phase, done, total, eta, under_way)

        return count

    def report(
        self, phase: str, done: int, total: int, eta: float = math.nan, under_way: int = 0
    ) -> None:
        """Send `SfmProgress`, with the remaining seconds of the search by the forecast.

        Args:
            phase: Name of the phase.
            done: Items done.
            total: Number of items; 0: unknown.
            eta: Remaining seconds of the phase; NaN: unknown.
            under_way: Items in progress in one piece, whose progress is unknown.
        """
        left = share = math.nan
        if self.forecast is not None:
            whole = max(total, 1)
            left = self.forecast.left(phase, done / whole, under_way / whole)
            share = self.forecast.share
        self.show(
            SfmProgress(phase=phase, done=done, total=total, eta_s=eta, left_s=left, share=share)
        )
