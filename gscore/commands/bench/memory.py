"""`gscore bench memory`: memory of a training."""

import argparse
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

from ...config import DataConfig, TrainConfig
from ...errors import BackendError
from ...events import Estimated, Event
from ...metrics.machine import machine, peak_memory_bytes
from ...raster import native_library
from ...splats import SH_REST_BY_DEGREE
from ...text_format import count_text, number
from ...trainer.run import train
from ..parser import add_option, add_threads_option
from ..terminal.output import print_json
from ..terminal.status import show_while, wrapped
from .scaling import size
from .shared import check_numbers, run_child

MIN_STEPS = 10
"""Minimum steps, so that refinements, a snapshot and a checkpoint have different steps."""
_REFINEMENTS = 3
"""Consecutive refinements in the middle of the run, each of which moves all rows."""

_WRITER = """
import sys
from pathlib import Path
from gscore.bench.synthetic import write_capture
write_capture(Path(sys.argv[1]), *map(int, sys.argv[2:]))
"""


def _measure(args: argparse.Namespace) -> dict[str, Any]:
    """Train for some steps at full size from given splats of SH degree 3, with all parts of a long
    run: refinements, snapshots, checkpoints and an evaluation.

    The peak is that of the whole process, which must be new.

    Returns:
        The numbers for JSON, in bytes: `said_bytes`, the estimate before the run, `peak_bytes`, the
        largest resident memory, and `parts` at the peak: the process before the run, photos,
        parameters, their gradients and moments, and the rest, mostly of the rasterizer.

    Raises:
        BackendError: the system does not report the memory of a process.
    """
    before = peak_memory_bytes()
    splats, views, steps, (width, height) = args.splats, args.views, args.steps, args.size
    estimates: list[int] = []

    def on_event(event: Event) -> None:
        if isinstance(event, Estimated):
            estimates.append(event.peak_bytes)

    with tempfile.TemporaryDirectory(prefix="gscore-") as name:
        folder = Path(name)
        # In another process, whose memory is not measured.
        values = [str(value) for value in (folder, splats, views, width, height)]
        run_child(["-c", _WRITER, *values], what="writes the capture")
        config = TrainConfig(
            iterations=steps,
            max_splats=splats,
            sh_degree=3,
            start_splats=folder / "splats.ply",
            refine_start=steps // 2,
            refine_stop=steps // 2 + _REFINEMENTS,
            refine_every=1,
            coarse_factor=1.0,
            snapshot_every=steps // 2 + 1,
            checkpoint_iterations=(steps // 2 + 2,),
            threads=args.threads,
        )
        data = DataConfig(source=folder / "capture", resolution=1, eval=True)
        train(config, data, folder / "out", on_event)
    peak = peak_memory_bytes()
    if peak is None or before is None:
        raise BackendError("This system does not report the memory of a process.")
    numbers = 4 * splats * (11 + 3 * (1 + SH_REST_BY_DEGREE[3]))
    parts = {
        "before the run": before,
        "photos": 3 * views * width * height,
        "parameters": numbers,
        "gradients": numbers,
        "moments": 2 * numbers,
    }
    sizes = {"splats": splats, "views": views, "width": width, "height": height, "steps": steps}
    parts["the rest"] = peak - sum(parts.values())
    # `said_bytes` is the key in files of earlier versions too.
    return sizes | {"peak_bytes": peak, "parts": parts, "said_bytes": estimates[0]}


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
    with show_while(sys.stderr, f"Training {count_text(args.splats, 'splat')}"):
        found = _measure(args)
    if args.json:
        print_json({"machine": machine(), "isa": native_library.isa()} | found)
    else:
        sys.stdout.write(wrapped(_table(found), sys.stdout))
    return 0


def _table(r: dict[str, Any]) -> str:
    parts = "".join(
        f"  {number(round(bytes_ / 1e6)):>8} MB  {name}\n" for name, bytes_ in r["parts"].items()
    )
    return (
        f"{count_text(r['splats'], 'splat')}, {count_text(r['views'], 'view')} of {r['width']} x "
        f"{r['height']} px, {count_text(r['steps'], 'step')}\n"
        f"  estimated {r['said_bytes'] / 1e9:.2f} GB, used {r['peak_bytes'] / 1e9:.2f} GB\n{parts}"
    )
