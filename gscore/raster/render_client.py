"""Render client: draws in a render server, a process of its own that may crash without harm."""

import contextlib
import hashlib
import threading
import time
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np

from ..errors import Cancelled, ShapeError
from . import arguments
from .header import TILE
from .render_messages import (
    LIST,
    Message,
    NoDeviceError,
    RenderServerError,
    encoded,
    place_arrays,
)
from .render_process import ServerProcess
from .request import CancelFlag, Frustum, Settings

PART = 8 << 20
"""Numbers of an array that are sent together."""
START_SECONDS = 180.0
"""Time limit of the start, in which a driver compiles and a new device is tested."""
_CANCEL_SECONDS = 2.0
"""Time limit of a cancelled drawing, after which its server is killed."""
_IDLE_ENDS = 3
"""Servers that may end for want of requests before one draws."""
_PERIOD = 0.02
"""Seconds between two checks of a cancel flag."""


class RenderClient:
    """Draws on a device in a render server, which starts when it is first needed. Threads take
    turns."""

    def __init__(
        self,
        device: str,
        *,
        seconds: float = 60.0,
        idle: float = 60.0,
        folder: str | None = None,
    ) -> None:
        """Initialise; nothing is started yet.

        Args:
            device: As for `open_device`.
            seconds: Time limit of a picture, after which the server is killed.
            idle: Seconds without pictures after which the server ends.
            folder: Folder of the file through which arrays pass; None: the temporary one.
        """
        self.device, self._seconds, self._idle, self._folder = device, seconds, idle, folder
        self._lock = threading.Lock()
        self._server: ServerProcess | None = None
        self.status = ""
        """A sentence on what the server does at the moment, if it takes long."""
        self.sent = 0
        """Number of arrays of splats sent so far."""
        self.started = 0
        """Number of servers started so far."""

    @property
    def pid(self) -> int | None:
        """Process id of the server; None: none runs."""
        server = self._server
        return None if server is None else server.process.pid

    def forward(
        self,
        splats: Sequence[np.ndarray],
        view: Frustum,
        settings: Settings,
        pictures: Mapping[str, np.ndarray],
        **_: object,
    ) -> dict[str, float]:
        """Draw as `Raster.forward` does; with `settings.tiles` only the rectangle around them is
        written.

        Splats are sent if the server does not know them. Their arrays must not change after they
        were drawn.

        Returns:
            The server's `Raster.stats`.

        Raises:
            RenderServerError: the device or the server failed; the server has ended.
            ShapeError: an array or a setting is invalid.
            Cancelled: `settings.cancel` was set.
        """
        # Checked here, because both processes trust the sizes.
        arguments.splats(splats, settings)
        arguments.view(view, settings, arguments.evaluated_degree(splats[5], settings))
        arguments.host(view, settings)
        arguments.image(pictures, view, settings.outputs, len(splats[0]))
        cancel = settings.cancel or CancelFlag()
        with self._turn(cancel):
            for _attempt in range(_IDLE_ENDS):
                with contextlib.suppress(_IdleEndError):
                    return self._drawn(splats, view, settings, pictures, cancel)
                self._kill()  # it ended at the moment of the request: a new one draws
            return self._drawn(splats, view, settings, pictures, cancel)

    def first_answer(self) -> Message:
        """Start the server, and return its first answer.

        Raises:
            RenderServerError: it cannot be started, or has failed.
        """
        with self._turn(CancelFlag()):
            return self._running(CancelFlag()).facts or {}

    def close(self) -> None:
        """End the server; a drawing in it fails. It starts again when it is needed."""
        server = self._server
        if server is not None:
            server.kill()

    @contextmanager
    def _turn(self, cancel: CancelFlag) -> Iterator[None]:
        """Use the server alone; a failure ends it."""
        while not self._lock.acquire(timeout=_PERIOD):
            _check(cancel)
        try:
            _check(cancel)
            yield
        except OSError as error:
            self._kill()
            raise RenderServerError(f"The render server failed: {error}.") from error
        except RenderServerError:
            self._kill()
            raise
        finally:
            self.status = ""
            self._lock.release()

    def _kill(self) -> None:
        if self._server is not None:
            self._server.kill()
            self._server = None

    def _drawn(
        self,
        splats: Sequence[np.ndarray],
        view: Frustum,
        settings: Settings,
        pictures: Mapping[str, np.ndarray],
        cancel: CancelFlag,
    ) -> dict[str, float]:
        server = self._running(cancel)
        box = _box(view, settings)
        part = slice(*box[:2]), slice(*box[2:])
        inputs = _inputs(settings, part)
        end, given = place_arrays(0, inputs)
        end, drawn = place_arrays(end, {name: a[part] for name, a in pictures.items()})
        arrays = {fingerprint(array): array for array in splats}
        request = encoded(view, settings) | {
            "do": "draw",
            "box": box,
            "splats": [fingerprint(array) for array in splats],
            "inputs": given,
            "pictures": drawn,
        }
        for _ in range(2):
            request["memory"] = server.memory.reserve(end)
            for name, array in inputs.items():
                server.memory.array(given[name])[...] = array
            answer = self._ask(server, request, cancel)
            if "need" not in answer:
                for name, place in drawn.items():
                    pictures[name][part] = server.memory.array(place)
                return answer["stats"]
            for key in answer["need"]:
                self._put(server, key, arrays[key], cancel)
        raise RenderServerError("The render server lost the splats twice; render again.")

    def _put(self, server: ServerProcess, key: str, array: np.ndarray, cancel: CancelFlag) -> None:
        """Send an array, in parts of the size of a picture."""
        flat = array.reshape(-1)
        for begin in range(0, max(flat.size, 1), PART):
            part = flat[begin : begin + PART]
            end, places = place_arrays(0, {"part": part})
            size = server.memory.reserve(max(end, 1))
            server.memory.array(places["part"])[...] = part
            request = {"do": "put", "key": key, "shape": list(array.shape), "begin": begin}
            self._ask(server, request | places | {"memory": size}, cancel)
        self.sent += 1

    def _running(self, cancel: CancelFlag) -> ServerProcess:
        """The server, ready for requests."""
        if self._server is None:
            self._server = ServerProcess(self.device, self._idle, self._folder, self._ended)
            self.started += 1
        server = self._server
        if server.facts is None:
            server.facts = self._answer(server, cancel, START_SECONDS, patient=True)
        return server

    def _ended(self, server: ServerProcess) -> None:
        """Free the memory of a server that has ended."""
        with self._lock:
            if self._server is server:
                self._server = None

    def _ask(self, server: ServerProcess, request: Message, cancel: CancelFlag) -> Message:
        server.send(request)
        answer = self._answer(server, cancel, self._seconds)
        _check(cancel)
        return answer

    def _answer(
        self, server: ServerProcess, cancel: CancelFlag, seconds: float, *, patient: bool = False
    ) -> Message:
        """The next answer.

        Args:
            server: The server.
            cancel: The flag of the drawing.
            seconds: Time limit.
            patient: Leave the server alone when the drawing is cancelled.

        Raises:
            RenderServerError: it failed, ended, or took too long.
            ShapeError: it refused the request.
            Cancelled: `cancel` was set.
        """
        until, cancelled = time.monotonic() + seconds, False
        while True:
            answer = server.answer(_PERIOD)
            if answer is not None and "status" in answer:
                self.status = str(answer["status"])
            elif answer is not None:
                return _checked(answer)
            if cancel.value.value and not cancelled:
                if patient:
                    _check(cancel)
                server.send({"do": "cancel"})
                until, cancelled = time.monotonic() + _CANCEL_SECONDS, True
            if time.monotonic() > until:
                self._kill()
                _check(cancel)
                raise RenderServerError(f"The render server took longer than {seconds:g} s.")
            if server.end is not None:
                _check(cancel)
                raise _IdleEndError if server.end == 0 else RenderServerError(_end_text(server.end))


