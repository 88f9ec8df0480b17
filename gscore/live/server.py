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
from ..events import Decision
from ..live_options import LiveOptions
from . import viewer_protocol
from .viewer_clients import ViewerClient, ViewerClients

MOST_VIEWERS = 8
"""Maximum number of connected viewers."""
PATIENCE = 20.0
"""Timeout in seconds for the rest of a request and for sending an answer, and idle time after which
a new viewer may replace this one."""
_REST = 0.5
"""Seconds before accepting again after an error."""
_KEEPALIVE = {"TCP_KEEPIDLE": 60, "TCP_KEEPALIVE": 60, "TCP_KEEPINTVL": 10, "TCP_KEEPCNT": 3}
"""Idle seconds, under its names on Linux and macOS; seconds between probes; number of probes."""
_NO_LINGERING = struct.pack("hh" if os.name == "nt" else "ii", 1, 0)

_log = logging.getLogger(__name__)


class Server:
    """Server that listens inside a `with` block; the training answers `viewers`."""

    def __init__(
        self, options: LiveOptions, *, text: str = "", after_the_end: bool = False
    ) -> None:
        """Bind the port.

        Args:
            options: Address and port.
            text: Sent with each answer: the folder in which viewers look for the capture.
            after_the_end: Viewers may stay after the last step.

        Raises:
            ConfigError: the port is in use or not permitted, or this computer lacks the address.
        """
        self._options = options
        text_of_port = f"Viewers can connect to {options.ip}, port {options.port}."
        self.viewers = ViewerClients(
            decision=Decision("viewer", text_of_port), after_the_end=after_the_end
        )
        """Connected viewers."""
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
                f"ip must be a numeric address, such as 127.0.0.1 or 0.0.0.0, got {ip!r:.60}."
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
                "training may use it; choose another `--port`, or leave `--port` out."
            ) from error
        return listening

    def _accept(self) -> None:
        warned = False
        while not self.viewers.closed:
            try:
                connection, _ = self._socket.accept()
                self._admit(connection)
            except ConnectionError:  # of that one connection (ECONNABORTED), not of the listener
                continue
            except (OSError, RuntimeError) as error:  # too many files, too many threads
                if self.viewers.closed:
                    return
                if not warned:
                    _log.warning("A viewer cannot connect: %s", error)
                    warned = True
                time.sleep(_REST)

    def _admit(self, connection: socket.socket) -> None:
        """Serve a viewer in a thread; if there are too many, it replaces an idle one or is refused.

        Raises:
            RuntimeError: no thread can be started.
        """
        one = self.viewers.enter(MOST_VIEWERS) or self._replace_idle()
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
            self._disconnect(connection, one)
            raise

    def _replace_idle(self) -> ViewerClient | None:
        idle = self.viewers.longest_idle(PATIENCE)
        if idle is None:
            return None
        with self._lock:
            theirs = [c for c, one in self._connections.items() if one is idle]
        for connection in theirs:
            _shut(connection)  # its thread ends, and closes it
        self.viewers.leave(idle)
        return self.viewers.enter(MOST_VIEWERS)

    def _disconnect(self, connection: socket.socket, one: ViewerClient) -> None:
        self.viewers.leave(one)
        with self._lock:
            self._connections.pop(connection, None)
        connection.close()

    def _serve(self, connection: socket.socket, one: ViewerClient) -> None:
        """Answer until the viewer disconnects, sends an invalid request, or stops receiving."""
        try:
            _keep_alive(connection)  # fails on macOS where the connection was reset already
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            while True:
                request = viewer_protocol.parse(_request(connection))
                picture = one.request_picture(request)
                if picture is None:
                    return
                connection.settimeout(PATIENCE)  # for a whole answer, not for each piece
                connection.sendall(viewer_protocol.answer(picture, self._text))
        except TimeoutError:
            _discard_unsent(connection)
        except (OSError, ValueError):
            return
        finally:
            self._disconnect(connection, one)


def _request(connection: socket.socket) -> bytes:
    """The text of the next request; only the wait for its first byte has no timeout."""
    connection.settimeout(None)
    head = connection.recv(1)
    end = time.monotonic() + PATIENCE  # for the whole request, not for each piece
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
    """Enable TCP keepalive probes, because a broken link does not close the connection."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in _KEEPALIVE.items():
        option = getattr(socket, name, None)  # no option exists on all systems
        if option is not None:
            connection.setsockopt(socket.IPPROTO_TCP, option, value)


def _discard_unsent(connection: socket.socket) -> None:
    """Discard unsent data on close, because the system would send it for minutes to a viewer that
    receives a few bytes per second."""
    with contextlib.suppress(OSError):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _NO_LINGERING)


def _shut(connection: socket.socket) -> None:
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)  # wakes the thread that blocks on it


def _end(connection: socket.socket) -> None:
    _shut(connection)
    connection.close()
