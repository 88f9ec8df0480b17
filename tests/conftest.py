"""What all tests need: programs that they start are to obey Ctrl-C, whoever started the tests."""

import signal


def pytest_configure() -> None:
    """A shell without job control ignores SIGINT for what it starts in the background, and so would
    all programs below."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
