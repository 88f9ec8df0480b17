"""Render server: a process that draws splats for another one, such as Blender, in which no graphics
driver runs.

It reads requests from stdin and writes answers to stdout, messages of `render_messages.py`. A
request has `do`:

- `draw`: draws splats, which it names by the fingerprints of their arrays. The answer has `stats`,
  or `need`, the fingerprints that the server does not know.
- `put`: a part of such an array. The answer is empty.
- `cancel`: stops the drawing; no answer.

An `error` in an answer is the name of an exception and its message. The first answer is `ready`;
`status` before another answer is a sentence on work that takes long. The server ends with the
process that started it, or after some time without requests.
"""

import contextlib
import os
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from queue import Empty, SimpleQueue
from typing import IO, Any

import numpy as np

from ..errors import GsError
from . import _native
from .render_messages import (
    LIST,
    Message,
    NoDeviceError,
    SharedMemory,
    decoded_settings,
    decoded_view,
    read_message,
    write_message,
)
from .request import CancelFlag, Settings

KEPT_BYTES = 1 << 30
"""Most bytes of splats kept for further pictures, besides those of the last picture."""
_KEPT_SHARE = 4
"""They take at most this part of the memory of a graphics card."""
Lend = Callable[[], AbstractContextManager[Any]]
"""Lends what draws: a `Raster`, or a `GpuRaster`."""


class RenderServer:
    """Answers requests, one after the other."""

    def __init__(self, lend: Lend, memory: SharedMemory, kept: int = KEPT_BYTES) -> None:
        """Initialise.

        Args:
            lend: Lends what draws.
            memory: Memory shared with the client.
            kept: Bytes of splats kept besides those of the last picture.
        """
        self._lend, self._memory = lend, memory
        self._kept_bytes = kept
        self._arrays: dict[str, np.ndarray] = {}
        self._filled: dict[str, int] = {}
        self._models: dict[tuple[str, ...], list[np.ndarray]] = {}

    def answer(self, message: Message, cancel: CancelFlag) -> Message:
        """The answer to a request; what fails is an `error` in it.

        Args:
            message: The request.
            cancel: Set by another thread to stop a drawing.
        """
        try:
            known = {"draw": self._answer_draw, "put": self._answer_put}
            return known[message["do"]](message, cancel)
        except GsError as error:
            return _error_answer(error)
        except Exception as error:  # whatever a request contains, the next one is answered
            return _error_answer(ValueError(f"The render server refused a request: {error!r}."))

    def _answer_put(self, message: Message, cancel: CancelFlag) -> Message:
        """Copy a part of an array; parts come in order."""
        key, begin, part = message["key"], message["begin"], message["part"]
        self._memory.map(message["memory"])
        source = self._memory.array(part)
        if begin == 0:
            self._arrays[key] = np.empty(tuple(message["shape"]), np.float32)
        elif self._filled.get(key) != begin:
            raise ValueError(f"a part at {begin} was not expected")
        self._arrays[key].reshape(-1)[begin : begin + source.size] = source
        self._filled[key] = begin + source.size
        return {}

    def _answer_draw(self, message: Message, cancel: CancelFlag) -> Message:
        keys = tuple(message["splats"])
        missing = [key for key in dict.fromkeys(keys) if not self._is_complete(key)]
        if missing:
            return {"need": missing}
        splats = self._kept(keys)
        self._memory.map(message["memory"])
        view = decoded_view(message)
        top, bottom, left, right = message["box"]
        box = slice(top, bottom), slice(left, right)
        places = {name: self._memory.array(place) for name, place in message["inputs"].items()}
        shared = {name: self._memory.array(place) for name, place in message["pictures"].items()}
        inputs = {}
        if "tiles" in places:
            inputs["tiles"] = places["tiles"].copy()
        if "far_depths" in places:
            inputs["far_depths"] = np.full((view.height, view.width), np.nan, np.float32)
            inputs["far_depths"][box] = places["far_depths"]
        settings = decoded_settings(message, **inputs, cancel=cancel)
        pictures = shared
        if (bottom - top, right - left) != (view.height, view.width):
            size = view.height, view.width
            pictures = {n: np.zeros((*size, *a.shape[2:]), a.dtype) for n, a in shared.items()}
        with self._lend() as raster:
            if not isinstance(raster, _native.Raster):
                raster.keep(splats, settings)
            raster.forward(splats, view, settings, pictures)
            stats = raster.stats()
        for name, picture in pictures.items():
            if picture is not shared[name]:
                shared[name][...] = picture[box]
        return {"stats": stats}

    def _is_complete(self, key: str) -> bool:
        array = self._arrays.get(key)
        return array is not None and self._filled[key] >= array.size

    def _kept(self, keys: tuple[str, ...]) -> list[np.ndarray]:
        """The arrays of a model; the models not drawn for the longest time make room."""
        found = self._models.pop(keys, None) or [self._arrays[key] for key in keys]
        self._models[keys] = found
        own = set(keys)
        while len(self._models) > 1 and self._bytes_besides(own) > self._kept_bytes:
            self._release(self._models.pop(next(iter(self._models))))
        used = {key for names in self._models for key in names}
        self._arrays = {key: array for key, array in self._arrays.items() if key in used}
        self._filled = {key: self._filled[key] for key in self._arrays}
        return found

    def _release(self, splats: list[np.ndarray]) -> None:
        with self._lend() as raster:
            if not isinstance(raster, _native.Raster):
                raster.release(splats, Settings())

    def _bytes_besides(self, own: set[str]) -> int:
        used = {key for names in self._models for key in names} - own
        return sum(self._arrays[key].nbytes for key in used)


