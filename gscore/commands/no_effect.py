"""Options of a training that were given and change nothing in it: said in one warning."""

import argparse
from collections.abc import Callable

from ..config import DataConfig, Skip, Strategy, Switch, TrainConfig, flag_of

_Idle = Callable[[argparse.Namespace, DataConfig, TrainConfig], bool]
_Rule = tuple[str, _Idle]


def _no_depth(_: argparse.Namespace, data: DataConfig, config: TrainConfig) -> bool:
    return not data.depths or config.depth_mode is Switch.OFF


def _no_bands(_: argparse.Namespace, data: DataConfig, config: TrainConfig) -> bool:
    return config.sh_degree == 0


def _large_photos(_: argparse.Namespace, data: DataConfig, config: TrainConfig) -> bool:
    return Skip.SMALL_PHOTOS in config.without


def _beyond(name: str) -> _Idle:
    """Whether all steps of an option come after the last."""

    def idle(_: argparse.Namespace, data: DataConfig, config: TrainConfig) -> bool:
        steps = getattr(config, name)
        return not config.time_budget and bool(steps) and min(steps) > config.iterations

    return idle


_MCMC: _Rule = ("--strategy mcmc alone uses it", lambda a, d, c: c.strategy is not Strategy.MCMC)
_DEFAULT: _Rule = ("not used by --strategy mcmc", lambda a, d, c: c.strategy is Strategy.MCMC)
_DEPTH: _Rule = ("depth supervises only with --depths, unless --depth-mode off", _no_depth)
_BANDS: _Rule = ("--sh-degree 0 has no view-dependent colour", _no_bands)
_SMALL: _Rule = ("--without small-photos", _large_photos)
_STARTS: _Rule = ("--start-splats are as they are", lambda a, d, c: c.start_splats is not None)
_SPLIT: _Rule = ("--no-eval holds no views out", lambda a, d, c: not d.eval)
_VIEWER: _Rule = ("there is no network viewer", lambda a, d, c: True)

RULES: dict[str, _Rule] = {
    "ip": _VIEWER,
    "port": _VIEWER,
    "debug_from": ("there are no debug dumps", lambda a, d, c: True),
    **dict.fromkeys(("mcmc_growth", "mcmc_noise", "opacity_reg", "scale_reg", "reg_final"), _MCMC),
    **dict.fromkeys(
        ("reset_every", "grow_grad", "grow_scale", "prune_scale", "grow_with_photos"), _DEFAULT
    ),
    **dict.fromkeys(
        ("depth_align", "depth_weight", "depth_weight_final", "depth_warmup", "depth_pearson"),
        _DEPTH,
    ),
    "depth_points": _DEPTH,
    "depth_mode": ("there are no depth maps without --depths", lambda a, d, c: not d.depths),
    "depths": ("--depth-mode off", lambda a, d, c: c.depth_mode is Switch.OFF),
    **dict.fromkeys(("shN_lr", "shN_every", "sh_every"), _BANDS),
    **dict.fromkeys(("coarse_factor", "coarse_until", "coarse_by_detail"), _SMALL),
    **dict.fromkeys(("init_opacity", "init_scale"), _STARTS),
    "start_opacity": ("of --start-splats alone", lambda a, d, c: c.start_splats is None),
    **dict.fromkeys(("test_every", "test_list", "test_first", "test_last"), _SPLIT),
    **{
        name: ("all after the last step", _beyond(name))
        for name in ("test_iterations", "save_iterations", "checkpoint_iterations")
    },
    **dict.fromkeys(
        ("masks", "invert_masks"), ("--mask-mode none", lambda a, d, c: d.mask_mode == "none")
    ),
    "hidden_share": (
        "only where masks hide parts of a scene",
        lambda a, d, c: d.mask_mode in ("none", "composite"),
    ),
    "white_background": (
        "--background says otherwise",
        lambda a, d, c: a.background not in (None, "white"),
    ),
    "random_background": (
        "--background says otherwise",
        lambda a, d, c: a.background not in (None, "random"),
    ),
    "feature_lr": (
        "--sh0-lr and --shN-lr are given",
        lambda a, d, c: a.sh0_lr is not None and a.shN_lr is not None,
    ),
}
"""By option: why it can be idle, and whether it is."""


def idle_options(args: argparse.Namespace, data: DataConfig, config: TrainConfig) -> str:
    """A sentence on the options that were given without effect, with the reasons; or nothing.

    Args:
        args: As they were given, before `configs` fills some in.
        data, config: What came of them.
    """
    reasons: dict[str, list[str]] = {}
    for name, (reason, idle) in RULES.items():
        value = getattr(args, name, None)
        if value is not None and value is not False and idle(args, data, config):
            reasons.setdefault(reason, []).append(flag_of(name))
    if not reasons:
        return ""
    parts = [f"{', '.join(names)} ({reason})" for reason, names in reasons.items()]
    return f"Without effect in this run: {'; '.join(parts)}."
