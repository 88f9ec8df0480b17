"""`gscore bench memory`: memory of a training."""

import argparse
import sys
from dataclasses import asdict
from functools import partial

from ...bench.memory import MIN_STEPS, MemoryBench, bench_memory
from ...errors import BackendError
from ...metrics.machine import machine
from ...raster import native_library
from ...text_format import count_text, number
from ..parser import add_option, add_threads_option
from ..terminal.output import print_json
from ..terminal.status import show_while, wrapped
from .scaling import size
from .shared import check_numbers


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    option = partial(add_option, parser)
    option("--splats SPLATS", "number of splats, SH degree 3", int, default=1_000_000)
    option("--views VIEWS", "number of photos (100)", int, default=100)
    option("--size WxH", "size of the photos (1216x832)", size, default=(1216, 832))
    option("--steps STEPS", f"number of steps, at least {MIN_STEPS} (40)", int, default=40)
    add_threads_option(parser)


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    check_numbers(args, 1, "splats")
    check_numbers(args, 2, "views")
    check_numbers(args, MIN_STEPS, "steps")
    width, height = args.size
    with show_while(sys.stderr, f"Training {count_text(args.splats, 'splat')}"):
        found = bench_memory(
            splats=args.splats,
            views=args.views,
            width=width,
            height=height,
            steps=args.steps,
            threads=args.threads,
        )
    if found is None:
        raise BackendError("This system does not report the memory of a process.")
    if args.json:
        data = asdict(found)
        data["said_bytes"] = data.pop("forecast_bytes")  # the key in files of earlier versions
        print_json({"machine": machine(), "isa": native_library.isa()} | data)
    else:
        sys.stdout.write(wrapped(_table(found), sys.stdout))
    return 0


def _table(r: MemoryBench) -> str:
    parts = "".join(
        f"  {number(round(bytes_ / 1e6)):>8} MB  {name}\n" for name, bytes_ in r.parts.items()
    )
    return (
        f"{count_text(r.splats, 'splat')}, {count_text(r.views, 'view')} of {r.width} x "
        f"{r.height} px, {count_text(r.steps, 'step')}\n"
        f"  estimated {r.forecast_bytes / 1e9:.2f} GB, used {r.peak_bytes / 1e9:.2f} GB\n{parts}"
    )
