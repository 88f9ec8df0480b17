"""Process of a render server: its start, its messages, its end."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np

from .gpu.verification import python_program
from .render_messages import Message, SharedMemory, read_message, write_message

_CODE = (
    "import os, sys; sys.path[:0] = sys.argv[1].split(os.pathsep); "
    "from gscore.raster.render_server import main; main(sys.argv[2:])"
)


class ServerProcess:
    """A server process, and the memory shared with it."""

    def __init__(
        self, device: str, idle: float, folder: str | None, ended: "Callable[[ServerProcess], None]"
    ) -> None:
        """Start a server.

        Args:
            device: As for `open_device`, or `LIST`.
            idle: Seconds without requests after which it ends.
            folder: As for `RenderClient`.
            ended: Called in a thread after its end.

        Raises:
            OSError: it cannot be started.
        """
        self.memory = SharedMemory.created(folder)
        self.facts: Message | None = None
        """The first answer; None: it is not ready."""
        self.end: int | None = None
        """The exit code; None: it runs, or has answers left."""
        self._answers: SimpleQueue[Message | None] = SimpleQueue()
        self._ended = ended
        command = [python_program(), "-I", "-c", _CODE, _search_path()]
        self.process = subprocess.Popen(
            [*command, device, str(idle), self.memory.name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=self.memory.files,
            **_own_session(),
        )
        threading.Thread(target=self._read, name="gscore-render-client", daemon=True).start()

    def send(self, message: Message) -> None:
        """Send a message; nothing happens if the server has ended."""
        assert self.process.stdin is not None
        with contextlib.suppress(OSError, ValueError):
            write_message(self.process.stdin, message)

    def answer(self, timeout: float) -> Message | None:
        """The next answer; None if there is none within `timeout` seconds."""
        with contextlib.suppress(Empty):
            answer = self._answers.get(timeout=timeout)
            if answer is None:
                self.end = self.process.returncode
            return answer
        return None

    def kill(self) -> None:
        """Kill the server; a self-test that it runs ends with it."""
        with contextlib.suppress(OSError):
            if sys.platform == "win32":
                self.process.kill()
            elif self.process.poll() is None:
                os.killpg(self.process.pid, signal.SIGKILL)

    def _read(self) -> None:
        assert self.process.stdout is not None and self.process.stdin is not None
        try:
            with contextlib.suppress(OSError), self.process.stdout as stream:
                while (message := read_message(stream)) is not None:
                    self._answers.put(message)
        except ValueError as error:  # garbage: it cannot be read on
            self._answers.put({"error": [type(error).__name__, f"The render server sent {error}."]})
            self.kill()
        self.process.wait()
        with contextlib.suppress(OSError):
            self.process.stdin.close()
        self._answers.put(None)
        self._ended(self)


def _search_path() -> str:
    """Folders of gscore and numpy; -I leaves out all others of Blender."""
    folders = (Path(__file__).parents[2], Path(np.__file__).parents[1])
    return os.pathsep.join(dict.fromkeys(map(str, folders)))


def _own_session() -> Mapping[str, Any]:
    """Options of Popen with which a Ctrl-C for this process does not reach the server."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NO_WINDOW}
    return {"start_new_session": True}
