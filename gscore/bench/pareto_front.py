"""Pareto front of model sizes: trainings by number of splats, photo width and steps, all measured
on photos of one size, such that no other training is both cheaper and better."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from ..config import DataConfig, TrainConfig
from ..text_format import count_text
from .time_error import Curve


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

    @classmethod
    def of(cls, size: Size, curve: Curve) -> "SizeOutcome":
        """The end of the curve of a size."""
        end = curve.median()[-1]
        return cls(
            size=size,
            seconds=end.seconds,
            splats=end.splats,
            psnr=end.psnr,
            ssim=end.ssim,
            seeds=[points[-1].psnr for points in curve.seeds],
        )


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
