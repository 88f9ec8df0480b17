"""Programs that run in a fork of a process with gscore and torch loaded: nine tenths of the time of
a short run are imports. What a test names must come after them."""

import multiprocessing
import os
import runpy
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any

_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(
    [
        *("gscore.commands.train", "gscore.commands.sequence", "gscore.trainer.run"),
        *("gscore.trainer.worker_rank", "gscore.stress.capture", "scipy.spatial", "PIL.Image"),
    ]
)


class Forked:
    """A Python program with the interface of `subprocess.Popen`."""

    def __init__(
        self,
        words: Sequence[str],
        *,
        stdin: int = subprocess.DEVNULL,
        stdout: IO[str] | None = None,
        env: dict[str, str] | None = None,
        cwd: Path | None = None,
    ) -> None:
        """Run `python WORDS`, which begin with -m or -c.

        Args:
            words: Arguments of the interpreter.
            stdin: PIPE or DEVNULL.
            stdout: A file; None: a pipe.
            env: The environment.
            cwd: The working folder.
        """
        (read, out), (err_read, err) = os.pipe(), os.pipe()
        if stdout is not None:
            os.dup2(stdout.fileno(), out)
        source, sink = os.pipe()
        if stdin == subprocess.DEVNULL:
            os.dup2(os.open(os.devnull, os.O_RDONLY), source)
        self.stdin = os.fdopen(sink, "w")
        self.stdout, self.stderr = os.fdopen(read), os.fdopen(err_read)
        streams = [Connection(fd) for fd in (source, out, err)]
        where = os.fspath(cwd or Path.cwd()), dict(os.environ if env is None else env)
        self._process = _CONTEXT.Process(target=_run, args=(list(words), *where, streams))
        self._process.start()
        for stream in streams:
            stream.close()
        self.pid = self._process.pid or 0

    @property
    def returncode(self) -> int | None:
        """Exit code; None: it runs."""
        return self._process.exitcode

    def poll(self) -> int | None:
        return self._process.exitcode

    def send_signal(self, number: int) -> None:
        if self._process.exitcode is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self._process.kill()

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end; `subprocess.TimeoutExpired` if it takes longer."""
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired("forked", timeout or 0)
        return self._process.exitcode

    def communicate(self, text: str = "", timeout: float | None = None) -> tuple[str, str]:
        """Send `text`, close stdin, and return the rest of both outputs at the end."""
        found = ["", ""]

        def read(place: int, stream: IO[str]) -> None:
            found[place] = stream.read()

        streams = [one for one in (self.stdout, self.stderr) if not one.closed]
        threads = [threading.Thread(target=read, args=pair) for pair in enumerate(streams)]
        for thread in threads:
            thread.start()
        if not self.stdin.closed:
            self.stdin.write(text)
            self.stdin.close()
        self.wait(timeout)
        for thread in threads:
            thread.join()
        return found[0], found[1]

    def close(self) -> None:
        """Kill it and close its streams."""
        self.kill()
        self._process.join()
        for stream in (self.stdin, self.stdout, self.stderr):
            stream.close()


def _run(words: list[str], cwd: str, env: dict[str, str], streams: list[Any]) -> None:
    os.environ.clear()
    os.environ.update(env)
    os.chdir(cwd)
    for fd, stream in enumerate(streams):
        os.dup2(stream.fileno(), fd)
        stream.close()
    sys.stdin, sys.stdout = open(0), open(1, "w")  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1, errors="backslashreplace")  # noqa: SIM115
    for number in (signal.SIGHUP, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    flag, what, *rest = words
    sys.argv = [what, *rest]
    if flag == "-m":
        runpy.run_module(what, run_name="__main__", alter_sys=True)
    else:
        sys.argv[0] = "-c"
        exec(compile(what, "-c", "exec"), {"__name__": "__main__"})
