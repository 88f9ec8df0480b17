"""Shared library loader: opens gscore's native libraries once a process, each of the version that
this gscore needs."""

import ctypes as ct
import os
import stat
import struct
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import BackendError
from ..io.files import reason
from ..quoting import brief
from ..text_format import number

_REINSTALL = "Reinstall gscore so that both come from one version."


@dataclass(kw_only=True, eq=False)
class SharedLibrary:
    """A native library of gscore."""

    name: str
    """Name without prefix and ending: `gscore` is libgscore.so, gscore.dll or libgscore.dylib."""
    variable: str
    """Environment variable with the path of another build."""
    function: str
    """Function that returns the interface version."""
    version: int
    """Interface version that this gscore needs."""
    declare: Callable[[ct.CDLL], None]
    """Declares its functions for ctypes; AttributeError if one is missing."""
    check: Callable[[ct.CDLL], None] = lambda _: None
    """Checks what it depends on, once it is open."""
    loaded: Any = field(default=None, init=False)
    """The ctypes.CDLL; None: it was not needed yet."""

    def __post_init__(self) -> None:
        self._lock = threading.Lock()
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._unlock)

    def _unlock(self) -> None:
        """Replace the lock in a forked process, where the thread that owned it does not exist."""
        self._lock = threading.Lock()

    @property
    def path(self) -> Path:
        """The path in the environment variable unless that is empty, else next to this file."""
        override = os.environ.get(self.variable)
        if override:
            return Path(override)
        endings = {"win32": f"{self.name}.dll", "darwin": f"lib{self.name}.dylib"}
        return Path(__file__).with_name(endings.get(sys.platform, f"lib{self.name}.so"))

    def get(self) -> Any:
        """The library, a ctypes.CDLL, opened when it is first needed.

        Raises:
            BackendError: it is missing, truncated, of another version or no library of gscore.
            GsError: `check` fails.
        """
        if self.loaded is None:
            with self._lock:
                if self.loaded is None:
                    self.loaded = self._load()
        return self.loaded

    def _load(self) -> ct.CDLL:
        lib, path = self._opened(self.path), self.path
        try:
            version_of = getattr(lib, self.function)
        except AttributeError:
            raise BackendError(
                f"{brief(path)}{self._source()} is not gscore's library: it has no "
                f"{self.function}. {self._what_to_do()}"
            ) from None
        version_of.restype = ct.c_int32
        version = version_of()
        if version != self.version:
            raise BackendError(
                f"The native library {brief(path)}{self._source()} has interface version "
                f"{version}, this gscore needs {self.version}. {_REINSTALL}"
            )
        try:
            self.declare(lib)
        except AttributeError as error:  # a build from before a function was added
            raise BackendError(
                f"The native library {brief(path)}{self._source()} is of another build than this "
                f"gscore: {error}. {_REINSTALL}"
            ) from None
        self.check(lib)
        return lib

    def _opened(self, path: Path) -> ct.CDLL:
        """The library at `path`; BackendError if this system cannot load it."""
        name = f"{brief(path)}{self._source()}"
        try:
            is_file = stat.S_ISREG(path.stat().st_mode)
        except (OSError, ValueError) as error:
            raise BackendError(
                f"The native library is missing: {name} cannot be opened: {reason(error)} "
                f"{self._what_to_do()}"
            ) from error
        if not is_file:
            raise BackendError(f"{name} is not a file, expected a library. {self._what_to_do()}")
        self._check_whole(path, name)
        try:
            # The system would search a name without a folder in its own library folders.
            return ct.CDLL(str(path.absolute()))
        except OSError as error:
            raise BackendError(
                f"{name} cannot be loaded as a library on this system: {error}. "
                f"{self._what_to_do()}"
            ) from error

    def _check_whole(self, path: Path, name: str) -> None:
        """Raise BackendError if the file is truncated."""
        try:
            missing = bytes_missing(path)
        except OSError:  # the loader reports why it cannot be read
            return
        if missing:
            raise BackendError(
                f"{name} is truncated: {number(missing)} bytes are missing, perhaps because it was "
                f"copied onto a full disk. {self._what_to_do()}"
            )

    def _source(self) -> str:
        return f" ({self.variable})" if os.environ.get(self.variable) else ""

    def _what_to_do(self) -> str:
        if os.environ.get(self.variable):
            return (
                f"The environment variable {self.variable} must be the path of gscore's native "
                "library; unset it to use the bundled one."
            )
        checkout = Path(__file__).parents[2]
        if (checkout / "csrc" / "CMakeLists.txt").is_file():
            return f"Build it with `make install` in {brief(checkout)}."
        return "Install gscore as a wheel for this platform."


def bytes_missing(path: Path) -> int:
    """Bytes missing at the end of a 64-bit ELF library, 0 for other formats.

    Linux maps a truncated library, and the process dies when it reads a missing page. Linkers write
    the section table last (System V ABI, "Object Files"): its offset, entry size and entry count.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        head, size = file.read(64), os.fstat(file.fileno()).st_size
    if len(head) < 64 or not head.startswith(b"\x7fELF\x02\x01"):
        return 0
    begin, entry, count = struct.unpack("<40xQ10xHH2x", head)
    return max(begin + entry * count - size, 0)
