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
from gscore.raster.gpu.choice import Chosen
from gscore.raster.gpu.devices import find_devices
from gscore.raster.gpu.gpu_raster import GpuRaster
from gscore.raster.gpu.self_test import checks
from gscore.raster.gpu.self_test_arithmetic import exponentials
from gscore.raster.gpu.self_test_gradients import gradient_scenes, gradients
from gscore.raster.gpu.self_test_pictures import SelfTestScene, drawn, self_test_scenes
from gscore.raster.gpu.verdict import DeviceVerdict, keep_verdict
from gscore.raster.request import Settings


def _print(value: object) -> None:
    sys.stdout.write(f"\n{json.dumps(value)}\n")


def _opened() -> GpuRaster:
    """The first device; ends the program where there is none."""
    found = find_devices()
    if not found.devices:
        _print({"absent": " ".join(found.problems)})
        sys.exit()
    return GpuRaster(0)


def keep_passed() -> None:
    """Keep a passing verdict of the first device, so that later programs need no self-test, which
    has a time limit."""
    with _opened():
        keep_verdict(find_devices().devices[0].key, DeviceVerdict(passed=True))
    _print({})


def print_problems(step: int) -> None:
    """The problems of all tests of the self-test, with one exponential in `step`."""
    with _opened() as raster:
        _print({"problems": _problems(raster, step)})


def _problems(raster: GpuRaster, step: int) -> list[str]:
    problems = []
    for check in checks():
        if check.name == "exponentials":
            problems += exponentials(raster, step)[0]
        else:
            problems += check.run(raster)[0]
    return problems


def print_all(step: int, repeats: int) -> None:
    """Problems, hashes and weights of one device, and the width of its subgroups."""
    with _opened() as raster:
        found = {"problems": _problems(raster, step), "bits": _bits(raster, repeats)}
        found |= {"subgroup": find_devices().devices[0].subgroup, "weights": _weights(raster)}
    _print(found)


def print_bits(repeats: int) -> None:
    """Hashes of all scenes in every repeat."""
    with _opened() as raster:
        _print({"bits": _bits(raster, repeats)})


def _bits(raster: GpuRaster, repeats: int) -> list[str]:
    hashes = []
    for _ in range(repeats):
        content = hashlib.sha256()
        for scene in self_test_scenes():
            for name, picture in sorted(drawn(scene, raster).items()):
                content.update(name.encode() + picture.tobytes())
        for scene in gradient_scenes():
            for name, gradient in gradients(scene, raster, fewer=scene.degree == 1).items():
                content.update(name.encode() + gradient.tobytes())
        hashes.append(content.hexdigest())
    return sorted(set(hashes))


def _weights(raster: GpuRaster) -> dict[str, object]:
    """Difference of the blending weights to the CPU's, relative to the largest, and the names of
    the kernels that were measured meanwhile."""
    scene = next(iter(self_test_scenes()))
    splats, view = scene.splats(), scene.view()
    size = view.height, view.width, 3
    shares = np.random.default_rng(0).uniform(0, 1, size).astype(np.float32)
    settings = replace(scene.settings, outputs=0, sh_degree=None)
    scratch = {name: np.zeros_like(a) for name, a in zip(GEOMETRY, splats, strict=False)}
    true = blending_weights(splats[:4], view, settings, shares, scratch=scratch)
    raster.profile(True)
    drawn(scene, raster)
    found = raster.weights(splats, scene.settings, shares, view)
    kernels = [name for name, (_, calls) in raster.kernel_times().items() if calls]
    return {"difference": float(abs(found - true).max() / true.max()), "kernels": kernels}


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


def print_large_picture() -> None:
    """Share of the numbers of a picture of 7680 x 4320 px that differ from the CPU's."""
    scene = SelfTestScene(name="8k", count=20, width=7680, height=4320, sigma=(2.0, 40.0), degree=0)
    with _opened() as raster:
        found = drawn(scene, raster)["rgb"]
    true = drawn(scene, _native.Raster())["rgb"]
    different = float((abs(found - true) > 3e-5).mean())
    _print({"different": different, "drawn": float(true.max())})


def print_rows_with_nan() -> None:
    """Largest difference to the CPU's picture of splats of which each number of a row is once
    infinite or not a number, and the radii of these."""
    scene = SelfTestScene(name="broken", count=100)
    splats, damaged = scene.splats(), []
    for array in splats[:4]:
        for column in range(array[0].size):
            for value in (np.nan, np.inf, -np.inf):
                array.reshape(len(array), -1)[len(damaged), column] = value
                damaged.append(value)
    found = []
    with _opened() as raster:
        for one in (raster, _native.Raster()):
            size = scene.height, scene.width
            pictures = {"rgb": np.ones((*size, 3), np.float32), "alpha": np.ones(size, np.float32)}
            pictures["radii"] = np.ones(scene.count, np.int32)
            one.forward(splats, scene.view(), Settings(), pictures)
            found.append(pictures)
    card, cpu = found
    _print(
        {
            "difference": float(max(abs(card[name] - cpu[name]).max() for name in cpu)),
            "damaged": card["radii"][: len(damaged)].tolist(),
            "others": int((card["radii"] > 0).sum()),
        }
    )


def _blank(count: int) -> list[np.ndarray]:
    """Splats of SH degree 3, all zeros."""
    return [np.zeros((count, *a.shape[1:]), np.float32) for a in SelfTestScene(name="").splats()]


def print_small_memory() -> None:
    """The error of a model that is larger than the memory, what a small picture differs from the
    CPU's afterwards, copies of kept models of which three fit, and who drew where the CPU may."""
    found = find_devices().devices
    scene, large = next(iter(self_test_scenes())), _blank(1_300_000)
    true = drawn(scene, _native.Raster())["rgb"]
    view, settings = scene.view(), Settings()
    pictures = {"rgb": np.ones_like(true), "alpha": np.ones(true.shape[:2], np.float32)}
    with _opened() as raster:
        try:
            raster.forward(large, view, settings, pictures)
            error = None
        except Exception as caught:
            error = [type(caught).__name__, str(caught)]
        difference = float(abs(drawn(scene, raster)["rgb"] - true).max())
        before, models = raster.uploads, [_blank(200_000) for _ in range(6)]
        for model in models:
            raster.keep(model, settings)
            raster.forward(model, view, settings, pictures)
        uploads = raster.uploads - before
    chosen = Chosen(device=found[0], fallback=True)
    chosen.forward(large, view, settings, pictures, keep=True)
    _print(
        {
            "error": error,
            "difference": difference,
            "uploads": uploads,
            "name": chosen.name.partition(", then ")[2],
        }
    )


def print_all_devices() -> None:
    """Name of each device, and what its picture differs from the CPU's, while all are open."""
    scene = next(iter(self_test_scenes()))
    true = drawn(scene, _native.Raster())["rgb"]
    devices = find_devices().devices
    rasters = [GpuRaster(device.number) for device in devices]
    found = [float(abs(drawn(scene, raster)["rgb"] - true).max()) for raster in rasters]
    _print({device.name: error for device, error in zip(devices, found, strict=True)})