def _error_answer(error: Exception) -> Message:
    return {"error": [type(error).__name__, str(error)]}


def open_device(device: str, report: Callable[[str], None]) -> tuple[Lend, int]:
    """The function that lends what draws on a device, and the bytes of splats to keep for it.

    Args:
        device: `cpu`; `auto`, the best graphics card; or the UUID of a device.
        report: Receives sentences while a new device is tested.

    Raises:
        NoDeviceError: `auto`, and there is no card that can draw.
        GsError: the device cannot be used, with the reason.
    """
    if device == "cpu":
        return _native.pool.lend, KEPT_BYTES
    from .gpu.choice import choose

    chosen = choose(device, report=report)
    if chosen.device is None:
        raise NoDeviceError(chosen.note or f"The CPU is used. {chosen.reason}")
    report(f"Starting {chosen.name}")
    with chosen.lend():  # compiles
        return chosen.lend, min(KEPT_BYTES, chosen.device.memory_bytes // _KEPT_SHARE)


def _listed() -> Message:
    """The devices of this machine."""
    from .gpu.devices import find_devices

    found = find_devices()
    devices = [{"uuid": d.uuid, "name": d.name, "reason": d.reason} for d in found.devices]
    return {"devices": devices, "problems": list(found.problems)}


def main(arguments: Sequence[str]) -> None:
    """Serve until the client ends.

    Args:
        arguments: The device, the seconds without requests after which it ends, and the name of the
            shared memory.
    """
    device, idle, name = arguments
    # Drivers print to stdout.
    source, sink = (os.fdopen(os.dup(number), mode) for number, mode in ((0, "rb"), (1, "wb")))
    os.dup2(2, 1)
    requests: SimpleQueue[tuple[Message, CancelFlag]] = SimpleQueue()
    threading.Thread(target=_read, args=(source, requests), daemon=True).start()
    with contextlib.suppress(Empty, BrokenPipeError):
        try:
            if device == LIST:
                write_message(sink, _listed())
                os._exit(0)
            lend, kept = open_device(device, lambda text: write_message(sink, {"status": text}))
        except GsError as error:
            write_message(sink, _error_answer(error))
            os._exit(1)
        server = RenderServer(lend, SharedMemory(name), kept)
        write_message(sink, {"ready": device})
        while True:
            message, cancel = requests.get(timeout=float(idle))
            write_message(sink, server.answer(message, cancel))
    os._exit(0)  # the reading thread holds a lock that Python's shutdown would wait for


def _read(source: IO[bytes], requests: "SimpleQueue[tuple[Message, CancelFlag]]") -> None:
    """Read requests, and end the process with the client, also in the middle of a drawing."""
    cancel, code = CancelFlag(), 0
    try:
        while (message := read_message(source)) is not None:
            if message.get("do") == "cancel":
                cancel.set()
                continue
            cancel = CancelFlag()
            requests.put((message, cancel))
    except (OSError, ValueError) as error:
        sys.stderr.write(f"The render server ends: {error}\n")
        sys.stderr.flush()
        code = 2
    os._exit(code)
