"""`gscore bench skips`: one training with and without each skip."""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from ...bench.training import Trained, load_for_bench, train_measured
from ...config import Skip, TrainConfig
from ...datasets import Dataset
from ...metrics.machine import machine
from ...presets import RECIPES
from ...raster import native_library
from ...splats import PARAMETERS, Splats
from ..parser import add_option
from ..terminal.output import print_json
from ..terminal.status import Rows, Status
from .shared import add_training_options, training_configs


@dataclass(frozen=True, kw_only=True)
class SkipRow:
    """A training with some skips disabled, compared with the one with all of them."""

    without: list[str]
    """Disabled skips; empty: the unchanged training."""
    seconds: float
    """Time spent in steps, s."""
    slowdown: float
    """`seconds` divided by those of the training with all skips."""
    forward_gpairs: float
    """Pairs that the forward passes evaluated, in 10^9."""
    backward_gpairs: float
    psnr: float
    """PSNR of the held-out views, dB."""
    ssim: float
    splats: int
    identical: bool
    """Whether the trained splats are bit-identical to those with all skips."""


def _rows(config: TrainConfig, photos: Dataset, skips: Sequence[Skip]) -> Iterator[SkipRow]:
    """Train with all skips, without each of `skips`, and for several without all of these.

    Args:
        config: Options; the skips in its `without` stay disabled in every row.
        photos: Decoded photos, with held-out views.
        skips: Skips to measure.
    """
    first: Trained | None = None
    for off in [(), *((skip,) for skip in skips), *([tuple(skips)] if len(skips) > 1 else [])]:
        found = train_measured(replace(config, without=(*config.without, *off)), photos)
        first = first or found
        yield SkipRow(
            without=[skip.value for skip in off],
            seconds=found.seconds,
            slowdown=found.seconds / first.seconds,
            forward_gpairs=found.forward_pairs / 1e9,
            backward_gpairs=found.backward_pairs / 1e9,
            psnr=found.points[-1].psnr,
            ssim=found.points[-1].ssim,
            splats=len(found.splats),
            identical=_same_bits(found.splats, first.splats),
        )


def _same_bits(a: Splats, b: Splats) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in PARAMETERS)


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
        rows = []
        for row in _rows(config, photos, [Skip(name) for name in dict.fromkeys(args.skips)]):
            rows.append(row)
            table(_line(row))
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
