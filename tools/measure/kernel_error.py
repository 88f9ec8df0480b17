"""Kernel error over time, by instruction set and degree of the exponential.

python tools/measure/kernel_error.py --ply out/demo/point_cloud.ply --cameras examples/studio

Builds the library for each degree of the exponential's polynomial (build/exp-N), then measures in a
separate process the error of pictures and gradients of random scenes compared to the float64
reference, and nanoseconds per pair on a trained capture. Writes
OUTPUT/{kernel_error.json,kernel-error.svg} and prints a Markdown table.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from gscore.bench.synthetic import synthetic_scene
from gscore.commands.bench.raster import bench_raster
from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.io.files import atomic_write
from gscore.io.ply.splats import read_ply
from gscore.raster import native_library
from gscore.report.curves import Series
from gscore.report.figure import figure
from gscore.stress import native, truth
from gscore.stress.compare import picture_errors, row_errors
from gscore.stress.scenes import draw_scene

ROOT = Path(__file__).parents[2]
DEGREES = (3, 4, 5, 6)
SEEDS = range(8)
"""Seeds of the random scenes."""


def main() -> int:
    """Build, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ply", type=Path, help="splat file; default: a synthetic cloud")
    parser.add_argument("--cameras", type=Path, help="capture of the splats")
    parser.add_argument("--degrees", type=int, nargs="+", default=list(DEGREES))
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "kernel-error")
    parser.add_argument("--measure", metavar="ISA", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.measure:
        native_library.set_isa(args.measure)
        json.dump(errors() | speed(args.ply, args.cameras), sys.stdout)
        return 0
    isas = native_library.available_isas()
    rows = []
    print("| ISA | degree | ns per pair | picture, largest | picture, mean | gradient, median |")
    print("|---|---|---|---|---|---|", flush=True)
    for isa in isas:
        for degree in args.degrees:
            row = {"isa": isa, "degree": degree} | measured(args, isa, build(degree))
            rows.append(row)
            print(
                f"| {isa} | {degree} | {row['ns']:.3f} | {row['picture_max']:.1e} | "
                f"{row['picture_mean']:.1e} | {row['gradient_median']:.1e} |",
                flush=True,
            )
    atomic_write(args.output / "kernel_error.json", json.dumps(rows).encode())
    atomic_write(args.output / "kernel-error.svg", drawing(isas, rows).encode())
    return 0


def build(degree: int) -> Path:
    """Build the library with a polynomial of this degree."""
    folder = ROOT / "build" / f"exp-{degree}"
    tools = Path(sys.executable).parent
    options = ["-DCMAKE_BUILD_TYPE=Release", f"-DGS_EXP_DEGREE={degree}"]
    options.append(f"-DCMAKE_MAKE_PROGRAM={tools / 'ninja'}")
    configure = [tools / "cmake", "-G", "Ninja", "-S", ROOT / "csrc", "-B", folder, *options]
    for command in (configure, [tools / "cmake", "--build", folder]):
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return folder / native_library.library_path().name


def measured(args: argparse.Namespace, isa: str, library: Path) -> dict[str, float]:
    """`errors` and `speed` of another library, in a separate process."""
    command = [sys.executable, __file__, "--measure", isa]
    if args.ply:
        command += ["--ply", args.ply, "--cameras", args.cameras]
    environment = os.environ | {"GSCORE_LIBRARY": str(library)}
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True)
    return json.loads(done.stdout)


def errors() -> dict[str, float]:
    """Errors compared to the float64 reference, outside the band where rounding decides."""
    pictures, gradients = [], []
    for seed in SEEDS:
        scene = draw_scene(
            400 + seed,
            count=1200,
            width=48,
            height=40,
            focal=(60.0, 57.0),
            sigma_px=(0.9, 4.0),
            overscan=0.05,
        )
        true = truth.reference_truth(scene)
        drawn = native.draw(scene, true.weights)
        pictures.append(picture_errors(drawn, true)[~true.band])
        gradients += [
            row_errors(drawn.gradients[k], v) for k, v in true.gradients.items() if k != "viewmat"
        ]
    picture = np.concatenate(pictures)
    return {
        "picture_max": float(picture.max()),
        "picture_mean": float(picture.mean()),
        "gradient_median": float(np.median(np.concatenate(gradients))),
    }


def speed(ply: Path | None, cameras: Path | None) -> dict[str, float]:
    """Nanoseconds per pair, forward and backward blending, all threads."""
    if ply is None or cameras is None:
        splats, views = synthetic_scene()
        chosen = [0]
    else:
        splats = read_ply(ply)
        views = load_dataset(DataConfig(source=cameras)).scene.cameras
        chosen = np.linspace(0, len(views) - 1, 4).round().astype(int).tolist()
    found = bench_raster(splats, views, chosen, repeats=5)
    return {"ns": 1 / found.gpairs_per_s, "pairs_per_pixel": found.pairs_per_pixel}


def drawing(isas: tuple[str, ...] | list[str], rows: list[dict]) -> str:
    """One curve per instruction set, one dot per degree."""
    series = [
        Series(
            label=f"{isa}, degree {', '.join(str(r['degree']) for r in rows if r['isa'] == isa)}",
            points=[(r["ns"], r["picture_max"]) for r in rows if r["isa"] == isa],
            dots=True,
        )
        for isa in isas
    ]
    return figure(
        series,
        title="Largest picture error over time",
        x_label="nanoseconds per pair, forward and backward",
        y_label="largest error of a picture",
        log_x=True,
        log_y=True,
    )


if __name__ == "__main__":
    sys.exit(main())
