"""Does depth help? Trains with and without it, from few and from many views, and writes a table.

python tools/experiment_depth.py --quick
python tools/experiment_depth.py --views 6 12 24 50 --arms none exact mono --seeds 0 1 2

Runs that are in results.json already are not repeated, so it can be stopped and goes on.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from depth_captures import Source, exact, few_views, photo, write_depths, write_mono

from gscore.io.images import resize, write_png
from gscore.io.ply import read_splats
from gscore.metrics.colormap import colorize
from gscore.raster.api import render

ROOT = Path(__file__).parent.parent
ARMS: dict[str, list[str]] = {
    "none": [],
    "exact": ["--depths", "depths-exact", "--depth-mode", "on"],
    "mono": ["--depths", "depths-mono-{seed}", "--depth-mode", "on"],
    "mono-auto": ["--depths", "depths-mono-{seed}"],
    "onnx": ["--depths", "depths-onnx", "--depth-mode", "on"],
    "drop": ["--drop-rate", "0.2"],
    "mono+drop": ["--depths", "depths-mono-{seed}", "--depth-mode", "on", "--drop-rate", "0.2"],
    "mono+points": [
        *("--depths", "depths-mono-{seed}", "--depth-mode", "on"),
        *("--depth-points", "10000"),
    ],
    "random": ["--background", "random"],
    "masked": ["--mask-mode", "composite"],
    "masked+alpha": ["--mask-mode", "composite", "--alpha-weight", "0.1"],
    "masked+black": ["--mask-mode", "composite", "--background", "black"],
    "masked+mono": [
        *("--mask-mode", "composite"),
        *("--depths", "depths-mono-{seed}", "--depth-mode", "on"),
    ],
}
"""What is trained with: options of `gscore train`."""
STUDIO_UNIT = 4.0


def main() -> int:
    """Run what is missing, then write results.json, the table and the pictures."""
    args = _arguments()
    args.output.mkdir(parents=True, exist_ok=True)
    path = args.output / "results.json"
    results = json.loads(path.read_text()) if path.is_file() else {}
    for source in _sources(args):
        for count in args.views:
            for seed in args.seeds:
                for arm in args.arms:
                    key = "/".join((source.name, _setting(args), str(count), arm, str(seed)))
                    if key not in results:
                        results[key] = _run(args, source, count, arm, seed)
                        _write(path, json.dumps(results, indent=1) + "\n")
                        print(key, _line(results[key]), flush=True)
            _pictures(args, source, count)
    table = _tables(results, _setting(args))
    _write(args.output / "results.md", table)
    print(table)
    return 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "experiment-depth")
    parser.add_argument(
        "--captures", nargs="+", default=["studio"], help="studio, or of GSCORE_DATA"
    )
    parser.add_argument("--views", type=int, nargs="+", default=[6, 12, 24, 50])
    parser.add_argument("--arms", nargs="+", choices=tuple(ARMS), default=["none", "exact", "mono"])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--width", type=int, default=160, help="of the photos, pixels")
    parser.add_argument("--iterations", type=int, default=800)
    parser.add_argument("--max-splats", type=int, default=30_000)
    parser.add_argument("--model", type=Path, help="network for the arm onnx, FILE.onnx")
    parser.add_argument("--quick", action="store_true", help="12 views, one seed, a minute or two")
    args = parser.parse_args()
    if args.quick:
        args.views, args.seeds, args.width = [12], [0], 120
        args.iterations, args.max_splats = 500, 15_000
    if args.model and "onnx" not in args.arms:
        args.arms.append("onnx")
    if "onnx" in args.arms and not args.model:
        parser.error("the arm onnx takes a network: --model FILE.onnx")
    return args


def _setting(args: argparse.Namespace) -> str:
    return f"{args.width} px, {args.iterations} steps, {args.max_splats} splats"


def _sources(args: argparse.Namespace) -> list[Source]:
    return [studio() if name == "studio" else _with_reference(args, name) for name in args.captures]


def studio() -> Source:
    folder = ROOT / "examples" / "studio"
    return Source(
        name="studio",
        folder=folder,
        depths=folder / "depths",
        unit=STUDIO_UNIT,
        test=tuple((folder / "test.txt").read_text().split()),
    )


def _with_reference(args: argparse.Namespace, name: str) -> Source:
    """A real capture, with the depth of a training on all its training views for the exact one."""
    if "GSCORE_DATA" not in os.environ:
        raise SystemExit(f"{name}: set GSCORE_DATA to the folder that holds data/{name}.")
    folder = Path(os.environ["GSCORE_DATA"]) / "data" / name
    out = args.output / "reference" / name
    done = out / "source.json"
    if not done.is_file():
        _train(folder, out / "run", args, ["--eval", "--mask-mode", "none"], seed=0)
        cameras = json.loads((out / "run" / "cameras.json").read_text())
        metrics = json.loads((out / "run" / "metrics.json").read_text())
        splats = read_splats(out / "run" / "point_cloud.ply")
        inverse = {}
        for camera in cameras:
            K, viewmat = _pinhole(camera)
            shown = render(splats, K, viewmat, camera["width"], camera["height"])
            assert shown.median_depth is not None
            z = shown.median_depth
            inverse[camera["img_name"]] = np.where(z > 0, 1 / np.where(z > 0, z, 1), 0)
        unit = float(np.quantile(np.concatenate([v.ravel() for v in inverse.values()]), 0.999))
        for view, values in inverse.items():
            levels = np.clip(values / unit * 65536, 0, 65535)
            write_png(out / "depths" / f"{Path(view).stem}.png", levels.astype(np.uint16))
        _write(done, json.dumps({"unit": unit, "test": metrics["test_views"]}))
    stated = json.loads(done.read_text())
    return Source(
        name=name,
        folder=folder,
        depths=out / "depths",
        unit=stated["unit"],
        test=tuple(stated["test"]),
    )


def _pinhole(camera: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """K and viewmat of an entry of cameras.json."""
    K = np.array(
        [
            [camera["fx"], 0, camera.get("cx", camera["width"] / 2)],
            [0, camera["fy"], camera.get("cy", camera["height"] / 2)],
            [0, 0, 1],
        ],
        np.float64,
    )
    viewmat = np.eye(4)
    viewmat[:3, :3] = np.array(camera["rotation"]).T
    viewmat[:3, 3] = -viewmat[:3, :3] @ np.array(camera["position"])
    return K, viewmat


def _capture(args: argparse.Namespace, source: Source, count: int, arm: str, seed: int) -> Path:
    """The folder to train on, made on first use."""
    folder = args.output / "captures" / f"{source.name}-{count}"
    listed = folder / "train.json"
    if not listed.is_file():
        names = few_views(source, count, folder)
        write_depths(source, names, folder)
        _write(listed, json.dumps(names))
    names = json.loads(listed.read_text())
    mono = folder / f"depths-mono-{seed}"
    if "mono" in arm and not mono.is_dir():
        write_mono(source, names, mono, seed=seed)
    if arm == "onnx" and not (folder / "depths-onnx").is_dir():
        command = [sys.executable, "-m", "gscore", "depth", folder, "--model", args.model]
        subprocess.run([*command, "-o", "depths-onnx"], check=True, cwd=ROOT)
    return folder


def _run(
    args: argparse.Namespace, source: Source, count: int, arm: str, seed: int
) -> dict[str, Any]:
    """Train once and measure pictures and depth of the test views."""
    folder = _capture(args, source, count, arm, seed)
    out = args.output / "runs" / f"{source.name}-{args.width}-{count}-{arm}-{seed}"
    options = [option.format(seed=seed) for option in ARMS[arm]]
    if "--mask-mode" not in options:
        options += ["--mask-mode", "none"]
    options += ["--test-list", str(folder / "test.txt")]
    measured = _train(folder, out, args, options, seed=seed)
    return {
        **{key: measured[key] for key in ("psnr", "ssim", "lpips", "train_seconds", "splats")},
        "depth_error": _depth_error(source, out, masked="composite" in options),
    }


def _train(
    folder: Path, out: Path, args: argparse.Namespace, options: list[str], *, seed: int
) -> dict[str, Any]:
    command = [sys.executable, "-m", "gscore", "train", folder, "-o", out, "--overwrite"]
    command += ["--quiet", "--json", "--seed", str(seed), "--sh-degree", "1"]
    command += ["--resolution", str(args.width), "--iterations", str(args.iterations)]
    command += ["--max-splats", str(args.max_splats), "--checkpoint-seconds", "0", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, command))}\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def _views(source: Source, out: Path) -> list[tuple[str, Any, np.ndarray]]:
    """Name, render and exact inverse depth at its size, for each test view."""
    splats, found = read_splats(out / "point_cloud.ply"), []
    for camera in json.loads((out / "cameras.json").read_text()):
        name = camera["img_name"]
        names = {Path(test).stem: test for test in source.test} | {t: t for t in source.test}
        if name not in names:
            continue
        K, viewmat = _pinhole(camera)
        width, height = camera["width"], camera["height"]
        truth = exact(source, name)
        rows = ((np.arange(height) + 0.5) * truth.shape[0] / height).astype(int)
        columns = ((np.arange(width) + 0.5) * truth.shape[1] / width).astype(int)
        shown = render(splats, K, viewmat, width, height)
        found.append((names[name], shown, truth[np.ix_(rows, columns)]))
    return found


def _depth_error(source: Source, out: Path, *, masked: bool) -> float:
    """Mean over pixels and test views of |z / exact z - 1|, at most 1; z is the median depth.

    With masks only pixels that are the figure's count.
    """
    errors = []
    for name, shown, truth in _views(source, out):
        known = truth > 0
        if masked:
            mask = source.folder / "masks" / f"{Path(name).stem}.png"
            known &= _mask(mask, truth.shape) == 255
        errors.append(np.minimum(np.abs(shown.median_depth[known] * truth[known] - 1), 1).mean())
    return float(np.mean(errors))


def _mask(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    from gscore.io.images import read_mask

    return resize(read_mask(path), shape[1], shape[0])


def _pictures(args: argparse.Namespace, source: Source, count: int) -> None:
    """One test view: photo and exact depth over what each arm shows, with the first seed."""
    columns = []
    for arm in args.arms:
        run = f"{source.name}-{args.width}-{count}-{arm}-{args.seeds[0]}"
        views = _views(source, args.output / "runs" / run)
        name, shown, truth = views[len(views) // 2]
        top = float(np.quantile(truth, 0.99))
        z = shown.median_depth
        inverse = np.where(z > 0, 1 / np.where(z > 0, z, 1), 0)
        if not columns:
            original = resize(photo(source, name), truth.shape[1], truth.shape[0])
            columns.append(np.concatenate([original, colorize(truth / top)]))
        rgb = (np.clip(shown.rgb, 0, 1) * 255 + 0.5).astype(np.uint8)
        columns.append(np.concatenate([rgb, colorize(inverse / top)]))
    write_png(args.output / f"{source.name}-{count}.png", np.concatenate(columns, axis=1))


def _tables(results: dict[str, dict[str, Any]], setting: str) -> str:
    """Markdown: mean and standard deviation over seeds, and the gain over `none` seed by seed."""
    groups: dict[tuple[str, int], dict[str, dict[int, dict[str, Any]]]] = {}
    for key, row in results.items():
        capture, wanted, count, arm, seed = key.split("/")
        if wanted == setting:
            group = groups.setdefault((capture, int(count)), {})
            group.setdefault(arm, {})[int(seed)] = row
    lines = [
        f"{setting}; mean and standard deviation over seeds.",
        "",
        "| capture | views | depth | PSNR | gain in PSNR | SSIM | LPIPS | depth error | seconds |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for (capture, count), arms in sorted(groups.items()):
        for arm, rows in arms.items():
            base = arms.get("masked" if arm.startswith("masked") else "none", {})
            gains = [row["psnr"] - base[s]["psnr"] for s, row in rows.items() if s in base]
            cells = [capture, str(count), arm, _spread_words(rows, "psnr", 2)]
            cells += ["" if base is rows else _mean_words(gains, 2, sign="+")]
            cells += [_spread_words(rows, "ssim", 4), _spread_words(rows, "lpips", 3)]
            cells += [
                _spread_words(rows, "depth_error", 3),
                _spread_words(rows, "train_seconds", 0),
            ]
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _spread_words(rows: dict[int, dict[str, Any]], key: str, digits: int) -> str:
    return _mean_words([row[key] for row in rows.values() if row[key] is not None], digits)


def _mean_words(values: list[float], digits: int, *, sign: str = "") -> str:
    if not values:
        return "n/a"
    mean = f"{statistics.fmean(values):{sign}.{digits}f}"
    return f"{mean} ± {statistics.stdev(values):.{digits}f}" if len(values) > 1 else mean


def _line(row: dict[str, Any]) -> str:
    return f"PSNR {row['psnr']:.2f} depth {row['depth_error']:.3f} {row['train_seconds']:.0f} s"


def _write(path: Path, text: str) -> None:
    """Write completely or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".part{int(time.time())}")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


if __name__ == "__main__":
    sys.exit(main())
