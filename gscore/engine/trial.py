"""Trial of an engine: the time of a step on random splats, of the size of a training."""

import math
import time
from collections import deque
from typing import Any

import numpy as np

from ..raster.request import Frustum
from ..splats import PARAMETERS, SH_REST_BY_DEGREE
from .base import Columns, Engine, Pending, ShUpdate, StepPhoto, StepRequest, TermKind

SECONDS = 0.5
"""Time of the measured steps; at least one is taken."""
_WARMUP = 1
"""First steps, which allocate memory."""
_SIGMA = 1.0
"""Screen size of a splat times the root of the number per pixel, px: then a step of the CPU takes
as long as its cost model expects, which was fitted to captures."""
_PERIOD = 8
"""Steps between two updates of the SH coefficients, as in most trainings."""


def step_seconds(
    engine: Engine[Any],
    *,
    splats: int,
    sh_degree: int,
    width: int,
    height: int,
    seconds: float = SECONDS,
) -> float:
    """Return the seconds of a training step, measured with the engine's steps in flight.

    Args:
        engine: Opened for this alone, because its memory is used.
        splats: Number of splats.
        sh_degree: Their SH degree.
        width: Width of the view, px.
        height: Height of the view, px.
        seconds: Time of the measurement, after the first steps.

    Raises:
        BackendError: the device failed, or has too little memory.
    """
    model = engine.model(_columns(splats, sh_degree, width, height), counters=("grad2d", "views"))
    photo = StepPhoto(image=np.full((height, width, 3), 128, np.uint8))
    waiting: deque[Pending] = deque()

    def take(step: int) -> None:
        engine.put(0, photo)
        waiting.append(engine.step(model, _request(step, sh_degree, width, height)))
        if len(waiting) > engine.in_flight:
            waiting.popleft().result()

    def wait() -> None:
        while waiting:
            waiting.popleft().result()

    for step in range(1, _WARMUP + 1):
        take(step)
    wait()
    began, taken = time.perf_counter(), 0
    while not taken or time.perf_counter() - began < seconds:
        taken += 1
        take(_WARMUP + taken)
    wait()
    return (time.perf_counter() - began) / taken


def _columns(count: int, sh_degree: int, width: int, height: int) -> Columns:
    """Raw parameters of splats that fill a view of `_request`, unit focal length per width."""
    rng = np.random.default_rng(0)
    z = rng.uniform(1, 3, count)
    place = rng.uniform(-0.5, 0.5, (2, count)) * [[1], [height / width]]
    sigma = _SIGMA * math.sqrt(width * height / max(count, 1)) / width
    scales = np.log(sigma * z)[:, None] + rng.normal(0, 0.5, (count, 3))
    rest = SH_REST_BY_DEGREE[sh_degree]
    columns = {
        "means": np.stack([place[0] * z, place[1] * z, z], axis=1),
        "quats": rng.normal(size=(count, 4)),
        "scales": scales,
        "opacities": rng.normal(-1, 1, count),
        "sh0": rng.normal(0, 0.5, (count, 1, 3)),
        "shN": np.zeros((count, rest, 3)),
    }
    return {name: value.astype(np.float32) for name, value in columns.items()}


def _request(step: int, sh_degree: int, width: int, height: int) -> StepRequest:
    K = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1.0]])
    return StepRequest(
        step=step,
        photo=0,
        view=Frustum(np.eye(4, dtype=np.float32), K.astype(np.float32), width, height),
        background=(0.0, 0.0, 0.0),
        shown_background=(0.0, 0.0, 0.0),
        sh_degree=sh_degree,
        sh_update=ShUpdate.STEP if step % _PERIOD == 0 else ShUpdate.ACCUMULATE,
        rates=dict.fromkeys(PARAMETERS, 1e-9),  # as little as nothing, so that steps stay alike
        terms=((TermKind.L1, 0.8), (TermKind.SSIM, 0.2)),
        observe=("grad2d", "views"),
        extent=1.0,
    )
