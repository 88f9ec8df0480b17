"""Blocking of Blender's main thread during a training, and on arrival of its results.

    python tools/measure/blender_thread.py CAPTURE --python PYTHON_THAT_TRAINS   (a Python with bpy)

Starts a training with live splats and pictures, calls the poll function as often as Blender's timer
does, and prints milliseconds by the work of each call. Then measures the arrival of `--splats`
splats of SH degree 3.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import bpy
import numpy as np

ROOT = Path(__file__).resolve().parents[2]


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("--python", type=Path, required=True)
    parser.add_argument("--preset", default="preview")
    parser.add_argument("--seconds", type=float, default=60.0, help="time limit of the training")
    parser.add_argument("--splats", type=int, default=1_000_000)
    return parser.parse_args()


class Watch:
    """Context that measures wall-clock and CPU milliseconds; other programs do not affect the
    latter."""

    def __enter__(self) -> "Watch":
        self._began = time.perf_counter(), time.thread_time()
        return self

    def __exit__(self, *_: object) -> None:
        ends = time.perf_counter(), time.thread_time()
        self.took = tuple((b - a) * 1000 for a, b in zip(self._began, ends, strict=True))


def show(name: str, took: list[tuple[float, ...]]) -> None:
    """Print a row: count, median, 99th percentile, maximum, and maximum of the CPU time."""
    x, own = np.array(took or [(0.0, 0.0)]).T
    print(
        f"{name:34} {len(took):6} {np.median(x):8.2f} {np.percentile(x, 99):8.2f} {x.max():8.2f} "
        f"{own.max():8.2f}"
    )


def mesh_of(scene: bpy.types.Scene) -> int:
    """Address of the mesh of the result; 0 without one."""
    ob = scene.gscore.result
    return ob.data.as_pointer() if ob else 0


def training(options: argparse.Namespace) -> None:
    """Measure poll calls during a training."""
    from addon import preferences
    from addon.process import poll_timer
    from addon.training import display, run_state, start_training

    prefs = preferences.get()
    prefs.python_path = str(options.python)
    prefs.live_seconds, prefs.preview_seconds = 3.0, 5.0
    scene = bpy.context.scene
    scene.gscore.capture_path = str(options.capture.resolve())
    scene.gscore.output_path = str(Path(tempfile.mkdtemp()) / "run")
    scene.gscore.preset = options.preset
    bpy.ops.gscore.import_cameras()
    began = time.monotonic()
    with Watch() as click:
        job = start_training.train(scene)
    show("the click on Train", [click.took])
    kinds = ("reading lines", "building the display", "a picture", "splats")
    beats: dict[str, list[tuple[float, ...]]] = {kind: [] for kind in kinds}
    while display.waits(job):
        picture, mesh, splats = job.preview_shown, mesh_of(scene), job.filling
        preparations = len(job.preparations)
        with Watch() as watch:
            poll_timer.poll()
        kind = "splats" if splats or job.filling or mesh != mesh_of(scene) else "reading lines"
        if job.preview_shown != picture:
            kind = "a picture"
        elif len(job.preparations) != preparations:
            kind = "building the display"
        beats[kind].append(watch.took)
        late = time.monotonic() - began > options.seconds
        if late and job.state.status == run_state.RUNNING:
            job.stop()
        time.sleep(poll_timer.FAST if display.is_importing() else poll_timer.INTERVAL)
    for kind, values in beats.items():
        show(f"training, {kind}", values)
    show("training, all", [v for values in beats.values() for v in values])
    print(job.state.sentence)


def arrival(count: int) -> None:
    """Measure the steps in which many splats arrive."""
    from addon.attributes import NO_SPLATS
    from addon.core import Splats, write_splats
    from addon.splats import objects, write_chunked
    from addon.training import loader

    rng = np.random.default_rng(0)

    def numbers(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape, np.float32)

    splats = Splats(
        means=numbers(count, 3),
        quats=numbers(count, 4),
        scales=numbers(count, 3) - 5,
        opacities=numbers(count),
        sh0=numbers(count, 1, 3),
        shN=numbers(count, 15, 3),
    )
    path = Path(tempfile.mkdtemp()) / "many.ply"
    write_splats(path, splats)
    del splats
    loaded = loader.load(path, final=True)
    ob = objects.create(NO_SPLATS, "many")
    steps, mesh, hand = [], None, write_chunked.ChunkedWrite(loaded)
    while mesh is None:
        with Watch() as watch:
            mesh = hand.step()
            if mesh is not None:
                write_chunked.replace(ob, mesh)
        steps.append(watch.took)
    show(f"{count:,} splats arrive", steps)


def main() -> None:
    """Measure and print."""
    options = parse()
    sys.path.insert(0, str(ROOT))
    import addon

    bpy.ops.wm.read_homefile(use_empty=True)
    addon.register()
    try:
        print(f"Blender {bpy.app.version_string}, milliseconds of the main thread")
        print(f"{'':34} {'n':>6} {'median':>8} {'p99':>8} {'max':>8} {'CPU max':>8}")
        training(options)
        arrival(options.splats)
    finally:
        addon.unregister()
        sys.stdout.flush()


if __name__ == "__main__":
    main()
