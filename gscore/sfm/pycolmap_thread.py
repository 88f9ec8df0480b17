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
"""Seconds between two looks."""
_LEAST_FREE = 1 << 20
"""Bytes below which a disk counts as full: SQLite and COLMAP write larger pieces."""


def colmap() -> Any:
    """pycolmap with its log switched off, which is for its developers.

    Raises:
        BackendError: it is not installed, or too old to be stopped.
    """
    module = need("pycolmap", "Finding cameras")
    if not hasattr(module, "CancellationToken"):
        raise BackendError(
            f"Finding cameras needs pycolmap 4.2 or later, this is {module.__version__}; update it "
            'with: pip install --upgrade "pycolmap>=4.2"'
        )
    module.logging.minloglevel = module.logging.FATAL.value
    return module


@contextlib.contextmanager
def log_messages(folder: Path) -> Iterator[None]:
    """A block of calls into pycolmap that write into a folder; what they raise becomes a sentence.

    Raises:
        GsError: pycolmap raised an error, the disk is full, of which it says other things, or the
            folder was removed.
    """
    try:
        yield
    except GsError:  # some are ValueErrors and RuntimeErrors too
        raise
    except (OSError, RuntimeError, ValueError, sqlite3.Error) as error:
        if not folder.is_dir():
            raise GsError(
                f"{brief(folder)} was removed while cameras were searched in it. Give the same "
                "command again; it begins anew."
            ) from error
        if isinstance(error, OSError):
            raise
        check_space(folder, _LEAST_FREE)
        said = str(error).strip().splitlines()
        raise GsError(
            f"COLMAP has failed: {said[-1].rstrip('.') if said else type(error).__name__}. What "
            "it had found is kept; give the same command again, or remove "
            f"{brief(folder)} to begin anew."
        ) from error


def check_space(folder: Path, least: int) -> None:
    """Raise GsError where fewer bytes than `least` are free on the disk of a folder.

    Asked before work begins: COLMAP ends the whole process where SQLite can no longer write.
    """
    try:
        free = shutil.disk_usage(folder).free
    except OSError:
        return  # what is wrong with the folder is said by who writes into it
    if free < least:
        raise GsError(
            f"Cannot go on in {brief(folder)}: the disk is full, or nearly, with "
            f"{free / 1e6:.0f} MB free of {least / 1e6:.0f} MB that the next step may need. Free "
            "some space and give the same command again; it goes on from what was found."
        )


def run_in_thread(
    work: Callable[[Any], Result],
    folder: Path,
    *,
    tick: Callable[[], None],
    cancelled: Callable[[], bool],
) -> Result:
    """Do `work` in a thread: Python's signal handlers run in the main one only between calls.

    Args:
        work: Gets a CancellationToken of pycolmap.
        folder: Where it writes.
        tick: Called now and then while it works.
        cancelled: True cancels the token.

    Raises:
        Cancelled: `cancelled` said so.
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
