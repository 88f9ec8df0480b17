"""Skip bench: the gain of each skip, from trainings without it, and without several."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..config import Skip, TrainConfig
from ..datasets import Dataset
from ..splats import PARAMETERS, Splats
from .training import Trained, train_measured


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


def bench_skips(
    config: TrainConfig,
    photos: Dataset,
    *,
    skips: Sequence[Skip] = tuple(Skip),
    on_row: Callable[[SkipRow], None] | None = None,
) -> list[SkipRow]:
    """Train with all skips, without each of `skips`, and without all of these.

    Args:
        config: Options; the skips in its `without` stay disabled in every row.
        photos: Decoded photos, with held-out views.
        skips: Skips to measure.
        on_row: Called with each finished row.

    Returns:
        The row with all skips, one per skip, and for several one without all of these.
    """
    tried: list[tuple[Skip, ...]] = [(), *((skip,) for skip in skips)]
    if len(skips) > 1:
        tried.append(tuple(skips))
    rows: list[SkipRow] = []
    first: Trained | None = None
    for off in tried:
        found = train_measured(replace(config, without=(*config.without, *off)), photos)
        first = first or found
        row = SkipRow(
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
        rows.append(row)
        if on_row is not None:
            on_row(row)
    return rows


def _same_bits(a: Splats, b: Splats) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in PARAMETERS)
