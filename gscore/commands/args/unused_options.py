"""Unused options: one warning for training options without effect in a run."""

from collections.abc import Callable, Mapping
from typing import Any

from ...config import DataConfig, Skip, Stereo, Strategy, Switch, TrainConfig
from ...config_file import REMOVED
from ...hold_out import SPLIT
from ...live_options import LiveOptions
from ...option_marks import mark_option
from ...options import Option, options_of

_Idle = Callable[[Mapping[str, Any], DataConfig, TrainConfig], bool]
_Rule = tuple[str, _Idle]


def _beyond(name: str) -> _Idle:
    """Predicate: all steps of an option come after the last step of the run."""

    def idle(_: Mapping[str, Any], data: DataConfig, config: TrainConfig) -> bool:
        steps = getattr(config, name)
        return not config.time_budget and bool(steps) and min(steps) > config.iterations

    return idle


def _no_maps(data: DataConfig, config: TrainConfig) -> bool:
    """Whether a run has no depth maps; one whose options require them is refused."""
    return not data.depths and config.depth_mode is not Switch.ON and config.depth_points <= 0


def _differs(name: str, value: Any) -> _Idle:
    """Predicate: a removed option has another value than today's."""
    return lambda given, data, config: given[name] != value


_WHEN: dict[str, _Rule] = {
    "mcmc": ("only with `--strategy mcmc`", lambda a, d, c: c.strategy is not Strategy.MCMC),
    "default": ("not with `--strategy mcmc`", lambda a, d, c: c.strategy is Strategy.MCMC),
    "depth": (
        "only with `--depths`, not with `--depth-mode off`",
        lambda a, d, c: _no_maps(d, c) or c.depth_mode is Switch.OFF,
    ),
    "depth_maps": ("only with `--depths`", lambda a, d, c: _no_maps(d, c)),
    "depth_on": ("not with `--depth-mode off`", lambda a, d, c: c.depth_mode is Switch.OFF),
    "poses": ("not with `--refine-poses off`", lambda a, d, c: c.refine_poses is Switch.OFF),
    "exposure": ("not with `--exposure off`", lambda a, d, c: c.exposure is Switch.OFF),
    "bands": ("not with `--sh-degree 0`", lambda a, d, c: c.sh_degree == 0),
    "small_photos": (
        "not with `--without small-photos`",
        lambda a, d, c: Skip.SMALL_PHOTOS in c.without,
    ),
    "points": ("not with `--start-splats`", lambda a, d, c: c.start_splats is not None),
    "stereo": (
        "not with `--stereo off` or `--start-splats`",
        lambda a, d, c: c.stereo == Stereo.OFF or c.start_splats is not None,
    ),
    "one_model": ("not with `--start-splats`", lambda a, d, c: c.start_splats is not None),
    "ensemble": (
        "not with `--ensemble 1` or `--start-splats`",
        lambda a, d, c: c.ensemble == 1 or c.start_splats is not None,
    ),
    "surface": ("only with `--surface-weight`", lambda a, d, c: c.surface_weight == 0),
    "dropping": ("not with `--drop-rate 0`", lambda a, d, c: c.drop_rate == 0),
    "guide_surface": ("only with `--guide-surface`", lambda a, d, c: c.guide_surface is None),
    "start_splats": ("only with `--start-splats`", lambda a, d, c: c.start_splats is None),
    "viewer": ("not with `--disable-viewer`", lambda a, d, c: a["disable_viewer"]),
    "port": (
        "only with `--port`, not with `--disable-viewer`",
        lambda a, d, c: not a.get("port") or a["disable_viewer"],
    ),
    "masks": ("not with `--mask-mode none`", lambda a, d, c: d.mask_mode == "none"),
    "hiding_masks": (
        "only with ignore masks",
        lambda a, d, c: d.mask_mode in ("none", "composite"),
    ),
}
"""Condition of the effect in words, and the predicate of an idle option, by `Option.when`."""
_SPLIT: _Rule = ("not with `--no-eval`", lambda a, d, c: not d.eval)


def _rule(one: Option) -> _Rule:
    return (
        ("only up to the last step", _beyond(one.name)) if one.when == "steps" else _WHEN[one.when]
    )


RULES: dict[str, _Rule] = {
    **{
        one.name: _rule(one)
        for cls in (DataConfig, TrainConfig, LiveOptions)
        for one in options_of(cls).values()
        if one.when
    },
    **dict.fromkeys(("hold_out", *SPLIT), _SPLIT),
    **{name: (meaning, _differs(name, value)) for name, (value, meaning) in REMOVED.items()},
    "debug_from": ("there are no debug dumps", lambda a, d, c: True),
    "white_background": (
        "overridden by `--background`",
        lambda a, d, c: a.get("background") not in (None, "white"),
    ),
    "random_background": (
        "overridden by `--background`",
        lambda a, d, c: a.get("background") not in (None, "random"),
    ),
    "train_test_exp": ("overridden by `--exposure`", lambda a, d, c: c.exposure is not Switch.ON),
    "feature_lr": (
        "overridden by `--sh0-lr` and `--shN-lr`",
        lambda a, d, c: "sh0_lr" in a and "shN_lr" in a,
    ),
}
"""The same by option."""


def reason_of(one: Option) -> str:
    """The condition under which an option has an effect; empty: always."""
    return RULES[one.name][0] if one.name in RULES else ""


def unused_options(given: Mapping[str, Any], data: DataConfig, config: TrainConfig) -> str:
    """One sentence on given options without effect, with the reasons; empty if there are none.

    Args:
        given: Arguments by name, without those that were not given.
        data, config: The resulting configs.
    """
    reasons: dict[str, list[str]] = {}
    for name, (reason, idle) in RULES.items():
        if given.get(name, False) is not False and idle(given, data, config):
            reasons.setdefault(reason, []).append(mark_option(name))
    if not reasons:
        return ""
    parts = [f"{', '.join(names)} ({reason})" for reason, names in reasons.items()]
    return f"Without effect in this run: {'; '.join(parts)}."
