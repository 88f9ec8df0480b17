"""Graphics card, training: bits, PSNR against the CPU's, resume and speed, as JSON and a table.

    python tools/measure/gpu_train.py --device cpu [--capture FOLDER ...] -o cpu.json
    python tools/measure/gpu_train.py --cpu cpu.json [--capture FOLDER ...] -o gpu.json

The first command may run on another computer. They need gscore's wheel, gpu_forward.py in the same
folder and a Vulkan driver, no checkout and no network. The second takes at most eight minutes on a
card and ends with 1 if a check fails. `--tiny` proves the script on a software device.
"""

import argparse
import hashlib
import json
import platform
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from gpu_forward import ceilings, floors, moved_bytes, print_kernels

import gscore
from gscore.engine.base import ShUpdate, StepPhoto, StepRequest, TermKind
from gscore.engine.gpu.engine import IN_FLIGHT, GpuEngine
from gscore.io.colmap.folder import write_model
from gscore.io.colmap.model import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints
from gscore.io.images.png import write_png
from gscore.io.runs import checkpoints_in
from gscore.raster.gpu.choice import choose, once_a_device
from gscore.raster.gpu.gpu_raster import GpuRaster
from gscore.raster.gpu.timing import timing_splats
from gscore.raster.request import Frustum
from gscore.splats import PARAMETERS
from gscore.stress.capture import toy_photos
from gscore.transforms import rotmat_to_quat

SEEDS = (0, 1)
PSNR_LIMIT = 0.1
"""Largest difference of the mean PSNR to the CPU's, dB."""
RESUMED_LIMIT = 0.5
"""The same for a short run that changes devices, dB: one seed alone."""
RATES = (1e-5, 1e-3, 5e-3, 2.5e-2, 2.5e-3, 1.25e-4)
"""Learning rates of timed steps, in the order of `PARAMETERS`."""
SIZES = ((300_000, 1000, 666), (1_000_000, 1920, 1080))
"""Splats, width and height of timed steps."""
PROFILED = 5
"""Steps whose kernels are measured."""
TOY_SIDE = 96


def write_toy(folder: Path) -> Path:
    """The toy capture as a COLMAP folder."""
    photos = toy_photos(size=TOY_SIDE, views=16)
    cameras, cloud = photos.scene.cameras, photos.scene.points
    K, rows = cameras.Ks[0], len(cloud)
    params = K[[0, 1, 0, 1], [0, 1, 2, 2]]
    camera = ColmapCamera(model="PINHOLE", width=TOY_SIDE, height=TOY_SIDE, params=params)
    no_tracks = {"xys": np.zeros((0, 2)), "point3D_ids": np.zeros(0, np.int64)}
    images = []
    for i, (name, viewmat) in enumerate(zip(cameras.names, cameras.viewmats, strict=True)):
        write_png(folder / "images" / name, photos.images[i])
        pose = {"qvec": rotmat_to_quat(viewmat[:3, :3]), "tvec": viewmat[:3, 3]}
        images.append(ColmapImage(id=i + 1, name=name, camera_id=1, **pose, **no_tracks))
    points = ColmapPoints(
        ids=np.arange(1, rows + 1),
        xyz=cloud.points,
        rgb=cloud.colors,
        error=np.full(rows, 0.5),
        track_lengths=np.zeros(rows, np.int32),
    )
    write_model(ColmapModel(cameras={1: camera}, images=images, points=points), folder / "sparse/0")
    return folder


def trained(
    capture: Path, device: str, steps: int, seed: int, output: Path, **start: Any
) -> dict[str, Any]:
    """Figures of one training of the preset `draft`; `start`: options of `gscore.train`, and
    `saved`, the step of a checkpoint."""
    saved = start.pop("saved", None)
    data, config = gscore.PRESETS["draft"](capture)
    config = replace(config, device=device, iterations=steps, steps_a_photo=0, ensemble=1)
    config = replace(config, seed=seed, checkpoint_iterations=(saved,) if saved else ())
    result = gscore.train(config, replace(data, eval=True), output, **start)
    assert result.psnr is not None
    return {
        "seed": seed,
        "psnr": result.psnr,
        "splats": len(result.splats),
        "train_seconds": result.train_seconds,
        "sha256": hashlib.sha256((output / "point_cloud.ply").read_bytes()).hexdigest(),
    }


def trainings(capture: Path, device: str, steps: int, folder: Path) -> dict[str, Any]:
    """Trainings of a capture with each seed, the first one twice."""
    runs = []
    for i, seed in enumerate((*SEEDS, SEEDS[0])):
        runs.append(trained(capture, device, steps, seed, folder / f"{capture.name}-{i}"))
        note(f"{capture.name}, seed {seed}: {runs[-1]['psnr']:.3f} dB")
    return {
        "capture": capture.name,
        "steps": steps,
        "same_bits": runs[0]["sha256"] == runs[-1]["sha256"],
        "mean_psnr": float(np.mean([run["psnr"] for run in runs[: len(SEEDS)]])),
        "runs": runs,
    }


