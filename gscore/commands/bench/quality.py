"""`gscore bench quality`: held-out quality over captures, seeds and splits."""

import argparse
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from ...bench.paired import THINNED
from ...bench.quality import train_scored
from ...bench.training import open_variants
from ...config import DataConfig, TrainConfig
from ...errors import ConfigError
from ...metrics import Lpips, LpipsNet, find_lpips
from ...presets import RECIPES
from ...quoting import quoted
from ...trainer.schedule.caps import cap_by_photos
from ..args.device_option import device_of
from ..parser import add_option
from ..terminal.output import check_replaced
from ..terminal.status import Status
from .quality_results import QualityResults, tables
from .shared import (
    Cell,
    Ticker,
    add_training_options,
    changed,
    check_bench,
    check_numbers,
    named_sources,
    train_cells,
    training_configs,
)


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
    check_bench(args)
    args.offsets = list(dict.fromkeys(args.offsets))
    args.thin = list(dict.fromkeys(args.thin))
    check_numbers(args, 0, "seeds", "offsets")
    check_numbers(args, 1, "thin")
    written = [args.output / name for name in ("results.json", "results.md")]
    check_replaced(written, overwrite=args.overwrite)
    lpips, _ = find_lpips(args.lpips, threads=args.threads)
    cells = deque(cells_of(args))
    device = device_of(args)
    results = QualityResults(args, device, cells, lpips.net if lpips else None)
    train_cells(cells, lambda cell, status: _train(cell, args.seeds, results, lpips, status))
    results.write_report(finished=True)
    print(results.text() if args.json else tables(results.report()), flush=True)
    return 0


def _train(
    cell: Cell,
    seeds: list[int],
    results: QualityResults,
    lpips: Lpips | LpipsNet | None,
    status: Status,
) -> None:
    """Train the variants in turn for each seed, so that slow hours of the machine affect all."""
    ticker = Ticker(f"{cell.capture}, offset {cell.offset}", status)
    for seed in seeds:
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


_Request = tuple[str, str, tuple[str, ...]]
"""Label, preset and changes of a variant on the command line."""


def _requests(args: argparse.Namespace) -> list[_Request]:
    """The unchanged preset, and each variant of `--compare`.

    Raises:
        ConfigError: two variants have one name, or a text is not NAME=CHANGES.
    """
    variants: list[_Request] = [(args.preset, args.preset, ())]
    for text in args.compare:
        name, equals, changes = text.partition("=")
        if not (name and equals and changes):
            raise ConfigError(
                "`--compare` takes NAME=CHANGES, such as both=mcmc,free-space=0, got "
                f"{quoted(text)}."
            )
        if name in [label for label, *_ in variants]:
            raise ConfigError(f"`--compare`: two variants are called {quoted(name)}.")
        variants.append(_request(args, name, changes.split(",")))
    return variants


def _request(args: argparse.Namespace, label: str, changes: Sequence[str]) -> _Request:
    presets = [part.removeprefix("preset=") for part in changes if part.startswith("preset=")]
    for preset in presets:
        if preset not in RECIPES:
            raise ConfigError(
                f"`--compare {label}`: there is no preset {quoted(preset)}; there are: "
                f"{', '.join(RECIPES)}."
            )
    rest = tuple(part for part in changes if not part.startswith("preset="))
    return label, [args.preset, *presets][-1], rest


def cells_of(args: argparse.Namespace) -> list[Cell]:
    """One cell per capture, thinning and offset; no photo is decoded yet.

    Raises:
        GsError: an invalid capture, option or offset, or a variant of `--compare`.
    """
    requests = _requests(args)
    return [
        _cell(args, name, source, offset, thin, requests)
        for name, source in named_sources(args.sources).items()
        for thin in args.thin
        for offset in args.offsets
    ]


def _cell(
    args: argparse.Namespace,
    name: str,
    source: Path,
    offset: int,
    thin: int,
    requests: Sequence[_Request],
) -> Cell:
    options: list[tuple[str, DataConfig, TrainConfig]] = []
    for label, preset, changes in requests:
        data, config = training_configs(args, source, preset)
        one = _held_out(data, offset), changed(config, changes, flag="--compare")
        for first, *other in options:
            if other == [*one]:  # their difference would be noise
                raise ConfigError(
                    f"`--compare {label}` changes nothing: it is the same as {first}."
                )
        options.append((label, *one))
    variants = open_variants(options)
    for photos in {id(variant.photos): variant.photos for variant in variants}.values():
        photos.train = photos.train[::thin]
    capture = name if thin == 1 else f"{name}{THINNED}{thin}"
    return Cell(capture=capture, offset=offset, variants=variants)


def _held_out(data: DataConfig, offset: int) -> DataConfig:
    if data.test_list is not None or data.test_first or data.test_last:
        raise ConfigError(
            "This bench selects test views by `--offsets`; leave out other options that select "
            "test views."
        )
    return replace(data, eval=True, test_offset=offset)
