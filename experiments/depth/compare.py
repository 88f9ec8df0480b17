"""Does depth help? Trains with and without it, from few and from many views, and writes a table.

python -m experiments.depth --quick
python -m experiments.depth --table switches
python -m experiments.depth --views 6 12 24 50 --arms none exact mono --seeds 0 1 2

All train as `gscore train --preset` does with the sizes that are given, and nothing else changed.
Every run keeps its figures in a folder of its own, named after the code that made it: what is there
already is not repeated, several of these may run at once, and results of other code are left out.
"""

import argparse
import hashlib
import json
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gscore.bench.quality import COMPARED, CORRECTED
from gscore.commands.bench.shared import ResultsFile
from gscore.io.files import atomic_write
from gscore.io.images.png import write_png
from gscore.io.images.read_image import resize
from gscore.io.ply.splats import read_ply
from gscore.presets import RECIPES
from gscore.raster.api import render
from gscore.report.colormap import colorize

from .captures import (
    ROOT,
    Source,
    few_views,
    photo,
    studio,
    train,
    training_views,
    write_depths,
    write_mono,
)
from .measures import inverse, known_share, measure, pinhole, test_views
from .plans import ARMS, REFERENCE, TABLES, Setting
from .tables import tables


def main() -> int:
    """Run what is missing, then write results.json, the table and the pictures."""
    args = _arguments()
    setting = Setting(**{key: getattr(args, key) for key in Setting.__dataclass_fields__})
    runs = args.output / "runs" / code_version()
    for source in [_source(args, name) for name in args.captures]:
        for views in args.views:
            count = _count(source, views)
            for seed in args.seeds:
                for arm in args.arms:
                    out = runs / f"{source.name}-{count}-{arm}-{setting.folder}-{seed}"
                    if not (out / "row.json").is_file():
                        row = _run(args, setting, source, count, arm, seed, out)
                        row["asked"] = views
                        atomic_write(out / "row.json", (json.dumps(row, indent=1) + "\n").encode())
                        print(out.name, _line(row), flush=True)
            found = [
                (arm, runs / f"{source.name}-{count}-{arm}-{setting.folder}-{args.seeds[0]}")
                for arm in args.arms
            ]
            _pictures(source, found, args.output / f"{source.name}-{count}-{setting.folder}.png")
    rows = [json.loads(path.read_text()) for path in sorted(runs.glob("*/row.json"))]
    table = tables(rows, list(ARMS))
    ResultsFile(args.output).write(table, trainings=rows, finished=True)
    print(table)
    return 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "experiment-depth")
    parser.add_argument(
        "--table", choices=tuple(TABLES), default="views", help="what to train; sets the others"
    )
    parser.add_argument(
        "--captures", nargs="+", default=["studio"], help="studio, or of GSCORE_DATA"
    )
    parser.add_argument(
        "--views", nargs="+", default=["6", "12", "24", "50"], help="to train on; all: all"
    )
    parser.add_argument(
        "--arms",
        nargs="+",
        choices=tuple(ARMS),
        default=["none", "stereo", "mono", "exact"],
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--preset", choices=tuple(RECIPES), default="preview")
    parser.add_argument(
        "--width", type=int, default=0, help="of the photos, pixels; 0: the preset's"
    )
    parser.add_argument("--iterations", type=int, default=0, help="0: the preset's")
    parser.add_argument("--max-splats", type=int, default=0, help="0: the preset's")
    parser.add_argument("--sh-degree", type=int, help="if not the preset's")
    parser.add_argument("--threads", type=int, default=0, help="of each training; 0: all cores")
    parser.add_argument(
        "--model",
        type=Path,
        help="network for the arm onnx, FILE.onnx; for another one give another --output",
    )
    parser.add_argument("--quick", action="store_true", help="12 views, one seed, a minute")
    parser.set_defaults(**TABLES[parser.parse_known_args()[0].table])
    args = parser.parse_args()
    if args.quick:
        args.views, args.seeds = ["12"], [0]
    if args.model and "onnx" not in args.arms:
        args.arms = [*args.arms, "onnx"]
    if "onnx" in args.arms and not args.model:
        parser.error("the arm onnx takes a network: --model FILE.onnx")
    if any(not views.isdecimal() and views != "all" for views in args.views):
        parser.error(f"--views takes numbers and all, not {' '.join(args.views)}")
    return args


@cache
def code_version() -> str:
    """Short hash of all that a training and these captures are made by."""
    files = [*(ROOT / "gscore").rglob("*.py"), *(ROOT / "csrc" / "src").iterdir()]
    digest = hashlib.sha256()
    own = [Path(__file__).with_name(name) for name in ("captures.py", "measures.py")]
    for path in sorted([*files, *own]):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def _source(args: argparse.Namespace, name: str) -> Source:
    return studio() if name == "studio" else _with_reference(args, name)


def _count(source: Source, views: str) -> int:
    available = len(training_views(source))
    return available if views == "all" else min(int(views), available)


def _with_reference(args: argparse.Namespace, name: str) -> Source:
    """A real capture, with the depth of a training on all its training views for the exact one."""
    if "GSCORE_DATA" not in os.environ:
        raise SystemExit(f"{name}: set GSCORE_DATA to the folder that holds data/{name}.")
    folder = Path(os.environ["GSCORE_DATA"]) / "data" / name
    out = args.output / "reference" / name
    done = out / "source.json"
    if not done.is_file():
        setting = Setting(**REFERENCE, threads=args.threads)
        options = ["--seed", "0", *setting.options, "--eval", "--mask-mode", "none"]
        train(folder, out / "run", options)
        cameras = json.loads((out / "run" / "cameras.json").read_text())
        metrics = json.loads((out / "run" / "metrics.json").read_text())
        splats = read_ply(out / "run" / "point_cloud.ply")
        maps = {}
        for camera in cameras:
            K, viewmat = pinhole(camera)
            shown = render(splats, K, viewmat, camera["width"], camera["height"])
            assert shown.median_depth is not None
            maps[camera["img_name"]] = inverse(shown.median_depth)
        unit = float(np.quantile(np.concatenate([v.ravel() for v in maps.values()]), 0.999))
        for view, values in maps.items():
            levels = np.clip(values / unit * 65536, 0, 65535)
            write_png(out / "depths" / f"{Path(view).stem}.png", levels.astype(np.uint16))
        atomic_write(done, json.dumps({"unit": unit, "test": metrics["test_views"]}).encode())
    stated = json.loads(done.read_text())
    return Source(
        name=name,
        folder=folder,
        depths=out / "depths",
        unit=stated["unit"],
        test=tuple(stated["test"]),
    )


def _capture(args: argparse.Namespace, source: Source, count: int, arm: str, seed: int) -> Path:
    """The folder to train on, made on first use."""
    folder = args.output / "captures" / code_version() / f"{source.name}-{count}"
    if not folder.is_dir():
        with _whole(folder) as part:
            names = few_views(source, count, part)
            write_depths(source, names, part)
            atomic_write(part / "train.json", json.dumps(names).encode())
    names = json.loads((folder / "train.json").read_text())
    mono = folder / f"depths-mono-{seed}"
    if "mono" in arm and not mono.is_dir():
        with _whole(mono) as part:
            write_mono(source, names, part, seed=seed)
    if arm == "onnx":
        _predict(folder, "depths-onnx", ["--model", str(args.model)])
    if "depths-stereo" in ARMS[arm]:
        _predict(folder, "depths-stereo", ["--method", "stereo", "--threads", str(args.threads)])
    return folder


def _predict(folder: Path, depths: str, options: list[str]) -> None:
    """Make depth maps as anybody does, from the training photos alone."""
    if not (folder / depths).is_dir():
        with _whole(folder / depths) as part:
            command = [sys.executable, "-m", "gscore", "depth", folder, "-d", part.name, *options]
            command += ["--hold-out", folder / "test.txt", "--quiet"]
            subprocess.run(command, check=True, cwd=ROOT)


@contextmanager
def _whole(folder: Path) -> Iterator[Path]:
    """A folder to fill that becomes `folder` once it is full, unless another process was sooner."""
    part = folder.with_name(f"{folder.name}.part{os.getpid()}")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    yield part
    if folder.is_dir():
        shutil.rmtree(part)
    else:
        part.rename(folder)


def _run(
    args: argparse.Namespace,
    setting: Setting,
    source: Source,
    count: int,
    arm: str,
    seed: int,
    out: Path,
) -> dict[str, Any]:
    """Train once and measure pictures and depth of the test views."""
    folder = _capture(args, source, count, arm, seed)
    options = [option.format(seed=seed) for option in ARMS[arm]]
    masked = "composite" in options
    if "--mask-mode" not in options:
        options += ["--mask-mode", "none"]
    options += ["--hold-out", str(folder / "test.txt")]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    measured = train(folder, out, ["--seed", str(seed), *setting.options, *options])
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "capture": source.name,
        "setting": str(setting),
        "views": count,
        "arm": arm,
        "seed": seed,
        "known": _known(folder, options),
        "judged": _judged(out),
        **{key: measured[key] for key in ("psnr", "ssim", "lpips", "train_seconds", "splats")},
        "cpu_seconds": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        "splats_sha256": hashlib.sha256((out / "point_cloud.ply").read_bytes()).hexdigest(),
        **measure(source, out, masked=masked),
    }