def find_devices(folder: str | None = None) -> tuple[list[dict[str, str]], list[str]]:
    """The graphics cards of this machine, found by another process.

    Args:
        folder: As for `RenderClient`.

    Returns:
        uuid, name and reason (why it cannot be used, empty: it can) of each; and sentences on what
        is missing.

    Raises:
        RenderServerError: the other process failed.
    """
    found = RenderClient(LIST, folder=folder).first_answer()
    return found["devices"], found["problems"]


class _IdleEndError(RenderServerError):
    """The server ended because nobody needed it."""

    def __init__(self) -> None:
        super().__init__("The render server ended.")


def _check(cancel: CancelFlag) -> None:
    if cancel.value.value:
        raise Cancelled("Rendering was cancelled.")


def _checked(answer: Message) -> Message:
    """An answer without an error."""
    if "error" in answer:
        kind, text = answer["error"]
        errors = {e.__name__: e for e in (Cancelled, ShapeError, NoDeviceError)}
        raise errors.get(kind, RenderServerError)(text)
    return answer


def _end_text(code: int) -> str:
    how = f"signal {-code}" if code < 0 else f"code {code}"
    return f"The render server ended with {how}."


def _box(view: Frustum, settings: Settings) -> tuple[int, int, int, int]:
    """Top, bottom, left and right of the rectangle around the enabled tiles, px."""
    if settings.tiles is None:
        return 0, view.height, 0, view.width
    box = []
    for axis, most in ((1, view.height), (0, view.width)):
        enabled = np.flatnonzero(settings.tiles.any(axis=axis))
        first, last = (enabled[0], enabled[-1] + 1) if len(enabled) else (0, 0)
        box += [int(first) * TILE, min(int(last) * TILE, most)]
    return box[0], box[1], box[2], box[3]


def _inputs(settings: Settings, part: tuple[slice, slice]) -> dict[str, np.ndarray]:
    """Arrays for the server besides the splats."""
    found = {}
    if settings.tiles is not None:
        found["tiles"] = settings.tiles
    if settings.far_depths is not None:
        found["far_depths"] = settings.far_depths[part]
    return found


_known: dict[int, tuple[weakref.ref, str]] = {}
"""Fingerprints of living arrays by their id."""


def fingerprint(array: np.ndarray) -> str:
    """Fingerprint of an array's shape and content, computed once per array, which must not change
    afterwards."""
    found = _known.get(id(array))
    if found is not None and found[0]() is array:
        return found[1]
    digest = hashlib.blake2b(repr(array.shape).encode(), digest_size=16)
    digest.update(array.reshape(-1).view(np.uint8).data)
    key = id(array)
    _known[key] = weakref.ref(array, lambda _: _known.pop(key, None)), digest.hexdigest()
    return digest.hexdigest()
