"""Redraws of a view of splats in Blender: how often, and how long each takes.

    GSCORE_BLENDER=PROGRAM python tools/measure/redraws.py [--splats N | --ply FILE] [--mesh]

Starts a Blender of 4.2 or later in a window on a screen that is not there, where the processor
stands in for a graphics card, turns the view around the splats and lets it rest. Prints a table, as
in docs/experiments/2026-11-redraws.md: redraws a second (median, and with all waits), milliseconds
of the main thread in the add-on without the card's work (median, longest) and with it, splats
drawn, draw calls, and megabytes that are uploaded, and read by the card, a redraw. Of a view that
comes to rest the last four are sums: of all redraws until every splat is there. Needs Xvfb.
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
from gscore.bench.raster import synthetic_scene

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from tools.window import programs  # noqa: E402

LONGEST = 280
"""Seconds."""
BYTES = 64
"""Of a splat that the card reads: four texels of four floats, one of them of the order."""
COLUMNS = (
    "redraws a second", "with waits", "main thread, ms", "with the card's, ms", "splats",
    "draw calls", "uploaded MB", "read MB",
)  # fmt: skip


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--splats", type=int, default=300_000, help="of a synthetic cloud")
    what.add_argument("--ply", type=Path, help="a model instead")
    parser.add_argument("--mesh", action="store_true", help="a cube among the splats")
    parser.add_argument("--steps", type=int, default=60, help="redraws of the turn")
    parser.add_argument("--size", type=int, nargs=2, default=(960, 540), metavar=("W", "H"))
    return parser.parse_args()


def run(options: argparse.Namespace) -> dict[str, Any]:
    """What redraw_scene.py saw."""
    blender, problem = programs.find()
    if not blender:
        raise SystemExit(f"{problem}: install it, or name a Blender with GSCORE_BLENDER.")
    with tempfile.TemporaryDirectory() as name:
        folder, size = Path(name), tuple(options.size)
        if options.ply:
            shutil.copy(options.ply, folder / "splats.ply")
        else:
            gscore.write_splats(folder / "splats.ply", synthetic_scene(options.splats)[0])
        asked = {"steps": options.steps, "mesh": options.mesh}
        (folder / "asked.json").write_text(json.dumps(asked))
        script = Path(__file__).with_name("redraw_scene.py")
        with programs.screen(*size) as display:
            try:
                told = programs.run(blender, script, folder, display, size, LONGEST)
            except subprocess.TimeoutExpired:
                raise SystemExit(f"{blender} took longer than {LONGEST} s: fewer steps.") from None
        left = folder / "seen.json"
        if not left.is_file():
            raise SystemExit(f"{told}\n{blender} ended before it had measured.".lstrip())
        seen = json.loads(left.read_text())
    if seen["problem"]:
        raise SystemExit(seen["problem"])
    return seen


def cells(redraws: list[dict[str, float]], *, summed: bool) -> list[str]:
    """Of a row; what is drawn and moved is that of one redraw, or `summed` of all."""
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
    seen = run(parse())
    width, height = seen["size"]
    print(f"Blender {seen['blender']}, {width} x {height} px\n")
    print(f"| | {' | '.join(COLUMNS)} |\n|{'---|' * (1 + len(COLUMNS))}")
    for row in seen["rows"]:
        print(f"| {row['what']} | {' | '.join(cells(row['redraws'], summed=row['summed']))} |")


if __name__ == "__main__":
    main()
