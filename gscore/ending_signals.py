"""Signals that end a command. Imports nothing else: the command line loads it first."""

import signal


def ending_signals() -> list[int]:
    """The signals that end a command; those that are ignored from the start are left so.

    nohup ignores SIGHUP, and a shell without job control SIGINT for what it starts in the
    background, so that Ctrl-C ends what is before the user alone. Windows has no SIGHUP; a console
    that closes is a SIGBREAK there.
    """
    names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]
    numbers = [getattr(signal, name) for name in names]
    return [number for number in numbers if signal.getsignal(number) is not signal.SIG_IGN]
