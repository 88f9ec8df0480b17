"""How long the add-on holds Blender's main thread while it trains, and when a result arrives.

    python tools/measure/blender_thread.py CAPTURE --python PYTHON_THAT_TRAINS   (a Python with bpy)

Calls the beat that Blender's timer calls, as often as the timer does, during a real training with
live splats and pictures, and prints milliseconds by what the beat did. Then the same for the
arrival of `--splats` splats of SH degree 3.
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
    parser.add_argument("--seconds", type=float, default=60.0, help="then the training is stopped")
    parser.add_argument("--splats", type=int, default=1_000_000)
    return parser.parse_args()


def show(name: str, milliseconds: list[float]) -> None:
    """A row: how many, median, 99th percentile, longest."""
    x = np.array(milliseconds or [0.0])
    print(
        f"{name:34} {len(milliseconds):6} {np.median(x):8.2f} {np.percentile(x, 99):8.2f} "
        f"{x.max():8.2f}"
    )


def mesh_of(scene: bpy.types.Scene) -> int:
    """Address of the mesh that the result shows; 0 without one."""
    ob = scene.gscore.result
    return ob.data.as_pointer() if ob else 0


def training(options: argparse.Namespace) -> None:
    """Beats while a trainer works."""
    from addon import preferences
    from addon.job import display, session, training
    from addon.process import beat

    prefs = preferences.get()
    prefs.python_path = str(options.python)
    prefs.live_seconds, prefs.preview_seconds = 3.0, 5.0
    scene = bpy.context.scene
    scene.gscore.capture_path = str(options.capture.resolve())
    scene.gscore.output_path = str(Path(tempfile.mkdtemp()) / "run")
    scene.gscore.preset = options.preset
    bpy.ops.gscore.import_cameras()
    began = time.monotonic()
    job = training.train(scene)
    beats: dict[str, list[float]] = {"reading lines": [], "a picture": [], "splats": []}
    while display.waits(job):
        picture, mesh, splats = job.preview_shown, mesh_of(scene), job.filling
        start = time.perf_counter()
        beat.tick()
        took = (time.perf_counter() - start) * 1000
        kind = "splats" if splats or job.filling or mesh != mesh_of(scene) else "reading lines"
        beats["a picture" if job.preview_shown != picture else kind].append(took)
        late = time.monotonic() - began > options.seconds
        if late and job.state.status == session.RUNNING:
            job.stop()
        time.sleep(beat.FAST if display.filling() else beat.INTERVAL)
    for kind, values in beats.items():
        show(f"training, {kind}", values)
    show("training, all", [v for values in beats.values() for v in values])
    print(job.state.sentence)


def arrival(count: int) -> None:
    """Steps in which many splats are handed over."""
    from addon.attributes import NO_SPLATS
    from addon.core import Splats, write_splats
    from addon.job import loader
    from addon.splats import filling, objects

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
    reader = loader.Loader()
    reader.request(path, final=True)
    while reader.busy:
        time.sleep(0.01)
    loaded = reader.take()
    assert loaded is not None
    ob = objects.create(NO_SPLATS, "many")
    steps, mesh, hand = [], None, filling.Filling(loaded)
    while mesh is None:
        start = time.perf_counter()
        mesh = hand.step()
        if mesh is not None:
            filling.replace(ob, mesh)
        steps.append((time.perf_counter() - start) * 1000)
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
        print(f"{'':34} {'n':>6} {'median':>8} {'p99':>8} {'max':>8}")
        training(options)
        arrival(options.splats)
    finally:
        addon.unregister()
        sys.stdout.flush()


if __name__ == "__main__":
    main()
