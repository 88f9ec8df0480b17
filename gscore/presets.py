"""Presets: levels of training length and quality, larger where a graphics card trains; and
published recipes, to compare with."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from .choices import Background, Doubling, Stereo, Switch
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


def highest(source: Path) -> tuple[DataConfig, TrainConfig]:
    """For graphics cards, as CPUs take hours to days: photos of up to 4K."""
    train = replace(
        _LONG, iterations=30_000, max_splats=5_000_000, splats_a_photo=20_000, ensemble=3
    )
    return DataConfig(source=source, max_width=3840), train


PRESETS: dict[str, Callable[[Path], tuple[DataConfig, TrainConfig]]] = {
    f.__name__: f for f in (preview, draft, normal, high, highest)
}


_ON_CARD: dict[str, tuple[int, dict[str, int]]] = {
    "preview": (720, {"iterations": 2000, "max_splats": 150_000, "sh_degree": 2}),
    "draft": (960, {"iterations": 6000, "max_splats": 300_000, "sh_degree": 3}),
    "normal": (1280, {"iterations": 10_000, "max_splats": 600_000, "splats_a_photo": 6000}),
    "high": (1920, {"iterations": 20_000, "max_splats": 1_500_000, "splats_a_photo": 10_000}),
}
"""Width of photos and other options of the presets where a graphics card trains: estimated from the
work of a step, as no card was measured (docs/gpu.md). No width is that of another preset, so
that it identifies one."""


def on_cpu(name: str, source: Path) -> tuple[DataConfig, TrainConfig]:
    """A recipe where the CPU trains, see `on_card`."""
    return RECIPES[name](source)


def on_card(name: str, source: Path) -> tuple[DataConfig, TrainConfig]:
    """A recipe where a graphics card trains.

    Args:
        name: One of `RECIPES`.
        source: Folder of the capture.
    """
    data, train = RECIPES[name](source)
    width, changes = _ON_CARD.get(name, (data.max_width, {}))
    return replace(data, max_width=width), replace(train, **changes)


def published_3dgs(source: Path) -> tuple[DataConfig, TrainConfig]:
    """The recipe of Kerbl et al. 2023, section 5 and the options of their release of 2023, without
    any decision of gscore.

    It differs from theirs in four details:

    - They have no cap of splats; here 6,000,000, above the 1 to 5 million of their scenes.
    - Their rasterizer leaves out splats nearer than 0.2 units; here 0.01, the near plane of their
      cameras.
    - They split a splat of more than a tenth of the extent before they remove large ones, so that
      its halves may stay; here it is removed.
    - They raise the SH degree before every 1,000th step; here after it.
    """
    train = TrainConfig(
        iterations=30_000,
        max_splats=6_000_000,
        background=Background.BLACK,
        sh_every=1000,
        shN_every=1,
        opacities_lr=0.05,  # later releases: 0.025
        lr_boost=1,
        lr_final=1,
        init_opacity=0.1,
        init_scale=1,
        stereo=Stereo.OFF,
        depth_mode=Switch.OFF,
        exposure=Switch.OFF,
        sky=Switch.OFF,
        refine_poses=Switch.OFF,
        photo_blur=False,
        transient_masks=False,
        coarse_factor=1,
        grow_with_photos=False,
        # Their conditions exclude the ends: they grow in steps 600 to 14,900.
        refine_start=501,
        refine_stop=14_999,
        refine_every=100,
        reset_every=3000,
        grow_grad=2e-4,
        doubling=Doubling.CLONE_SPLIT,
        free_space=0,
        hidden_share=0,
        watchdog=False,
    )
    return DataConfig(source=source, max_width=1600), train


RECIPES = PRESETS | {"3dgs": published_3dgs}
"""Presets of `gscore train` and the benches: those that a user chooses from, and published recipes
to compare with."""
