"""Presets: four levels of training length and quality."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from .choices import Stereo
from .config import DataConfig, TrainConfig

_LIMITED = TrainConfig(opaque_weight=0.005, steps_a_photo=80)
"""Common options of all presets but `preview`: more steps per photo degrade novel views."""
_LONG = replace(
    _LIMITED,
    stereo=Stereo.AUTO,
    drop_rate=0.1,
    drop_below=0.35,
    ensemble=2,
    ensemble_below=0.35,
)
"""Common options of the longer presets: stereo points guide densification; dropout and an ensemble
reduce overfitting where the photos disagree."""


def preview(source: Path) -> tuple[DataConfig, TrainConfig]:
    """A first impression, in about 15 s on two cores; 30 s with AVX2."""
    # Few steps need a higher weight to fill dark areas (docs/experiments).
    train = TrainConfig(iterations=1500, max_splats=50_000, sh_degree=1, opaque_weight=0.02)
    return DataConfig(source=source, max_width=400), train


def draft(source: Path) -> tuple[DataConfig, TrainConfig]:
    """Enough to assess a capture, in about 75 s on two cores."""
    # Stereo points are worth the time they take from the steps (docs/experiments).
    train = replace(
        _LIMITED,
        iterations=4000,
        steps_a_photo=68,
        max_splats=150_000,
        sh_degree=2,
        stereo=Stereo.AUTO,
    )
    return DataConfig(source=source, max_width=640), train


def normal(source: Path) -> tuple[DataConfig, TrainConfig]:
    """The everyday choice, in about five minutes on two cores."""
    train = replace(_LONG, iterations=7000, max_splats=300_000)
    return DataConfig(source=source, max_width=1000), train


def high(source: Path) -> tuple[DataConfig, TrainConfig]:
    """The best quality, in ten minutes to an hour on two cores."""
    # Three models of 200,000 have finer detail than two of 150,000, at the same PSNR.
    train = replace(_LONG, iterations=15_000, max_splats=600_000, splats_a_photo=6000, ensemble=3)
    return DataConfig(source=source, max_width=1600), train


PRESETS: dict[str, Callable[[Path], tuple[DataConfig, TrainConfig]]] = {
    f.__name__: f for f in (preview, draft, normal, high)
}
