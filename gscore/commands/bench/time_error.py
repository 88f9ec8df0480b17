"""`gscore bench time-error`: held-out error over training time in seconds."""

import argparse
import statistics
import sys
from collections import deque
from functools import partial
from pathlib import Path

from ...bench.time_error import Curve, measure_variant
from ...config import DataConfig, Skip
from ...io.output_paths import check_output_path
from ...presets import RECIPES
from ..parser import add_option
from ..terminal.output import check_folder, check_replaced
from ..terminal.status import Status
from .curve_figures import figure_files, table, write_curves
from .curve_plans import CapturePlan, ResultsFile, plans_of
from .shared import Ticker, add_training_options
from .sweeps import add_sweep_options, check_sweeps, sizes_file, train_sizes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    option = partial(add_option, parser)
    option("sources SOURCE...", "captures", Path)
    option("-o, --output OUTPUT", "folder for the results", Path, required=True)
    option("--overwrite", "replace a results.json and figures that gscore did not write")
    option("--presets...", choices=tuple(RECIPES), default=["preview"])
    option(
        "--ablations NAME*",
        "also train each preset with this change: a strategy (mcmc), a disabled skip ("
        + ", ".join(Skip)
        + "), an option of gscore.TrainConfig (free-space=0), or several with commas",
        default=(),
    )
    option("--seeds SEEDS...", kind=int, default=[0, 1, 2])
    option("--peers FILE.json*", "curves of other programs, see docs/metrics.md", Path, default=())
    add_sweep_options(parser)
    add_training_options(parser)


def run(args: argparse.Namespace) -> int:
    """Train all variants of all captures; write results.json and figures by capture and metric."""
    args.seeds = list(dict.fromkeys(args.seeds))
    check_sweeps(args)
    check_folder(args.output)
    for source in args.sources:
        check_output_path(args.output, DataConfig(source=source))
    plans = deque(plans_of(args))
    written = [args.output / "results.json"]
    for plan in plans:
        written += [*figure_files(args.output, plan.name), sizes_file(args.output, plan.name)]
    check_replaced(written, overwrite=args.overwrite)
    results = ResultsFile(args)
    while plans:
        _measure(args, plans.popleft(), results)  # frees the photos afterwards
    results.finish()
    if args.json:
        print(results.text())
    return 0


def _measure(args: argparse.Namespace, plan: CapturePlan, results: ResultsFile) -> None:
    status = Status(sys.stderr)
    curves: list[Curve] = []
    for variant in plan.variants:
        curves.append(measure_variant(variant, args.seeds, on_step=Ticker(plan.name, status)))
        results.add_curves(plan, [*curves, *plan.peers])
        _print(args, plan.name, curves[-1])
    curves += plan.peers
    write_curves(args.output, plan.name, curves)
    if not args.json:
        print(table(plan.name, curves), flush=True)
    if plan.sizes is not None:
        train_sizes(
            args,
            plan.name,
            plan.sizes,
            on_step=Ticker(plan.name, status),
            on_found=lambda found: results.add_sizes(plan, found),
        )


def _print(args: argparse.Namespace, capture: str, curve: Curve) -> None:
    if not args.json:
        ends = [points[-1] for points in curve.seeds]
        psnr = [end.psnr for end in ends]
        print(
            f"{capture}, {curve.label}: {statistics.median(e.seconds for e in ends):.1f} s, "
            f"PSNR {statistics.median(psnr):.2f} ({min(psnr):.2f} to {max(psnr):.2f}) dB, "
            f"SSIM {statistics.median(e.ssim for e in ends):.4f}",
            flush=True,
        )
