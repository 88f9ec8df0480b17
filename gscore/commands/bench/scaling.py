"""`gscore bench scaling`: cost by splats, pixels, threads and views."""

import argparse
import sys
from dataclasses import asdict
from functools import partial
from typing import Any

from ...bench.scaling import SIZES, SPLATS, VIEW_COUNTS, Scaling, bench_scaling
from ...metrics.machine import cores, machine
from ...quoting import quoted
from ...raster import native_library
from ...text_format import count_text
from ..parser import add_option
from ..terminal.output import print_json
from ..terminal.status import Rows, Status
from .shared import check_numbers


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    option = partial(add_option, parser)
    option("--splats SPLATS*", "numbers of splats", int, default=SPLATS)
    option("--sizes WxH*", "sizes of the picture, px", size, default=SIZES)
    option("--threads THREADS*", "numbers of threads; default: 1 to all cores", int)
    option("--views VIEWS*", "numbers of photos", int, default=VIEW_COUNTS)
    option("--cloud CLOUD", "number of splats while other quantities vary", int, default=100_000)
    option("--steps STEPS", "steps per point (20)", int, default=20)


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    if args.threads is None:
        args.threads = range(1, cores() + 1)
    check_numbers(args, 1, "splats", "threads", "views", "cloud", "steps")
    with Status(sys.stderr) as status:
        rows = Rows(status, "Measuring", quiet=args.json)
        series = bench_scaling(
            splats=args.splats,
            sizes=args.sizes,
            threads=args.threads,
            views=args.views,
            cloud=args.cloud,
            steps=args.steps,
            on_row=lambda quantity, row: rows(_row(quantity, row)),
        )
    if args.json:
        content = {"machine": machine(), "isa": native_library.isa()}
        print_json(content | {"series": [asdict(one) for one in series]})
    else:
        for one in series:
            sys.stdout.write(_lines(one))
    return 0


def size(text: str) -> tuple[int, int]:
    """Parse WxH, px."""
    width, _, height = text.partition("x")
    try:
        found = int(width), int(height)
    except ValueError:
        found = 0, 0
    if min(found) < 1:
        raise argparse.ArgumentTypeError(f"a size looks like 640x400, got {quoted(text)}")
    return found


def _row(quantity: str, row: dict[str, Any]) -> str:
    stages = "  ".join(f"{name} {ms:.1f}" for name, ms in row["raster_ms"].items())
    memory, cache = row["peak_memory_bytes"], row.get("cache_mb")
    kept = "" if quantity != "views" else f", {count_text(row['views'], 'view')}"
    kept += "" if cache is None else f", {cache} MB of photos kept"
    return (
        f"{quantity}: {count_text(row['splats'], 'splat')}, {row['width']} x {row['height']} px, "
        f"{count_text(row['threads'], 'thread')}{kept}: {row['step_ms']:.1f} ms, "
        f"{row['pairs_per_pixel']:.0f} pairs per pixel, "
        f"{'-' if memory is None else round(memory / 1e6)} MB; {stages}"
    )


def _lines(series: Scaling) -> str:
    unit, scale = ("1,000 splats", 1e3) if series.quantity == "splats" else ("megapixel", 1e6)
    return "".join(
        f"{series.quantity}, {name}: {line.base:.2f} ms + {line.slope * scale:.4f} ms per {unit}, "
        f"r2 {line.r2:.3f}\n"
        for name, line in series.lines.items()
    )
