"""Viewer clients of a training: their frame requests, answered between two steps."""

import contextlib
import logging
import threading
import time
from collections.abc import Callable

from ..errors import GsError
from ..events import Decision
from .viewer_protocol import FrameRequest

_log = logging.getLogger(__name__)

HOLD = 60.0
"""Seconds for which a request pauses the training, or delays its end; viewers send many requests
per
second."""
Draw = Callable[[FrameRequest], bytes]
"""Renders the picture of a request, 3 bytes per pixel."""


def _drawn(draw: Draw, request: FrameRequest) -> bytes:
    """The picture, black if rendering fails, because a viewer must not end a training."""
    try:
        return draw(request)
    except (GsError, MemoryError) as error:
        _log.warning("A picture for a viewer could not be drawn: %s", error)
        return bytes(3 * request.width * request.height)


class ViewerClient:
    """One viewer: its connection's thread waits in `request_picture` until the training's thread
    answers."""

    def __init__(self, clients: "ViewerClients") -> None:
        self._crowd = clients
        self._answered = threading.Event()
        self._picture = b""
        self.request: FrameRequest | None = None
        """Pending frame request."""
        self.waits = False
        """Whether its last request has no answer yet."""
        self.trains, self.stays = True, False
        """Flags of its last request."""
        self.last_request = time.monotonic()
        """Time of its last request, or of its connection; seconds of the monotonic clock."""

    def request_picture(self, request: FrameRequest) -> bytes | None:
        """Request a picture and wait until the training has drawn it; None: the training ended."""
        self.trains, self.stays = request.trains, request.stays
        self.last_request = time.monotonic()
        self._answered.clear()
        self.request, self.waits = request, True
        self._crowd.wake()
        if not self._crowd.closed:  # after that no answer would arrive
            self._answered.wait()
        self.waits = False
        return None if self._crowd.closed else self._picture

    def answer(self, picture: bytes) -> None:
        """Make `request_picture` return `picture`."""
        self._picture = picture
        self._answered.set()


class ViewerClients:
    """All connected viewers. Without any, `answer` reads one attribute."""

    def __init__(self, *, decision: Decision | None = None, after_the_end: bool = False) -> None:
        """`after_the_end`: viewers may stay after the last step."""
        self.decision = decision
        """Message on how viewers connect; None: no port is open."""
        self._after_the_end = after_the_end
        self._all: list[ViewerClient] = []
        self._lock = threading.Lock()
        self._requested = threading.Event()
        self._rest = 0.0
        self.closed = False
        """Whether requests receive no answer any more."""

    def enter(self, most: int) -> ViewerClient | None:
        """Add a viewer; None: there are `most` already, or the server is closed."""
        with self._lock:
            if self.closed or len(self._all) >= most:
                return None
            self._all.append(ViewerClient(self))
            return self._all[-1]

    def leave(self, one: ViewerClient) -> None:
        """Remove a viewer, if it was not removed before."""
        with self._lock, contextlib.suppress(ValueError):
            self._all.remove(one)

    def wake(self) -> None:
        """Signal that a frame request is waiting."""
        self._requested.set()

    def longest_idle(self, seconds: float) -> ViewerClient | None:
        """The viewer idle for longest, and for at least `seconds`; one with a pending request is
        not idle."""
        until = time.monotonic() - seconds
        with self._lock:
            idle = [one for one in self._all if not one.waits and one.last_request <= until]
        return min(idle, key=lambda one: one.last_request, default=None)

    @property
    def has_pausing_viewer(self) -> bool:
        """Whether a recent request pauses the training; recent, because a broken connection looks
        like an idle one."""
        return any(not one.trains for one in self._recent())

    @property
    def stay(self) -> bool:
        """Whether a recent request keeps the server alive after the last step."""
        return self._after_the_end and any(one.stays for one in self._recent())

    def _recent(self) -> list[ViewerClient]:
        """Viewers with a request in the last minute, or a pending one."""
        since = time.monotonic() - HOLD
        return [one for one in list(self._all) if one.waits or one.last_request > since]

    def answer(self, draw: Draw, *, idle: bool = False) -> None:
        """Answer the pending request of each viewer.

        Args:
            draw: Called in this thread.
            idle: No training step is waiting; if False, drawing pauses for as long as it
                took, so it takes at most half of the time.
        """
        if not self._requested.is_set() or (not idle and time.monotonic() < self._rest):
            return
        self._requested.clear()
        began = time.monotonic()
        for one in list(self._all):
            request, one.request = one.request, None
            if request is not None:
                one.answer(_drawn(draw, request) if request.width else b"")
        ended = time.monotonic()
        self._rest = ended + (ended - began)

    def close(self) -> None:
        """Disconnect all viewers."""
        with self._lock:
            self.closed = True
            for one in self._all:
                one.answer(b"")
