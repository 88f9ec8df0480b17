"""Pycolmap thread: calls in a worker thread, with progress and cancellation."""

import concurrent.futures
import contextlib
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

from ..errors import BackendError, Cancelled, GsError
from ..extras import need
from ..quoting import brief

Result = TypeVar("Result")
_PERIOD = 0.2
"""Seconds between two polls."""
_LEAST_FREE = 1 << 20
"""Free bytes below which a disk counts as full: SQLite and COLMAP write larger pieces."""


def colmap() -> Any:
    """Module pycolmap, with its log for developers switched off.

    Raises:
        BackendError: it is not installed, or too old to be cancelled.
    """
    module = need("pycolmap", "Finding cameras")
    if not hasattr(module, "CancellationToken"):
        raise BackendError(
            "Finding cameras needs pycolmap 4.2 or later, but the installed one is "
            f'{module.__version__}; update it with: pip install --upgrade "pycolmap>=4.2"'
        )
    module.logging.minloglevel = module.logging.FATAL.value
    return module


@contextlib.contextmanager
def log_messages(folder: Path) -> Iterator[None]:
    """Context manager for pycolmap calls that write into a folder; their errors become messages.

    Raises:
        GsError: pycolmap raised an error, the disk is full, which pycolmap reports differently, or
            the folder was removed.
    """
    try:
        yield
    except GsError:  # some are ValueErrors and RuntimeErrors too
        raise
    except (OSError, RuntimeError, ValueError, sqlite3.Error) as error:
        if not folder.is_dir():
            raise GsError(
                f"{brief(folder)} was removed during the camera search. Give the same command "
                "again; it starts from the beginning."
            ) from error
        if isinstance(error, OSError):
            raise
        check_space(folder, _LEAST_FREE)
        lines = str(error).strip().splitlines()
        raise GsError(
            f"COLMAP failed: {lines[-1].rstrip('.') if lines else type(error).__name__}. Its "
            "intermediate results are kept; give the same command again, or remove "
            f"{brief(folder)} to start from the beginning."
        ) from error


def check_space(folder: Path, least: int) -> None:
    """Raise GsError if fewer bytes than `least` are free on the disk of a folder.

    Called before each step, because COLMAP ends the whole process when SQLite can no longer write.
    """
    try:
        free = shutil.disk_usage(folder).free
    except OSError:
        return  # the code that writes into the folder reports the error
    if free < least:
        raise GsError(
            f"Cannot continue in {brief(folder)}: the disk is full, or nearly, with "
            f"{free / 1e6:.0f} MB free of {least / 1e6:.0f} MB that the next step may need. Free "
            "some space and give the same command again; it resumes from there."
        )


def run_in_thread(
    work: Callable[[Any], Result],
    folder: Path,
    *,
    tick: Callable[[], None],
    cancelled: Callable[[], bool],
) -> Result:
    """Run `work` in a thread, because Python handles signals in the main thread only between calls.

    Args:
        work: Receives a CancellationToken of pycolmap.
        folder: Output folder of `work`.
        tick: Called periodically while `work` runs.
        cancelled: True cancels the token.

    Raises:
        Cancelled: `cancelled` returned True.
        GsError: pycolmap raised an error, or the disk is full.
    """
    token = colmap().CancellationToken()
    with ThreadPoolExecutor(1, thread_name_prefix="gscore-sfm") as pool:
        future = pool.submit(work, token)
        while not concurrent.futures.wait([future], timeout=_PERIOD).done:
            if cancelled():
                token.cancel()
            tick()
    if cancelled():
        raise Cancelled("Finding cameras was stopped.")
    with log_messages(folder):
        return future.result()