def resumed(capture: Path, device: str, steps: int, folder: Path) -> dict[str, Any]:
    """A run that goes from the CPU to the device and back, and the CPU's whole run."""
    part = steps // 3
    first, second = folder / "resumed-0", folder / "resumed-1"
    whole = trained(capture, "cpu", steps, 0, first, saved=part)
    options = {"saved": 2 * part, "start_checkpoint": checkpoints_in(first)[part]}
    there = trained(capture, device, steps, 0, second, **options)
    options = {"start_checkpoint": checkpoints_in(second)[2 * part]}
    back = trained(capture, "cpu", steps, 0, folder / "resumed-2", **options)
    names = ("cpu", "cpu, device", "cpu, device, cpu")
    psnr = {n: run["psnr"] for n, run in zip(names, (whole, there, back), strict=True)}
    return {"steps": steps, "changed_after": [part, 2 * part], "psnr": psnr}


def requests(width: int, height: int) -> Iterator[StepRequest]:
    """Steps of one view, with all SH coefficients in each of them."""
    K = np.array([[0.9 * width, 0, width / 2], [0, 0.9 * width, height / 2], [0, 0, 1.0]])
    for step in count(1):
        yield StepRequest(
            step=step,
            photo=0,
            view=Frustum(np.eye(4), K, width, height),
            background=(0.0, 0.0, 0.0),
            shown_background=(0.0, 0.0, 0.0),
            sh_degree=3,
            sh_update=ShUpdate.STEP,
            rates=dict[str, float](zip(PARAMETERS, RATES, strict=True)),
            terms=((TermKind.L1, 0.8), (TermKind.SSIM, 0.2)),
            observe=("grad2d", "views"),
            extent=1.0,
        )


def step_bytes(times: dict[str, Any]) -> dict[str, float]:
    """Bytes that each kernel of a step of SH degree 3 reads and writes, once each."""
    n, v, e = times["splats"], times["visible"], times["entries"]
    pixels = times["size"][0] * times["size"][1]
    drawn = moved_bytes(times)
    return drawn | {
        "blend": drawn["blend"] + 8 * pixels,  # what gradients need
        "loss_compare": 51 * pixels,
        "loss_gradient": 63 * pixels,
        "blend_backward": 104 * e + 20 * pixels,
        # Fifteen planes of values and two moments, twelve of accumulated gradients, in and out.
        "learn": n * (15 * 96 + 12 * 32) + 48 * e + 92 * v,
    }


