"""GPU library: loaded on first use, and its statuses as errors."""

import ctypes as ct
import hashlib
from functools import lru_cache
from pathlib import Path
from typing import Any

from ...errors import BackendError, Cancelled, ShapeError
from ..header import BAD_ARGUMENT, CANCELLED, OK, OUT_OF_MEMORY
from ..shared_library import SharedLibrary
from . import header


def _declare(lib: ct.CDLL) -> None:
    """Declare argument and result types of the functions for ctypes."""
    lib.gs_gpu_last_error.restype = ct.c_char_p
    freeing = ("gs_gpu_close", "gs_gpu_release", "gs_gpu_model_destroy", "gs_gpu_photo_free")
    for name in freeing:
        getattr(lib, name).restype = None
    for name, types in header.SIGNATURES.items():
        getattr(lib, name).argtypes = types


LIBRARY = SharedLibrary(
    name="gscore_gpu",
    variable="GSCORE_GPU_LIBRARY",
    function="gs_gpu_abi_version",
    version=header.ABI_VERSION,
    declare=_declare,
)
"""The library for graphics cards."""


class DeviceLostError(BackendError):
    """The graphics driver gave the device up."""


class DeviceTimeoutError(BackendError):
    """The device did not finish in time."""


class DeviceMemoryError(BackendError):
    """The device has too little memory."""


class DeviceWrongError(BackendError):
    """The device no longer computes what it did before."""


DEVICE_ERRORS = (DeviceLostError, DeviceMemoryError, DeviceTimeoutError, DeviceWrongError)
"""Failures of a device, after which the CPU may continue."""
_ERRORS: dict[int, tuple[type[BackendError], str]] = {
    header.DEVICE_LOST: (
        DeviceLostError,
        "Update the graphics driver if this happens again, or use `--device cpu`.",
    ),
    header.TIMED_OUT: (
        DeviceTimeoutError,
        "Use smaller images (`--resolution`), allow more time (GSCORE_GPU_SECONDS), or use "
        "`--device cpu`.",
    ),
    OUT_OF_MEMORY: (
        DeviceMemoryError,
        "Close programs that use the graphics card, use smaller images (`--resolution`) or fewer "
        "splats (`--max-splats`, for files `gscore convert --count`), or use `--device cpu`.",
    ),
}
"""Class of error and remedy by status."""


def library_path() -> Path:
    """Path of the library: GSCORE_GPU_LIBRARY unless that is empty, else next to libgscore."""
    return LIBRARY.path


def library() -> Any:
    """The loaded library, a ctypes.CDLL.

    Raises:
        BackendError: it is missing or of another version.
    """
    return LIBRARY.get()


def last_error() -> str:
    """The library's message of the last failure on this thread, without a full stop."""
    return library().gs_gpu_last_error().decode("utf-8", "replace").rstrip(".")


def raise_status(status: int) -> None:
    """Raise the exception for a gs_status of the GPU library."""
    if status == OK:
        return
    if status == CANCELLED:
        raise Cancelled("Rendering was cancelled.")
    message = last_error()
    message = f"{message[:1].upper()}{message[1:]}."
    if status == BAD_ARGUMENT:
        raise ShapeError(message)
    kind, remedy = _ERRORS.get(status, (BackendError, ""))
    raise kind(f"{message} {remedy}".rstrip())


def library_hash() -> str:
    """SHA-256 of the library's file, hexadecimal; empty if it cannot be read."""
    path = library_path()
    try:
        state = path.stat()
        return _hash_of(path, state.st_mtime_ns, state.st_size)
    except (OSError, ValueError):
        return ""


@lru_cache(maxsize=4)
def _hash_of(path: Path, _time: int, _size: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
