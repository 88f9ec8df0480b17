"""Pareto front of model sizes: trainings by number of splats, photo width and steps, all measured
on photos of one size, such that no other training is both cheaper and better."""

import itertools
import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from ..config import DataConfig, TrainConfig
from ..datasets import Dataset
from ..text_format import count_text
from .training import train_measured


@dataclass(frozen=True, kw_only=True)
class Size:
    """Size and length of a training."""

    preset: str
    """Preset with the other options."""
    max_splats: int
    width: int
    """Maximum width of photos, px."""
    iterations: int

    def __str__(self) -> str:
        return (
            f"{self.preset}, {self.width} px, {count_text(self.max_splats, 'splat')}, "
            f"{count_text(self.iterations, 'step')}"
        )


@dataclass(frozen=True, kw_only=True)
class SizeOutcome:
    """Time and metrics of a training of one size; medians over seeds."""

    size: Size
    seconds: float
    """Time spent in steps, s."""
    splats: int
    """Number of splats at the end."""
    psnr: float
    """Mean over the held-out views at the common size, dB."""
    ssim: float
    seeds: list[float]
    """PSNR of each seed."""


def measure_sizes(
    runs: Sequence[tuple[Size, TrainConfig, Dataset]],
    eval_views: Dataset,
    seeds: Sequence[int],
    *,
    on_step: Callable[[Size, int, int], None] | None = None,
    on_outcome: Callable[[SizeOutcome], None] | None = None,
) -> list[SizeOutcome]:
    """Train each size with each seed and measure all of them on the same photos.

    Args:
        runs: Sizes of one capture with config and photos, from `sizes_of` and `open_sizes`.
        eval_views: Photos to measure on.
        seeds: At least one.
        on_step: Called with size, seed and step after each step, outside the clock.
        on_outcome: Called with each outcome.
    """
    outcomes = []
    for size, config, photos in runs:
        ends, seconds = [], []
        for seed in seeds:

            def stepped(step: int, size: Size = size, seed: int = seed) -> None:
                if on_step is not None:
                    on_step(size, seed, step)

            found = train_measured(
                replace(config, seed=seed), photos, eval_views=eval_views, on_step=stepped
            )
            ends.append(found.points[-1])
            seconds.append(found.seconds)
        outcomes.append(
            SizeOutcome(
                size=size,
                seconds=statistics.median(seconds),
                splats=round(statistics.median(end.splats for end in ends)),
                psnr=statistics.median(end.psnr for end in ends),
                ssim=statistics.median(end.ssim for end in ends),
                seeds=[end.psnr for end in ends],
            )
        )
        if on_outcome is not None:
            on_outcome(outcomes[-1])
    return outcomes


def sizes_of(
    preset: str,
    data: DataConfig,
    config: TrainConfig,
    *,
    splats: Sequence[int],
    widths: Sequence[int],
    iterations: Sequence[int],
) -> list[tuple[Size, DataConfig, TrainConfig]]:
    """All combinations of the given numbers; empty sequences keep the value of the preset.

    Raises:
        ConfigError: an invalid number.
    """
    combinations = itertools.product(
        widths or (data.max_width,),
        splats or (config.max_splats,),
        iterations or (config.iterations,),
    )
    return [
        (
            Size(preset=preset, max_splats=n, width=width, iterations=steps),
            replace(data, max_width=width),
            replace(config, max_splats=n, iterations=steps),
        )
        for width, n, steps in combinations
    ]


def pareto_front(
    outcomes: Sequence[SizeOutcome], cost: Callable[[SizeOutcome], float]
) -> list[SizeOutcome]:
    """The Pareto front of cost and PSNR, by increasing cost."""
    front: list[SizeOutcome] = []
    known = [o for o in outcomes if math.isfinite(o.psnr)]
    for outcome in sorted(known, key=lambda o: (cost(o), -o.psnr)):
        if not front or outcome.psnr > front[-1].psnr:
            front.append(outcome)
    return front