def timed(raster: GpuRaster, engine: GpuEngine, size: tuple[int, int, int], steps: int) -> Any:
    """Steps a second with `IN_FLIGHT` steps in flight, milliseconds of the kernels beside those of
    the bytes that they move, and of the host."""
    number, width, height = size
    y, x = np.mgrid[:height, :width]
    waves = [np.sin(x / (7 + 5 * c)) * np.cos(y / (9 + 4 * c)) for c in range(3)]
    photo = StepPhoto(image=(127.5 + 127 * np.stack(waves, -1)).astype(np.uint8))
    columns = dict[str, Any](zip(PARAMETERS, timing_splats(number), strict=True))
    model = engine.model(columns, counters=("grad2d", "views"))
    found, pending, host = requests(width, height), deque[Any](), list[float]()

    def run(steps: int) -> list[Any]:
        numbers = []
        for _ in range(steps):
            request = next(found)
            began = time.perf_counter()
            engine.put(0, photo)
            pending.append(engine.step(model, request))
            host.append(time.perf_counter() - began)
            if len(pending) > IN_FLIGHT:
                numbers.append(pending.popleft().result())
        while pending:
            numbers.append(pending.popleft().result())
        return numbers

    first = run(max(3, steps // 5))[0]
    began = time.perf_counter()
    last = run(steps)[-1]
    seconds = time.perf_counter() - began
    host_seconds = float(np.median(host[-steps:]))
    raster.profile(True)
    run(PROFILED)
    kernels = {n: ms / PROFILED for n, (ms, calls) in raster.kernel_times().items() if calls}
    raster.profile(False)
    # The library counts its memory when it draws.
    tiny = replace(next(found).view, width=16, height=16)
    engine.draw([model], tiny, background=(0.0, 0.0, 0.0), antialias=False)
    memory = raster.stats()["device_bytes"]
    model.close()
    engine.release()
    figures: dict[str, Any] = {
        "splats": number,
        "size": [width, height],
        "steps_a_second": steps / seconds,
        "host_ms": host_seconds * 1e3,
        "visible": last.raster["visible"],
        "entries": last.raster["entries"],
        "losses": [first.loss, last.loss],
        "device_bytes": memory,
        "kernels_ms": kernels,
    }
    moved = step_bytes(figures)
    return figures | {"kernels_bytes": moved}


def cpu_means(file: Path, names: list[str], steps: int) -> dict[str, float]:
    """Mean PSNR of the CPU's trainings by capture; ends the program if some are missing."""
    content = json.loads(file.read_text(encoding="utf-8"))["trainings"]
    found = {one["capture"]: one["mean_psnr"] for one in content if one["steps"] == steps}
    if missing := set(names) - set(found):
        sys.exit(f"{file}: it lacks trainings of {', '.join(sorted(missing))} with {steps} steps.")
    return found


def checks(result: dict[str, Any]) -> dict[str, bool]:
    """Whether each requirement is met, by a sentence."""
    found = {}
    if "verdict" in result:
        found["the device passed its self-test"] = result["verdict"]["passed"]
    for one in result["trainings"]:
        found[f"{one['capture']}: the same bits twice"] = one["same_bits"]
        if "psnr_difference" in one:
            close = abs(one["psnr_difference"]) <= PSNR_LIMIT
            found[f"{one['capture']}: within {PSNR_LIMIT} dB of the CPU"] = close
    if "resumed" in result:
        psnr = result["resumed"]["psnr"].values()
        found["resumed on the device and the CPU"] = max(psnr) - min(psnr) <= RESUMED_LIMIT
    for one in result.get("times", ()):
        found[f"{one['splats']} splats: the loss falls"] = one["losses"][1] < one["losses"][0]
    return found


def print_table(result: dict[str, Any]) -> None:
    """Print figures and checks as text."""
    for one in result["trainings"]:
        psnr = ", ".join(f"{run['psnr']:.3f}" for run in one["runs"])
        found = one.get("psnr_difference")
        print(
            f"{one['capture']:<20} {psnr} dB"
            + ("" if found is None else f", {found:+.3f} dB to the CPU")
        )
    for one in result.get("times", ()):
        print(
            f"{one['splats']:>9} splats, {'x'.join(map(str, one['size']))}: "
            f"{one['steps_a_second']:.2f} steps/s, {one['device_bytes'] / 2**20:.0f} MiB, "
            f"host {one['host_ms']:.3f} ms a step"
        )
        print_kernels(one)
    for name, passed in result["checks"].items():
        print(f"{'ok' if passed else 'FAILED':<7}{name}")


def note(text: str) -> None:
    """Print progress."""
    print(text, file=sys.stderr, flush=True)


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Measure trainings on a graphics card.")
    parser.add_argument("--device", default="gpu", help="cpu, gpu, or a number of gscore doctor")
    parser.add_argument("--capture", type=Path, action="append", default=[], metavar="FOLDER")
    parser.add_argument("--cpu", type=Path, help="figures of --device cpu", metavar="FILE.json")
    parser.add_argument("--steps", type=int, help="of each training (4000)")
    parser.add_argument("--tiny", action="store_true", help="small, for software devices")
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    steps = options.steps or (12 if options.tiny else 4000)
    names = [one.resolve().name for one in options.capture] or ["toy"]
    if len(set(names)) < len(names):
        parser.error("Captures need folders of different names.")
    cpu = cpu_means(options.cpu, names, steps) if options.cpu else {}
    chosen = choose(options.device, report=once_a_device(note))
    result: dict[str, Any] = {"platform": platform.platform(), "device": chosen.identity}
    device = "cpu"
    if chosen.device is not None:
        device, result["verdict"] = str(chosen.device.number), chosen.device.to_dict()["verdict"]
    with tempfile.TemporaryDirectory(prefix="gscore-") as name:
        folder = Path(name)
        toy = write_toy(folder / "toy")
        captures = [one.resolve() for one in options.capture] or [toy]
        result["trainings"] = [trainings(one, device, steps, folder) for one in captures]
        if device != "cpu":
            result["resumed"] = resumed(toy, device, min(steps, 300), folder)
    if chosen.device is not None:
        sizes, timed_steps = (((2000, 96, 64),), 5) if options.tiny else (SIZES, 100)
        raster = GpuRaster(chosen.device.number)
        engine = GpuEngine(raster, name=chosen.name, numerics=chosen.identity)
        result["times"] = [timed(raster, engine, size, timed_steps) for size in sizes]
        result["ceilings"] = ceilings(raster, tiny=options.tiny)
        for one in result["times"]:
            one["floors_ms"] = floors(one["kernels_bytes"], result["ceilings"])
        engine.close()
    for one in result["trainings"] if cpu else ():
        one["psnr_difference"] = one["mean_psnr"] - cpu[one["capture"]]
    result["checks"] = checks(result)
    if options.output:
        options.output.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    print_table(result)
    return int(not all(result["checks"].values()))


if __name__ == "__main__":
    sys.exit(main())
