"""Messages between render server and client: JSON objects on pipes, and arrays in shared memory.

A message is JSON after its length as four bytes, the lowest first.
"""

import json
import mmap
import os
import struct
import sys
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..errors import BackendError
from ..json_text import parse_json
from .request import Frustum, Settings

LIST = "list"
"""In place of a device: the server lists the devices of this machine and ends."""
LONGEST = 1 << 20
"""Bytes of the longest message."""
_DTYPES = {name: np.dtype(name) for name in ("float32", "uint8")}

Message = dict[str, Any]


class RenderServerError(BackendError):
    """The device of a render server failed, or the server itself."""


class NoDeviceError(RenderServerError):
    """Device `auto`, and there is no graphics card that can draw."""


class SharedMemory:
    """Memory of two processes: a file without a name, or on Windows a part of the page file; it is
    free as soon as both have ended, however they end."""

    def __init__(self, name: str) -> None:
        """Memory of another process.

        Args:
            name: Number of the open file; on Windows the name of the memory.
        """
        self.name = name
        self._map: mmap.mmap | None = None

    @classmethod
    def created(cls, folder: str | None) -> "SharedMemory":
        """New memory.

        Args:
            folder: Folder of its file; None: the temporary folder of the system.
        """
        import secrets
        import tempfile

        if sys.platform == "win32":
            return cls(f"gscore-{secrets.token_hex(16)}")
        number, path = tempfile.mkstemp(prefix="gscore-", dir=folder)  # for this user alone
        memory = cls(str(number))
        weakref.finalize(memory, os.close, number)
        Path(path).unlink()
        return memory

    @property
    def files(self) -> tuple[int, ...]:
        """Open files that the other process must inherit."""
        return () if sys.platform == "win32" else (int(self.name),)

    def reserve(self, size: int) -> int:
        """Make room for at least `size` bytes, which the other process then maps.

        A file with holes would end the process in which the disk turns out to be full.

        Returns:
            The size.

        Raises:
            OSError: the disk is full.
        """
        if self._map is not None and len(self._map) >= size:
            return len(self._map)
        size = -(-size // LONGEST) * LONGEST
        if sys.platform == "linux":
            os.posix_fallocate(int(self.name), 0, size)
        elif sys.platform != "win32":
            begin = os.fstat(int(self.name)).st_size
            while begin < size:
                begin += os.pwrite(int(self.name), bytes(min(size - begin, LONGEST)), begin)
        return len(self.map(size))

    def map(self, size: int) -> mmap.mmap:
        """The memory, of at least this size, which `reserve` has returned."""
        if self._map is None or len(self._map) < size:
            if sys.platform == "win32":
                self._map = mmap.mmap(-1, size, tagname=f"{self.name}-{size}")
            else:
                self._map = mmap.mmap(int(self.name), size)
        return self._map

    def array(self, place: Message) -> np.ndarray:
        """An array in the mapped memory; ValueError or TypeError if it is not inside.

        Args:
            place: `at`, its first byte; `shape`; `dtype`, float32 or uint8.
        """
        assert self._map is not None
        dtype, shape = _DTYPES[place["dtype"]], tuple(place["shape"])
        if min(place["at"], *shape) < 0:  # not checked by numpy
            raise ValueError("an array outside of the memory")
        return np.ndarray(shape, dtype, buffer=self._map, offset=place["at"])


def write_message(stream: IO[bytes], message: Message) -> None:
    """Write a message.

    Raises:
        OSError: the other process has ended.
    """
    data = json.dumps(message).encode()
    stream.write(struct.pack("<I", len(data)) + data)
    stream.flush()


def read_message(stream: IO[bytes]) -> Message | None:
    """The next message; None at the end of the stream.

    Raises:
        ValueError: this is no message, and all that follows is unreadable.
    """
    head = stream.read(4)
    if len(head) < 4:
        return None
    (size,) = struct.unpack("<I", head)
    if size > LONGEST:
        raise ValueError(f"a message of {size} bytes, at most {LONGEST} were expected")
    data = stream.read(size)
    if len(data) < size:
        return None
    message = parse_json(data)
    if not isinstance(message, dict):
        raise ValueError(f"a message must be an object, got {type(message).__name__}")
    return message


def place_arrays(begin: int, arrays: Mapping[str, np.ndarray]) -> tuple[int, Message]:
    """Places of arrays after each other in shared memory.

    Args:
        begin: The first byte.
        arrays: Arrays by name, of which dtype and shape count.

    Returns:
        The end, and the places by name, as `SharedMemory.array` takes them.
    """
    places = {}
    for name, array in arrays.items():
        begin = -(-begin // 64) * 64
        places[name] = {"at": begin, "shape": list(array.shape), "dtype": array.dtype.name}
        begin += array.nbytes
    return begin, places


def encoded(view: Frustum, settings: Settings) -> Message:
    """View and settings as JSON values, without arrays for the pictures."""
    numbers = {name: float(getattr(view, name)) for name in ("near", "far")}
    sizes = {name: int(getattr(view, name)) for name in ("width", "height")}
    matrices = {n: np.asarray(getattr(view, n), np.float64).tolist() for n in ("viewmat", "K")}
    degree = None if settings.sh_degree is None else int(settings.sh_degree)
    return {
        "view": numbers | sizes | matrices | {"orthographic": bool(view.orthographic)},
        "settings": {
            "raw": bool(settings.raw),
            "sh_degree": degree,
            "eps2d": float(settings.eps2d),
            "antialias": bool(settings.antialias),
            "background": [float(value) for value in settings.background],
            "outputs": int(settings.outputs),
            "threads": int(settings.threads),
            "disable": int(settings.disable),
        },
    }


def decoded_view(message: Message) -> Frustum:
    """The view of `encoded`; KeyError, TypeError or ValueError for anything else."""
    view = message["view"]
    matrices = {name: np.array(view[name], np.float64) for name in ("viewmat", "K")}
    return Frustum(**(view | matrices))


def decoded_settings(message: Message, **more: Any) -> Settings:
    """The settings of `encoded`, with more fields; TypeError for anything else."""
    return Settings(**message["settings"], **more)
