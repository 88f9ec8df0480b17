"""Viewer server, the only file that opens a port: one thread per connected viewer."""

import contextlib
import logging
import os
import socket
import struct
import threading
import time
from typing import Self

from ..errors import ConfigError
from ..live_options import LiveOptions
from . import viewer_protocol
from .viewer_clients import ViewerClient, ViewerClients

MOST_VIEWERS = 8
"""Viewers at once."""
PATIENCE = 20.0
"""Seconds for the rest of a request that has begun, and for taking an answer; and of silence, after
which another viewer may have the place."""
_REST = 0.5
"""Seconds before another try to let somebody in."""
_KEEPING = {"TCP_KEEPIDLE": 60, "TCP_KEEPALIVE": 60, "TCP_KEEPINTVL": 10, "TCP_KEEPCNT": 3}
"""Seconds of silence, by its names on Linux and macOS; seconds between questions; how many."""
_NO_LINGERING = struct.pack("hh" if os.name == "nt" else "ii", 1, 0)

_log = logging.getLogger(__name__)


class Server:
    """Listens in a `with`; the training answers `viewers`."""

    def __init__(
        self, options: LiveOptions, *, text: str = "", after_the_end: bool = False
    ) -> None:
        """Take the port.

        Args:
            options: Address and port.
            text: Told with each answer: viewers look for the capture there.
            after_the_end: Viewers may look on when the last step is done.

        Raises:
            ConfigError: the port is taken or may not be used, or this computer has no such address.
        """
        self._options = options
        why = f"Viewers can connect to {options.ip}, port {options.port}."
        self.viewers = ViewerClients(why=why, after_the_end=after_the_end)
        """Who watches."""
        self._text = text
        self._socket = self._listening()
        self._connections: dict[socket.socket, ViewerClient] = {}
        self._lock = threading.Lock()

    def __enter__(self) -> Self:
        threading.Thread(target=self._accept, name="gscore-live", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.viewers.close()
        with self._lock:
            for connection in (self._socket, *self._connections):
                _end(connection)

    def _listening(self) -> socket.socket:
        ip, port = self._options.ip, self._options.port
        try:
            family, *_, place = socket.getaddrinfo(
                ip, port, type=socket.SOCK_STREAM, flags=socket.AI_NUMERICHOST
            )[0]
            listening = socket.socket(family, socket.SOCK_STREAM)
        except (OSError, UnicodeError) as error:
            raise ConfigError(
                f"ip must be an address of numbers, such as 127.0.0.1 or 0.0.0.0, got {ip!r:.60}."
            ) from error
        try:
            # A port that a training has just left can be taken again; one in use cannot. Windows
            # takes the first for the second.
            alone = getattr(socket, "SO_EXCLUSIVEADDRUSE", None)
            option = socket.SO_REUSEADDR if alone is None else alone
            listening.setsockopt(socket.SOL_SOCKET, option, 1)
            listening.bind(place)
            # A client whose SYN finds no place in the queue tries again only after 1 s, 2 s, 4 s.
            listening.listen(socket.SOMAXCONN)
        except OSError as error:
            listening.close()
            raise ConfigError(
                f"Viewers cannot connect to {ip}, port {port}: {error.strerror or error}. Another "
                "training may use it; choose another --port, or leave --port out."
            ) from error
        return listening

    def _accept(self) -> None:
        told = False
        while not self.viewers.closed:
            try:
                connection, _ = self._socket.accept()
                self._admit(connection)
            except ConnectionError:  # of that one connection (ECONNABORTED), not of the listener
                continue
            except (OSError, RuntimeError) as error:  # too many files, too many threads
                if self.viewers.closed:
                    return
                if not told:
                    _log.warning("A viewer cannot connect: %s", error)
                    told = True
                time.sleep(_REST)

    def _admit(self, connection: socket.socket) -> None:
        """Serve a viewer in a thread; one too many takes the place of one that has fallen silent,
        or is let go.

        Raises:
            RuntimeError: there can be no thread more.
        """
        one = self.viewers.enter(MOST_VIEWERS) or self._in_place_of_a_silent_one()
        if one is None:
            connection.close()
            return
        with self._lock:
            self._connections[connection] = one
        try:
            threading.Thread(
                target=self._serve, args=(connection, one), name="gscore-viewer", daemon=True
            ).start()
        except RuntimeError:
            self._let_go(connection, one)
            raise

    def _in_place_of_a_silent_one(self) -> ViewerClient | None:
        silent = self.viewers.longest_silent(PATIENCE)
        if silent is None:
            return None
        with self._lock:
            theirs = [c for c, one in self._connections.items() if one is silent]
        for connection in theirs:
            _shut(connection)  # its thread ends, and closes it
        self.viewers.leave(silent)
        return self.viewers.enter(MOST_VIEWERS)

    def _let_go(self, connection: socket.socket, one: ViewerClient) -> None:
        self.viewers.leave(one)
        with self._lock:
            self._connections.pop(connection, None)
        connection.close()

    def _serve(self, connection: socket.socket, one: ViewerClient) -> None:
        """Answer until the viewer goes, says what no viewer says, or does not take its answers."""
        try:
            _keep_alive(connection)  # fails on macOS where the connection was reset already
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            while True:
                request = viewer_protocol.parse(_request(connection))
                picture = one.ask(request)
                if picture is None:
                    return
                connection.settimeout(PATIENCE)  # for all of an answer, not for each piece
                connection.sendall(viewer_protocol.answer(picture, self._text))
        except TimeoutError:
            _drop_what_waits(connection)
        except (OSError, ValueError):
            return
        finally:
            self._let_go(connection, one)


def _request(connection: socket.socket) -> bytes:
    """The text of the next request, for which one may wait for ever; not for its rest."""
    connection.settimeout(None)
    head = connection.recv(1)
    end = time.monotonic() + PATIENCE  # for all of it, not for each piece
    head += _exactly(connection, viewer_protocol.LENGTH - len(head), end)
    return _exactly(connection, viewer_protocol.length_of(head), end)


def _exactly(connection: socket.socket, count: int, end: float) -> bytes:
    found = b""
    while len(found) < count:
        connection.settimeout(max(end - time.monotonic(), 0.001))
        piece = connection.recv(count - len(found))
        if not piece:
            raise ConnectionError("the viewer is gone")
        found += piece
    return found


def _keep_alive(connection: socket.socket) -> None:
    """Have the system ask a silent viewer whether it is still there: a cable that was pulled out
    says nothing."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in _KEEPING.items():
        option = getattr(socket, name, None)  # none of them is everywhere
        if option is not None:
            connection.setsockopt(socket.IPPROTO_TCP, option, value)


def _drop_what_waits(connection: socket.socket) -> None:
    """Close without what was not sent yet: to a viewer that takes a few bytes a second, the system
    would go on sending it for minutes."""
    with contextlib.suppress(OSError):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _NO_LINGERING)


def _shut(connection: socket.socket) -> None:
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)  # wakes the thread that waits in it


def _end(connection: socket.socket) -> None:
    _shut(connection)
    connection.close()