def _known(folder: Path, options: list[str]) -> float | None:
    """Share of the training photos' pixels with a depth; None: the arm has no maps."""
    if "--depths" not in options:
        return None
    depths = folder / options[options.index("--depths") + 1]
    return known_share(depths, json.loads((folder / "train.json").read_text()))


def _judged(out: Path) -> list[dict[str, Any]]:
    """What is known of each held-out view, as `gscore bench quality` has it."""
    views = json.loads((out / "metrics.json").read_text())["views"]
    return [{key: view[key] for key in ("name", *COMPARED, *CORRECTED)} for view in views]


def _pictures(source: Source, found: list[tuple[str, Path]], path: Path) -> None:
    """One test view: photo and exact depth, then what each arm shows; the first seed."""
    columns = []
    for _, out in found:
        views = test_views(source, out)
        view = views[len(views) // 2]
        height, width = view.truth.shape
        top = float(np.quantile(view.truth, 0.99))
        if not columns:
            original = resize(photo(source, view.name), width, height)
            columns.append(np.concatenate([original, colorize(view.truth / top)]))
        rgb = (np.clip(view.shown.rgb, 0, 1) * 255 + 0.5).astype(np.uint8)
        assert view.shown.median_depth is not None
        columns.append(np.concatenate([rgb, colorize(inverse(view.shown.median_depth) / top)]))
    write_png(path, np.concatenate(columns, axis=1))


def _line(row: dict[str, Any]) -> str:
    return (
        f"PSNR {row['psnr']:.2f} depth {row['depth_error']:.3f} "
        f"seen {row['depth_error_seen']:.3f} {row['train_seconds']:.0f} s"
    )
