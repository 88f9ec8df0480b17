"""Redraws of a view of splats in Blender: rate and time.

    GSCORE_BLENDER=PROGRAM python tools/measure/redraws.py [--splats N | --ply FILE] [--mesh]

Starts Blender 4.2 or later in a window on a virtual screen with software rendering, orbits the
splats and stops. Prints a table as in docs/experiments/2026-11-redraws.md: redraws per second
(median, and with all waits), milliseconds of the main thread in the add-on without GPU work
(median, maximum) and with it, drawn splats, draw calls, and megabytes per redraw that are uploaded
and read by the GPU. While a view comes to rest, the last four are sums over all redraws until it is
complete. Needs Xvfb.
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import gscore
from gscore.bench.synthetic import synthetic_scene

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from tools.window import programs  # noqa: E402

LONGEST = 280
"""Time limit, s."""
BYTES = 64
"""Bytes per splat read by the GPU: four texels of four floats, including one for the order."""
COLUMNS = (
    "redraws a second", "with waits", "main thread, ms", "with drawing, ms", "splats",
    "draw calls", "uploaded MB", "read MB",
)  # fmt: skip


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--splats", type=int, default=300_000, help="size of a synthetic cloud")
    what.add_argument("--ply", type=Path, help="splat file instead of the cloud")
    parser.add_argument("--mesh", action="store_true", help="add a cube among the splats")
    parser.add_argument("--steps", type=int, default=60, help="redraws of the orbit")
    parser.add_argument("--size", type=int, nargs=2, default=(960, 540), metavar=("W", "H"))
    return parser.parse_args()


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Results of redraw_scene.py."""
    blender, problem = programs.find()
    if not blender:
        raise SystemExit(f"{problem}: install it, or set GSCORE_BLENDER to a Blender.")
    with tempfile.TemporaryDirectory() as name:
        folder, size = Path(name), tuple(options.size)
        if options.ply:
            shutil.copy(options.ply, folder / "splats.ply")
        else:
            gscore.write_splats(folder / "splats.ply", synthetic_scene(options.splats)[0])
        request = {"steps": options.steps, "mesh": options.mesh}
        (folder / "asked.json").write_text(json.dumps(request))
        script = Path(__file__).with_name("redraw_scene.py")
        with programs.screen(*size) as display:
            try:
                output = programs.run(blender, script, folder, display, size, LONGEST)
            except subprocess.TimeoutExpired:
                raise SystemExit(
                    f"{blender} took longer than {LONGEST} s; give fewer --steps."
                ) from None
        path = folder / "seen.json"
        if not path.is_file():
            raise SystemExit(f"{output}\n{blender} ended before the measurement.".lstrip())
        results = json.loads(path.read_text())
    if results["problem"]:
        raise SystemExit(results["problem"])
    return results


def cells(redraws: list[dict[str, float]], *, summed: bool) -> list[str]:
    """Cells of a row; drawn and transferred amounts are those of one redraw, or `summed`."""
    value = {name: np.array([r[name] for r in redraws]) for name in redraws[0]}
    apart = np.diff(value["began"])
    own = value["total_ms"] - value["card_ms"]
    middle = {name: float(np.median(found)) for name, found in value.items()}
    moved = {name: float(found.sum()) for name, found in value.items()} if summed else middle
    return [
        f"{1 / np.median(apart):.1f}",
        f"{1 / apart.mean():.1f}",
        f"{np.median(own):.1f}, {own.max():.1f}",
        f"{middle['total_ms']:.1f}, {value['total_ms'].max():.1f}",
        f"{moved['drawn']:,.0f}",
        f"{moved['calls']:.0f}",
        f"{moved['uploaded'] / 1e6:.2f}",
        f"{moved['drawn'] * BYTES / 1e6:.1f}",
    ]


def main() -> None:
    """Measure and print."""
    results = run(parse())
    width, height = results["size"]
    print(f"Blender {results['blender']}, {width} x {height} px\n")
    print(f"| | {' | '.join(COLUMNS)} |\n|{'---|' * (1 + len(COLUMNS))}")
    for row in results["rows"]:
        print(f"| {row['what']} | {' | '.join(cells(row['redraws'], summed=row['summed']))} |")


if __name__ == "__main__":
    main()
