"""Ctrl-C and SIGTERM: the first asks the work to end in good order, the second ends at once."""

import os
import signal
from collections.abc import Callable
from types import FrameType
from typing import Any, Self

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupt:
    """Remembers signals for the duration of a block; the first also calls `stop`, if given."""

    def __init__(self, stop: Callable[[], None] | None = None) -> None:
        self._stop = stop
        self._before: dict[signal.Signals, Any] = {}
        self._received = 0

    @property
    def exit_code(self) -> int:
        """128 + the signal that came, as shells expect; 0 if none did."""
        return 128 + self._received if self._received else 0

    @property
    def received(self) -> bool:
        """Whether a signal came."""
        return self._received != 0

    def __enter__(self) -> Self:
        for number in _SIGNALS:
            self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._received:
            os._exit(128 + number)
        self._received = number
        if self._stop is not None:
            self._stop()
