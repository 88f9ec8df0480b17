"""A terminal of a given size, in which tests run commands and read the screen."""

import fcntl
import os
import pty
import select
import struct
import subprocess
import sys
import termios
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pyte


@dataclass
class Shown:
    """The output of a command on a terminal."""

    lines: list[str]
    """Lines of the screen and of the scrollback, without blank ends."""
    raw: str
    """Every byte that was written."""
    code: int
    """Exit code."""
    wrapped: list[str] = field(default_factory=list)
    """Moving lines that reached the last column."""


def resize(fd: int, columns: int, rows: int = 24) -> None:
    """Give a pseudo-terminal a size."""
    fcntl.ioctl(fd, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))


def run_in_terminal(
    arguments: list[str],
    *,
    columns: int = 80,
    rows: int = 24,
    cwd: Path | None = None,
    env: dict[str, str] | None = None,
    on_output: Callable[[str, int], None] | None = None,
) -> Shown:
    """Run a program in a pseudo-terminal and draw its output.

    Args:
        arguments: Of the program.
        columns: Of the terminal.
        rows: Of the terminal.
        cwd: Folder to run in.
        env: Variables in addition to those of this process.
        on_output: Called with each text as it arrives and the terminal, to resize it.
    """
    master, slave = pty.openpty()
    resize(slave, columns, rows)
    variables = {**os.environ, "TERM": "xterm", **(env or {})}
    with subprocess.Popen(
        arguments, stdin=slave, stdout=slave, stderr=slave, cwd=cwd, env=variables, close_fds=True
    ) as process:
        os.close(slave)
        raw = b""
        while True:
            if not select.select([master], [], [], 60)[0]:
                process.kill()
                raise AssertionError(f"nothing was written for a minute after {raw[-300:]!r}")
            try:
                text = os.read(master, 65536)
            except OSError:  # Linux raises it when the other end is closed
                text = b""
            if not text:
                break
            raw += text
            if on_output is not None:
                on_output(text.decode("utf-8", "replace"), master)
        code = process.wait()
    os.close(master)
    text = raw.decode("utf-8", "replace")
    moving = [part for line in text.split("\n") for part in line.split("\r")]
    return Shown(
        lines=drawn(text, columns, rows),
        raw=text,
        code=code,
        wrapped=[part for part in moving if len(part) >= columns and "[" in part[:1]],
    )


def drawn(text: str, columns: int = 80, rows: int = 24) -> list[str]:
    """The lines of a terminal after it received `text`, including the scrollback."""
    screen = pyte.HistoryScreen(columns, rows, history=10_000, ratio=1.0)
    pyte.Stream(screen).feed(text)
    above = ["".join(row[i].data for i in range(columns)) for row in screen.history.top]
    lines = [line.rstrip() for line in [*above, *screen.display]]
    while lines and not lines[-1]:
        lines.pop()
    return lines


def gscore(*arguments: str) -> list[str]:
    """The command line of a verb."""
    return [sys.executable, "-m", "gscore", *arguments]
