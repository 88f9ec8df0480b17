"""Viewer clients of a training: their frame requests, answered between two steps."""

import contextlib
import logging
import threading
import time
from collections.abc import Callable

from ..errors import GsError
from .viewer_protocol import FrameRequest

_log = logging.getLogger(__name__)

HOLD = 60.0
"""Seconds for which a request holds the training, or keeps it from ending; viewers ask
many times a second."""
Draw = Callable[[FrameRequest], bytes]
"""Gives the picture of a request, 3 bytes a pixel."""


def _drawn(draw: Draw, request: FrameRequest) -> bytes:
    """The picture, black where there is too little memory for it: no viewer ends a training."""
    try:
        return draw(request)
    except (GsError, MemoryError) as error:
        _log.warning("A picture for a viewer could not be drawn: %s", error)
        return bytes(3 * request.width * request.height)


class ViewerClient:
    """One viewer: the thread of its connection waits in `ask`, the training's answers."""

    def __init__(self, crowd: "ViewerClients") -> None:
        self._crowd = crowd
        self._answered = threading.Event()
        self._picture = b""
        self.request: FrameRequest | None = None
        """Frame requests without an answer."""
        self.waits = False
        """Whether its last request has no answer yet."""
        self.trains, self.stays = True, False
        """From its last request."""
        self.asked_at = time.monotonic()
        """When that came, or else the viewer, seconds of the monotonic clock."""

    def ask(self, request: FrameRequest) -> bytes | None:
        """The picture, as soon as the training has drawn it; None: the training is over."""
        self.trains, self.stays = request.trains, request.stays
        self.asked_at = time.monotonic()
        self._answered.clear()
        self.request, self.waits = request, True
        self._crowd.wake()
        if not self._crowd.closed:  # else nobody is there who would answer
            self._answered.wait()
        self.waits = False
        return None if self._crowd.closed else self._picture

    def answer(self, picture: bytes) -> None:
        """Let `ask` return."""
        self._picture = picture
        self._answered.set()


class ViewerClients:
    """All connected viewers. Without any, `answer` reads one attribute."""

    def __init__(self, *, why: str = "", after_the_end: bool = False) -> None:
        """`after_the_end`: they may look on when the last step is done."""
        self.why = why
        """A sentence on how they come here."""
        self._after_the_end = after_the_end
        self._all: list[ViewerClient] = []
        self._lock = threading.Lock()
        self._asked = threading.Event()
        self._rest = 0.0
        self.closed = False
        """Requests receive no answer any more."""

    def enter(self, most: int) -> ViewerClient | None:
        """Another one; None: there are as many as there may be, or it is over."""
        with self._lock:
            if self.closed or len(self._all) >= most:
                return None
            self._all.append(ViewerClient(self))
            return self._all[-1]

    def leave(self, one: ViewerClient) -> None:
        """One does not watch any more; nothing where it has left before."""
        with self._lock, contextlib.suppress(ValueError):
            self._all.remove(one)

    def wake(self) -> None:
        """Signal that a frame request is waiting."""
        self._asked.set()

    def longest_silent(self, seconds: float) -> ViewerClient | None:
        """Who has not asked for longest, and for at least so long; nobody who waits for an answer
        is silent."""
        until = time.monotonic() - seconds
        with self._lock:
            silent = [one for one in self._all if not one.waits and one.asked_at <= until]
        return min(silent, key=lambda one: one.asked_at, default=None)

    @property
    def hold(self) -> bool:
        """Whether somebody wants the training to wait, and has lately said so: a connection that
        was cut somewhere on the way looks like one that is silent."""
        return any(not one.trains for one in self._lately())

    @property
    def stay(self) -> bool:
        """Whether somebody wants to look on after the last step, and has lately said so."""
        return self._after_the_end and any(one.stays for one in self._lately())

    def _lately(self) -> list[ViewerClient]:
        """Who has asked within the last minute, or waits for an answer since."""
        since = time.monotonic() - HOLD
        return [one for one in list(self._all) if one.waits or one.asked_at > since]

    def answer(self, draw: Draw, *, at_leisure: bool = False) -> None:
        """Draw what is asked for, for each at most once.

        Args:
            draw: Called in this thread.
            at_leisure: No step waits for this; else drawing rests as long as it took, so that it
                takes half of the time at most.
        """
        if not self._asked.is_set() or (not at_leisure and time.monotonic() < self._rest):
            return
        self._asked.clear()
        began = time.monotonic()
        for one in list(self._all):
            request, one.request = one.request, None
            if request is not None:
                one.answer(_drawn(draw, request) if request.width else b"")
        ended = time.monotonic()
        self._rest = ended + (ended - began)

    def close(self) -> None:
        """Let go of everybody."""
        with self._lock:
            self.closed = True
            for one in self._all:
                one.answer(b"")
