"""CPU pace: the speed of this machine relative to the reference machine, and its cost model."""

import time
from functools import cache

import numpy as np

from ...raster.api import render
from ...splats import Splats
from ..base import CostModel

COST = CostModel(step=6.3e-4, pixel=7.1e-8, splat=7.7e-8, number=5.7e-10)
"""Cost on the reference machine: 2 cores of a Xeon with AVX-512 (`tools/measure/step_time.py`)."""
_REFERENCE_MS = 2.61
"""Milliseconds of rendering `_test_scene` on the reference machine."""
_SPLATS, _WIDTH, _HEIGHT = 20_000, 320, 240
_TRIES = 10
_WARMUP = 2
"""Number of first renders excluded from the mean, because they start threads and fill caches."""


@cache
def machine_pace(threads: int = 0) -> float:
    """Render time on this machine relative to the reference machine.

    Measured once per process, in a few dozen milliseconds: the fastest of some renders, because
    other programs disturb it least.

    Args:
        threads: 0: all cores.

    Raises:
        BackendError: The native library is missing.
    """
    return min(_paces(threads))


def current_pace(threads: int = 0) -> float:
    """Like `machine_pace`, but the mean under the current load: for a run that starts now.

    Args:
        threads: 0: all cores.

    Raises:
        BackendError: The native library is missing.
    """
    paces = _paces(threads)[_WARMUP:]
    return sum(paces) / len(paces)


def _paces(threads: int) -> list[float]:
    """Times of `_TRIES` renders relative to the reference machine."""
    splats, K, viewmat = _test_scene()
    paces = []
    for _ in range(_TRIES):
        began = time.perf_counter()
        render(splats, K, viewmat, _WIDTH, _HEIGHT, depths=False, threads=threads, device="cpu")
        paces.append(1000 * (time.perf_counter() - began) / _REFERENCE_MS)
    return paces


def _test_scene() -> tuple[Splats, np.ndarray, np.ndarray]:
    """Splats, K and viewmat of a ball whose splats have about the screen size of a capture's."""
    rng = np.random.default_rng(0)
    splats = Splats(
        means=rng.normal(size=(_SPLATS, 3)).astype(np.float32),
        quats=rng.normal(size=(_SPLATS, 4)).astype(np.float32),
        scales=rng.normal(-3.5, 0.5, (_SPLATS, 3)).astype(np.float32),
        opacities=rng.normal(size=_SPLATS).astype(np.float32),
        sh0=rng.normal(size=(_SPLATS, 1, 3)).astype(np.float32),
        shN=np.zeros((_SPLATS, 0, 3), np.float32),
    )
    K = np.array([[300.0, 0, _WIDTH / 2], [0, 300.0, _HEIGHT / 2], [0, 0, 1]])
    viewmat = np.eye(4)
    viewmat[2, 3] = 4.0
    return splats, K, viewmat
