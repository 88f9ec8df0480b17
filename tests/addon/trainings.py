"""Splats as results of a fake training, and the poll that imports them."""

import time
from collections.abc import Callable

import bpy
import numpy as np

from addon.core import Splats
from addon.process import poll_timer


def splats(count: int, seed: int = 0) -> Splats:
    """Splats around the origin."""
    rng = np.random.default_rng(seed)
    numbers = lambda *shape: rng.normal(size=shape).astype(np.float32)  # noqa: E731
    return Splats(
        means=numbers(count, 3),
        quats=numbers(count, 4),
        scales=numbers(count, 3) - 4,
        opacities=numbers(count),
        sh0=numbers(count, 1, 3),
        shN=numbers(count, 3, 3),
    )


def positions(ob: bpy.types.Object) -> np.ndarray:
    """[N, 3] of the mesh."""
    out = np.empty(len(ob.data.vertices) * 3, np.float32)
    ob.data.attributes["position"].data.foreach_get("vector", out)
    return out.reshape(-1, 3)


def until(condition: Callable[[], bool], timeout: float = 60.0) -> None:
    """Poll like Blender until a condition is true."""
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        poll_timer.poll()
        time.sleep(0.01)
