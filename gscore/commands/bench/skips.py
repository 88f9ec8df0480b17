"""`gscore bench skips`: one training with and without each skip."""

import argparse
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path

from ...bench.skips import SkipRow, bench_skips
from ...bench.training import load_for_bench
from ...config import Skip
from ...metrics.machine import machine
from ...presets import RECIPES
from ...raster import native_library
from ..parser import add_option
from ..terminal.output import print_json
from ..terminal.status import Rows, Status
from .shared import add_training_options, training_configs


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    option = partial(add_option, parser)
    option("source", "capture", Path)
    option("--preset", choices=tuple(RECIPES), default="preview")
    option(
        "--skips SKIP...",
        "skips to measure (all): " + ", ".join(Skip),
        choices=tuple(Skip),
        default=tuple(Skip),
    )
    add_training_options(parser)


def run(args: argparse.Namespace) -> int:
    """Train with and without each skip, and print the differences."""
    data, config = training_configs(args, args.source, args.preset)
    photos = load_for_bench(data)
    if not args.json:
        print(_HEAD)
    with Status(sys.stderr) as status:
        table = Rows(status, "Training", quiet=args.json)
        rows = bench_skips(
            config,
            photos,
            skips=[Skip(name) for name in dict.fromkeys(args.skips)],
            on_row=lambda row: table(_line(row)),
        )
    if args.json:
        content = {
            "source": str(args.source),
            "preset": args.preset,
            "iterations": config.iterations,
            "machine": machine(),
            "isa": native_library.isa(),
            "rows": [asdict(row) for row in rows],
        }
        print_json(content)
    return 0


_HEAD = (
    "| without | seconds | times | forward Gpairs | backward Gpairs | PSNR | SSIM | same bits |\n"
    "|---|---|---|---|---|---|---|---|"
)


def _line(row: SkipRow) -> str:
    all_off = len(row.without) == len(Skip)
    name = "all of them" if all_off else ", ".join(row.without) or "nothing"
    return (
        f"| {name} | {row.seconds:.1f} | {row.slowdown:.2f} | "
        f"{row.forward_gpairs:.2f} | {row.backward_gpairs:.2f} | {row.psnr:.2f} | "
        f"{row.ssim:.4f} | {'yes' if row.identical else 'no'} |"
    )
