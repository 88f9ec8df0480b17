"""Signals that end a command. Imports nothing else: the command line loads it first."""

import signal


def ending_signals() -> list[int]:
    """The signals that end a command, without those that were ignored at the start.

    nohup ignores SIGHUP, and a shell without job control ignores SIGINT for background processes,
    so that Ctrl-C ends only the foreground process. Windows has no SIGHUP; closing a console sends
    SIGBREAK there.
    """
    names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]
    numbers = [getattr(signal, name) for name in names]
    return [number for number in numbers if signal.getsignal(number) is not signal.SIG_IGN]
