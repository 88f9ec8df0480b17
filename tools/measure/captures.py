"""Captures: trains those of GSCORE_DATA and the bundled one, prints a Markdown table.

python tools/measure/captures.py --presets preview draft
python tools/measure/captures.py --device gpu --presets preview draft normal high highest
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
COLUMNS = (
    "| capture | preset | device | steps | splats | train s | PSNR | SSIM | LPIPS-sq. | fps "
    "| peak MB |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|"
)


def main() -> int:
    """Run the trainings in order and print each result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presets", nargs="+", default=["preview", "draft"])
    parser.add_argument("--captures", nargs="+", help="names; default: all")
    parser.add_argument("--device", default="cpu", help="whose presets are measured")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "bench")
    args = parser.parse_args()
    captures = {"studio": ROOT / "examples" / "studio"}
    if "GSCORE_DATA" in os.environ:
        found = sorted((Path(os.environ["GSCORE_DATA"]) / "data").glob("*/sparse"))
        captures |= {path.parent.name: path.parent for path in found}
    print(COLUMNS, flush=True)
    for name in args.captures or captures:
        for preset in args.presets:
            output = args.output / f"{name}-{preset}"
            print(row(name, captures[name], preset, args.device, output), flush=True)
    return 0


def row(name: str, source: Path, preset: str, device: str, output: Path) -> str:
    """Train one capture and return its table row."""
    split = ["--hold-out", "6", "--mask-mode", "none"] if name == "studio" else ["--eval"]
    command = [sys.executable, "-m", "gscore", "train", source, "-o", output, "--overwrite"]
    command += ["--preset", preset, "--device", device, "--quiet", "--json", *split]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    if done.returncode:
        return f"| {name} | {preset} | {done.stderr.strip()} |"
    m = json.loads(done.stdout.splitlines()[-1])
    lpips = "-" if m["lpips"] is None else f"{m['lpips']:.3f}"
    used = json.loads((output / "metrics.json").read_text(encoding="utf-8"))["machine"]["isa"]
    cells = [name, preset, used, f"{m['steps']:,}", f"{m['splats']:,}", f"{m['train_seconds']:.0f}"]
    cells += [f"{m['psnr']:.2f}", f"{m['ssim']:.3f}", lpips, f"{m['fps']:.0f}"]
    return "| " + " | ".join([*cells, f"{m['peak_memory_bytes'] / 1e6:.0f}"]) + " |"


if __name__ == "__main__":
    sys.exit(main())
