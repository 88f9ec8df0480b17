"""Sweeps over model sizes in `gscore bench time-error`: options, figure and table."""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

from ...bench.time_error import Size, SizeOutcome, measure_variant, pareto_front, sizes_of
from ...bench.training import Variant, first_size, open_variants
from ...config import DataConfig, TrainConfig
from ...datasets.resolution import SMALLEST_WIDTH
from ...errors import ConfigError
from ...io.files import atomic_write
from ...report.curves import Series
from ...report.figure import figure
from ...text_format import count_text, markdown_table, number
from ..parser import add_option
from .shared import Cell

_QUANTITIES = ("splats", "widths", "iterations")


def add_sweep_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    group = parser.add_argument_group(
        "sizes",
        "Also train all combinations of these, measured on the largest photos among them, and "
        "mark the Pareto front; values not given are the preset's.",
    )
    option = partial(add_option, group)
    option("--sweep-splats N...", "caps of the number of splats", int)
    option("--sweep-widths PX...", "widths of the photos", int)
    option("--sweep-iterations N...", "numbers of steps", int)


def check_sweeps(args: argparse.Namespace) -> None:
    """Raise ConfigError for invalid numbers and contradicting options."""
    numbers = _given(args)
    for name, values in numbers.items():
        least = SMALLEST_WIDTH if name == "widths" else 1
        if any(value < least for value in values):
            raise ConfigError(f"`--sweep-{name}` needs numbers of at least {least}.")
    if args.resolution is not None and any(numbers.values()):
        raise ConfigError("Give photo sizes with `--sweep-widths`, not with `--resolution`.")
    if args.sweep_splats and args.max_splats is not None:
        raise ConfigError("Give either `--sweep-splats` or `--max-splats`.")
    if args.sweep_iterations and args.iterations is not None:
        raise ConfigError("Give either `--sweep-iterations` or `--iterations`.")


def plan_sizes(
    args: argparse.Namespace, presets: Sequence[tuple[str, DataConfig, TrainConfig]]
) -> list[tuple[Size, Variant]]:
    """The requested sizes of these presets; no photo is decoded yet."""
    numbers = _given(args)
    if not any(numbers.values()):
        return []
    sizes = [run for preset in presets for run in sizes_of(*preset, **numbers)]
    variants = open_variants([(str(size), data, config) for size, data, config in sizes])
    return [(size, variant) for (size, *_), variant in zip(sizes, variants, strict=True)]


def sizes_file(output: Path, name: str) -> Path:
    """Figure file of `train_sizes` for a capture."""
    return output / f"{name}-sizes.svg"


def train_sizes(
    args: argparse.Namespace,
    cell: Cell,
    *,
    on_step: Callable[[str, int, int, int], None],
    on_found: Callable[[dict[str, Any]], None],
) -> None:
    """Train the sizes of a capture, draw them and print them.

    Args:
        args: Arguments of the command.
        cell: The capture with its sizes.
        on_step: Called with size, seed, step and number of steps after each step.
        on_found: Called after each size with `judged_on` (px) and `outcomes` so far, each with
            `best_for_its_time` and `best_for_its_splats`.
    """
    name, eval_size = cell.capture, first_size(cell.sizes[0][1].eval_views)
    outcomes: list[SizeOutcome] = []
    for size, variant in cell.sizes:
        curve = measure_variant(variant, args.seeds, along=False, on_step=on_step)
        outcomes.append(SizeOutcome.of(size, curve))
        fast, small = _fronts(outcomes)
        rows = [
            asdict(o) | {"best_for_its_time": o in fast, "best_for_its_splats": o in small}
            for o in outcomes
        ]
        on_found({"judged_on": eval_size, "outcomes": rows})
        if not args.json:
            o = outcomes[-1]
            print(f"{name}, {o.size}: {o.seconds:.1f} s, PSNR {o.psnr:.2f} dB", flush=True)
    fast, small = _fronts(outcomes)
    _draw(sizes_file(args.output, name), name, outcomes, fast, eval_size)
    if not args.json:
        print(_table(name, outcomes, fast, small), flush=True)


def _fronts(outcomes: Sequence[SizeOutcome]) -> tuple[list[SizeOutcome], list[SizeOutcome]]:
    """The Pareto fronts of PSNR over time, and over the number of splats."""
    return pareto_front(outcomes, _seconds), pareto_front(outcomes, lambda one: one.splats)


def _given(args: argparse.Namespace) -> dict[str, list[int]]:
    """The requested numbers; empty for a quantity that keeps the preset's value."""
    return {name: list(dict.fromkeys(getattr(args, f"sweep_{name}") or [])) for name in _QUANTITIES}


def _seconds(outcome: SizeOutcome) -> float:
    return outcome.seconds


def _draw(
    path: Path,
    name: str,
    outcomes: Sequence[SizeOutcome],
    fast: Sequence[SizeOutcome],
    eval_size: tuple[int, int],
) -> None:
    def family(outcome: SizeOutcome) -> str:
        size = outcome.size
        return f"{size.preset}, {size.width} px, {count_text(size.max_splats, 'splat')}"

    series = [
        Series(label=label, points=sorted((o.seconds, o.psnr) for o in group), dots=True)
        for label, group in groupby(outcomes, key=family)
    ]
    front = [(o.seconds, o.psnr) for o in fast]
    text = figure(
        [Series(label="Pareto front", points=front), *series],
        title=f"{name}: held-out PSNR at {eval_size[0]} x {eval_size[1]} px over training time",
        x_label="seconds in training steps",
        y_label="PSNR, dB",
        log_x=True,
    )
    atomic_write(path, text.encode())


def _table(
    name: str,
    outcomes: Sequence[SizeOutcome],
    fast: Sequence[SizeOutcome],
    small: Sequence[SizeOutcome],
) -> str:
    heads = (name, "photos", "splats", "steps", "seconds", "PSNR", "SSIM", "Pareto-optimal in")
    rows = []
    for o in sorted(outcomes, key=_seconds):
        best = [word for word, front in (("time", fast), ("splats", small)) if o in front]
        sizes = [o.size.preset, f"{o.size.width} px", number(o.splats), number(o.size.iterations)]
        rows.append([*sizes, f"{o.seconds:.1f}", f"{o.psnr:.2f}", f"{o.ssim:.4f}", ", ".join(best)])
    return markdown_table(heads, rows)
