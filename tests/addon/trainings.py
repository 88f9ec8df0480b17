"""Splats as results of a fake training, and the poll that imports them."""

import time
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from addon import stored_paths
from addon.core import Splats, write_splats
from addon.process import poll_timer
from tests.addon.calls import import_splats
from tests.addon.captures import STUDIO


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


def placed_run(scene: bpy.types.Scene, run: Path) -> bpy.types.Object:
    """Turned and moved splats of a run in a new folder, of the studio, whose cameras are there."""
    bpy.ops.gscore.import_cameras()
    root = next(ob for ob in scene.objects if ob.get("gs_kind") == "capture")
    run.mkdir()
    write_splats(run / "point_cloud.ply", splats(50))
    ob = import_splats(bpy.context, run / "point_cloud.ply", parent=root)
    stored_paths.write(ob, stored_paths.RUN, run)
    stored_paths.write(ob, stored_paths.SOURCE, STUDIO)
    ob.location, ob.rotation_euler = (0.3, 0.1, -0.2), (0.1, 0.2, 0.3)
    return ob


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
