"""Helpers of tests of the render server: splats, pictures, another server, waiting."""

import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gscore import Rendered, Splats, render
from gscore.raster.render_client import RenderClient

ROOT = Path(__file__).parents[2]
DEADLINE = 60.0
POSIX = sys.platform != "win32"
PATH = "import os, sys; sys.path[:0] = sys.argv[1].split(os.pathsep); import gscore"
"""Begin of the code of another server; goes on with a module of gscore."""
WAITING = f"""{PATH}.raster.render_server as s
import time
answer = s.RenderServer.answer
def answer_after_cancel(self, message, cancel):
    found = answer(self, message, cancel)
    if "stats" not in found or message["view"]["width"] != 77:
        return found
    while not cancel.value.value:
        time.sleep(0.01)
    return answer(self, message, cancel)
s.RenderServer.answer = answer_after_cancel
s.main(sys.argv[2:])
"""
"""Code of a server that draws a picture 77 px wide until that is cancelled."""
SLOW = (77, 50)
needs_posix = pytest.mark.skipif(not POSIX, reason="signals and unnamed files are POSIX's")


def splats_of(count: int = 300) -> Splats:
    """Random splats in front of the camera."""
    rng = np.random.default_rng(count)
    return Splats(
        means=(rng.normal(size=(count, 3)) * (1, 1, 0.3) + (0, 0, 4)).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        scales=rng.uniform(-4, -2, (count, 3)).astype(np.float32),
        opacities=rng.uniform(-2, 3, count).astype(np.float32),
        sh0=rng.normal(size=(count, 1, 3)).astype(np.float32),
        shN=(0.2 * rng.normal(size=(count, 8, 3))).astype(np.float32),
    )


def drawn(splats: Splats, size: tuple[int, int] = (85, 64), **how: Any) -> Rendered:
    """The picture of a camera with a turned axis."""
    width, height = size
    K = np.array([[70, 0, width / 2], [0, 71, height / 2], [0, 0, 1.0]])
    viewmat = np.eye(4)
    viewmat[:2, :2] = [[0.8, -0.6], [0.6, 0.8]]
    return render(splats, K, viewmat, width, height, **how)


def same(one: Rendered, other: Rendered) -> bool:
    """Whether two pictures have the same bits."""
    pairs = [(getattr(one, f.name), getattr(other, f.name)) for f in fields(Rendered)]
    return all(np.array_equal(a, b) and type(a) is type(b) for a, b in pairs)


def wait_for(condition: Callable[[], object]) -> None:
    """Wait until a condition holds, and fail after the deadline."""
    until = time.monotonic() + DEADLINE
    while not condition():
        assert time.monotonic() < until, "waited in vain"
        time.sleep(0.01)


def is_gone(pid: int) -> bool:
    """Whether a process has ended; the system may not have collected it yet."""
    # It may end between the opening of the file and the reading.
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


class Drawing:
    """A picture drawn in a thread."""

    def __init__(self, client: RenderClient, *args: Any, **how: Any) -> None:
        self.result: Any = None
        self._thread = threading.Thread(target=self._run, args=(client, args, how), daemon=True)
        self._thread.start()

    def _run(self, client: RenderClient, args: Any, how: Any) -> None:
        try:
            self.result = drawn(*args, device=client, **how)
        except Exception as error:
            self.result = error

    def end(self) -> Any:
        """The picture, or the exception."""
        self._thread.join(DEADLINE)
        assert not self._thread.is_alive()
        return self.result
