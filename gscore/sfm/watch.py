"""Calls into pycolmap in a thread, watched: how far they are, and whether they are to end."""

import concurrent.futures
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from ..errors import BackendError, Cancelled, GsError
from ..extras import need

Result = TypeVar("Result")
_PERIOD = 0.2
"""Seconds between two looks."""


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


def watched(
    work: Callable[[Any], Result], *, tick: Callable[[], None], cancelled: Callable[[], bool]
) -> Result:
    """Do `work` in a thread: Python's signal handlers run in the main one only between calls.

    Args:
        work: Gets a CancellationToken of pycolmap.
        tick: Called now and then while it works.
        cancelled: True cancels the token.

    Raises:
        Cancelled: `cancelled` said so.
        GsError: pycolmap raised an error.
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
    try:
        return future.result()
    except (RuntimeError, ValueError) as error:
        said = str(error).strip().splitlines()
        raise GsError(
            f"COLMAP has failed: {said[-1] if said else type(error).__name__}. What it had found "
            "is kept; see whether the disk is full, and give the same command again."
        ) from error
