"""What all tests need: programs that they start are to obey Ctrl-C, whoever started the tests, and
parallel workers share the cores."""

import os
import signal

if "PYTEST_XDIST_WORKER" in os.environ:  # before torch or the native library reads them
    for _name in ("OMP_NUM_THREADS", "GSCORE_THREADS"):
        os.environ.setdefault(_name, "1")


def pytest_configure() -> None:
    """A shell without job control ignores SIGINT for what it starts in the background, and so would
    all programs below."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
