"""Processes that are forked; oracle: bits of the parent's picture, and the clock."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator

import numpy as np
import pytest
import torch

from gscore.bench.synthetic import synthetic_scene
from gscore.raster.api import render
from gscore.raster.autograd import rasterize
from gscore.splats import PARAMETERS

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
PATIENCE = 60
"""Seconds that a child may take for milliseconds of work."""


def _draw(threads: int) -> bytes:
    splats, cameras = synthetic_scene(300, 64, 48)
    shown = render(splats, cameras.Ks[0], cameras.viewmats[0], 64, 48, threads=threads)
    return shown.rgb.tobytes()


def _gradient(threads: int) -> bytes:
    splats, cameras = synthetic_scene(300, 64, 48)
    leaves = [torch.from_numpy(getattr(splats, n).copy()).requires_grad_() for n in PARAMETERS]
    camera = [torch.from_numpy(np.float32(m[0])) for m in (cameras.viewmats, cameras.Ks)]
    rasterize(*leaves, *camera, 64, 48, raw=True, threads=threads).rgb.sum().backward()
    assert leaves[0].grad is not None
    return leaves[0].grad.numpy().tobytes()


def _work(threads: int) -> bytes:
    return _draw(threads) + _gradient(threads)


@pytest.fixture
def busy() -> Iterator[None]:
    """Another thread that renders without a pause."""
    stop = threading.Event()

    def draw() -> None:
        while not stop.is_set():
            _draw(3)

    worker = threading.Thread(target=draw)
    worker.start()
    yield
    stop.set()
    worker.join()


def _child_draws(expected: bytes) -> bool:
    """True if a child of os.fork renders the same bits in time."""
    child = os.fork()
    if child == 0:
        signal.alarm(PATIENCE)  # ends a child that hangs
        try:
            os._exit(0 if _work(2) == expected else 1)
        finally:
            os._exit(2)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_a_fork_after_a_render_draws() -> None:
    """Oracle: as above; the parent renders again afterwards."""
    expected = _work(2)
    assert _child_draws(expected)
    assert _work(3) == expected


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_forks_while_another_thread_renders_draw(busy: None) -> None:
    """Oracle: as above, for many forks, each at another point of the other thread."""
    expected = _work(2)
    assert all(_child_draws(expected) for _ in range(12))


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_a_pool_of_forked_processes_draws(busy: None) -> None:
    """Oracle: as above, by multiprocessing with its start method fork."""
    expected = _work(2)
    with multiprocessing.get_context("fork").Pool(2) as pool:
        found = pool.map_async(_work, [2, 3, 2, 1]).get(timeout=PATIENCE)
    assert found == [expected] * 4
