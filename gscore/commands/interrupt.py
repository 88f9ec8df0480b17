"""Ctrl-C and SIGTERM: the first asks for a checkpoint and an end, the second ends at once."""

import os
import signal
from types import FrameType
from typing import Any, Self

from ..trainer import Control

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupt:
    """Turns signals into requests to `control` for the duration of a block."""

    def __init__(self, control: Control) -> None:
        self._control = control
        self._before: dict[signal.Signals, Any] = {}
        self._received = 0

    @property
    def exit_code(self) -> int:
        """128 + the signal that came, as shells expect; 0 if none did."""
        return 128 + self._received if self._received else 0

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
        self._control.stop("interrupted")
