"""What all tests need: programs that they start are to obey Ctrl-C, whoever started the tests, and
parallel workers share the cores."""

import os
import signal
from collections.abc import Generator

import pytest

if "PYTEST_XDIST_WORKER" in os.environ:  # before torch or the native library reads them
    for _name in ("OMP_NUM_THREADS", "GSCORE_THREADS"):
        os.environ.setdefault(_name, "1")

_WORKER_BYTES = 3e9
"""Memory that a worker of pytest-xdist may need."""


def pytest_configure() -> None:
    """A shell without job control ignores SIGINT for what it starts in the background, and so would
    all programs below."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(optionalhook=True, wrapper=True)
def pytest_xdist_auto_num_workers() -> Generator[None, int, int]:
    """Workers of `-n logical`: one per core, but no more than fit into the available memory."""
    cores = yield
    from gscore.io.system_memory import available_memory_bytes

    return max(1, min(cores, int((available_memory_bytes() or 1e12) // _WORKER_BYTES)))
