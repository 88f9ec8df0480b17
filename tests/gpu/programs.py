"""What programs of the tests do with a device; each function prints one line of JSON."""

import hashlib
import json
import os
import sys
from dataclasses import replace

import numpy as np

from gscore.errors import BackendError
from gscore.raster import _native
from gscore.raster.blend_weights import GEOMETRY, blending_weights
from gscore.raster.gpu.devices import find_devices
from gscore.raster.gpu.gpu_raster import GpuRaster
from gscore.raster.gpu.self_test import checks
from gscore.raster.gpu.self_test_arithmetic import exponentials
from gscore.raster.gpu.self_test_gradients import gradient_scenes, gradients
from gscore.raster.gpu.self_test_pictures import drawn, self_test_scenes


def _print(value: object) -> None:
    sys.stdout.write(f"\n{json.dumps(value)}\n")


def _opened() -> GpuRaster:
    """The first device; ends the program where there is none."""
    found = find_devices()
    if not found.devices:
        _print({"absent": " ".join(found.problems)})
        sys.exit()
    return GpuRaster(0)


def print_problems(step: int) -> None:
    """The problems of all tests of the self-test, with one exponential in `step`."""
    problems, subgroup = [], 0
    with _opened() as raster:
        subgroup = find_devices().devices[0].subgroup
        for check in checks():
            if check.name == "exponentials":
                problems += exponentials(raster, step)[0]
            else:
                problems += check.run(raster)[0]
    _print({"problems": problems, "subgroup": subgroup})


def print_bits(repeats: int) -> None:
    """Hashes of all scenes in every repeat."""
    hashes = []
    with _opened() as raster:
        for _ in range(repeats):
            content = hashlib.sha256()
            for scene in self_test_scenes():
                for name, picture in sorted(drawn(scene, raster).items()):
                    content.update(name.encode() + picture.tobytes())
            for scene in gradient_scenes():
                for name, gradient in gradients(scene, raster, fewer=scene.degree == 1).items():
                    content.update(name.encode() + gradient.tobytes())
            hashes.append(content.hexdigest())
    _print({"bits": sorted(set(hashes))})


def print_weights() -> None:
    """Difference of the blending weights to the CPU's, relative to the largest, and the names of
    the kernels that were measured meanwhile."""
    scene = next(iter(self_test_scenes()))
    splats, view = scene.splats(), scene.view()
    size = view.height, view.width, 3
    shares = np.random.default_rng(0).uniform(0, 1, size).astype(np.float32)
    settings = replace(scene.settings, outputs=0, sh_degree=None)
    scratch = {name: np.zeros_like(a) for name, a in zip(GEOMETRY, splats, strict=False)}
    true = blending_weights(splats[:4], view, settings, shares, scratch=scratch)
    with _opened() as raster:
        raster.profile(True)
        drawn(scene, raster)
        found = raster.weights(splats, scene.settings, shares, view)
        kernels = [name for name, (_, calls) in raster.kernel_times().items() if calls]
    _print({"difference": float(abs(found - true).max() / true.max()), "kernels": kernels})


def print_draw_error(scene_number: int = 0) -> None:
    """The class and message of the error of a draw, and whether the next device still draws."""
    scene = list(self_test_scenes())[scene_number]
    raster = _opened()
    try:
        drawn(scene, raster)
        error = None
    except Exception as caught:
        error = [type(caught).__name__, str(caught)]
    try:
        drawn(scene, raster)
        again = ""
    except Exception as caught:
        again = str(caught)
    del os.environ["GSCORE_GPU_FAULT"]
    with GpuRaster(0) as other:
        pictures = drawn(scene, other)
    true = drawn(scene, _native.Raster())
    difference = float(abs(pictures["rgb"] - true["rgb"]).max())
    _print({"error": error, "again": again, "difference": difference})


def print_forked() -> None:
    """Exit codes of a process that drew, and of its fork: 0 where the pictures are right."""
    raster = _opened()
    scene = next(iter(self_test_scenes()))
    true = drawn(scene, _native.Raster())["rgb"]

    def right(one: GpuRaster) -> bool:
        return bool(abs(drawn(scene, one)["rgb"] - true).max() < 1e-4)

    before = right(raster)
    sys.stdout.flush()
    child = os.fork()
    if not child:
        try:
            raster.stats()
            os._exit(2)
        except BackendError:
            with GpuRaster(0) as own:
                os._exit(0 if right(own) else 1)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    _print({"parent": 0 if before and right(raster) else 1, "child": code})
