"""`gscore bench quality`: held-out quality over captures, seeds and splits."""

import argparse
import sys
from collections import deque
from dataclasses import replace
from functools import partial
from pathlib import Path

from ...bench.quality import train_scored
from ...config import DataConfig
from ...io.output_paths import check_output_path
from ...metrics import Lpips, LpipsNet, find_lpips
from ...presets import RECIPES
from ...trainer.schedule.caps import cap_by_photos
from ..parser import add_option
from ..terminal.output import check_folder, check_replaced
from ..terminal.status import Status
from .quality_plans import Cell, cells_of, variants_of
from .quality_results import QualityResults, tables
from .shared import Ticker, add_training_options, check_numbers


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    option = partial(add_option, parser)
    option("sources CAPTURE...", "captures", Path)
    option(
        "-o, --output OUTPUT",
        "folder for results.json and results.md; an interrupted run continues from there",
        Path,
        required=True,
    )
    option("--overwrite", "start again and replace any results.json")
    option("--preset", choices=tuple(RECIPES), default="draft")
    option("--seeds SEEDS...", kind=int, default=[0, 1, 2])
    option(
        "--offsets N...",
        "offsets of the held-out views: every 8th from the N-th, counted from 0; one training each",
        int,
        default=[0, 3, 5],
    )
    option(
        "--thin N...",
        "also thin the training photos: every N-th of them; one training each (1: all photos)",
        int,
        default=[1],
    )
    option(
        "--compare NAME=CHANGES*",
        "also train with these changes, joined by commas: a strategy (mcmc), a disabled "
        "skip, an option of gscore.TrainConfig (free-space=0), another preset "
        "(preset=normal)",
        default=(),
    )
    option("--lpips NETWORK", "as for gscore eval; without it, not measured", Path)
    add_training_options(parser)
    parser.set_defaults(parser=parser)


def run(args: argparse.Namespace) -> int:
    """Run the trainings that results.json lacks; print the tables and verdicts."""
    args.seeds = list(dict.fromkeys(args.seeds))
    args.offsets = list(dict.fromkeys(args.offsets))
    args.thin = list(dict.fromkeys(args.thin))
    check_numbers(args, 0, "seeds", "offsets")
    check_numbers(args, 1, "thin")
    check_folder(args.output)
    for source in args.sources:
        check_output_path(args.output, DataConfig(source=source))
    written = [args.output / name for name in ("results.json", "results.md")]
    check_replaced(written, overwrite=args.overwrite)
    lpips, _ = find_lpips(args.lpips, threads=args.threads)
    cells = deque(cells_of(args, variants_of(args)))
    results = QualityResults(args, cells, lpips.net if lpips else None)
    with Status(sys.stderr) as status:
        while cells:
            _train(cells.popleft(), results, lpips, status)  # frees the photos afterwards
    results.finish()
    print(results.text() if args.json else tables(results.report()), flush=True)
    return 0


def _train(
    cell: Cell, results: QualityResults, lpips: Lpips | LpipsNet | None, status: Status
) -> None:
    """Train the variants in turn for each seed, so that slow hours of the machine affect all."""
    ticker = Ticker(f"{cell.capture}, offset {cell.offset}", status)
    for seed in cell.seeds:
        for variant in cell.variants:
            label, photos = variant.label, variant.photos
            if results.has(cell.capture, label, seed, cell.offset):
                continue
            config, _ = cap_by_photos(
                replace(variant.config, seed=seed),
                photos=len(photos.train),
                points=photos.scene.points.given,
                mask_mode=photos.mask_mode,
            )
            training = train_scored(
                config,
                photos,
                variant.eval_views,
                capture=cell.capture,
                variant=label,
                offset=cell.offset,
                lpips=lpips,
                on_step=partial(ticker, label, seed, iterations=config.iterations),
            )
            results.add(training)
