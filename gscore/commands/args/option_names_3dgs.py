"""Option names of 3DGS: accepted for its scripts, hidden in help."""

import argparse
from typing import Any, NamedTuple

from ...config import Background, Switch, TrainConfig
from ...config_file import REMOVED
from ...errors import ConfigError
from ...options import Option, options_of
from .run_options import argument_facts

ALIASES = {
    "max_splats": "--cap-max",
    "antialias": "--antialiasing",
    "means_lr": "--position-lr-init",
    "means_lr_final": "--position-lr-final",
    "opacities_lr": "--opacity-lr",
    "scales_lr": "--scaling-lr",
    "quats_lr": "--rotation-lr",
    "exposure_lr": "--exposure-lr-init",
    "ssim_weight": "--lambda-dssim",
    "depth_weight": "--depth-l1-weight-init",
    "depth_weight_final": "--depth-l1-weight-final",
    "refine_start": "--densify-from-iter",
    "refine_stop": "--densify-until-iter",
    "refine_every": "--densification-interval",
    "reset_every": "--opacity-reset-interval",
    "grow_grad": "--densify-grad-threshold",
    "mcmc_noise": "--noise-lr",
}
"""Other names of options of `TrainConfig`."""
_WITHOUT_EFFECT = ("--debug-from",)
"""It concerns debug dumps, not the result."""
_SWITCHES = {
    "white_background": ("-w", "--white-background"),
    "random_background": ("--random-background",),
    "train_test_exp": ("--train-test-exp",),
    "disable_viewer": ("--disable-viewer",),
}
"""The first two select a background, the third turns on `exposure`, the last overrides `--port`."""
_FEATURE_LR_SHARE = 20
"""--feature-lr also sets the rate of the higher SH bands, divided by this."""
REFUSED = {
    "--debug": "the rasterizer has no debug dumps; see `--detect-anomaly`",
    "--position-lr-max-steps": "the rate of positions falls until the last step",
    "--position-lr-delay-mult": "the rate of positions is not delayed at the start",
    "--data-device": "photos are always kept as bytes in main memory",
    "--optimizer-type": "there is one optimizer, Adam",
    "--exposure-lr-delay-steps": "the rate of exposures is not delayed at the start",
    "--exposure-lr-delay-mult": "the rate of exposures is not delayed at the start",
}
"""Options without a counterpart here, with the reason."""


class Row(NamedTuple):
    """A 3DGS option name and its equivalent here."""

    name: str
    here: str


def add_3dgs_names(parser: argparse.ArgumentParser) -> None:
    """Declare all of them, hidden in help."""
    declared = options_of(TrainConfig)
    for name, flag in ALIASES.items():
        facts = argument_facts(declared[name])
        parser.add_argument(flag, dest=name, default=None, help=argparse.SUPPRESS, **facts)
    for name, flags in _SWITCHES.items():
        parser.add_argument(*flags, dest=name, action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--feature-lr", type=float, help=argparse.SUPPRESS)
    for flag in _WITHOUT_EFFECT:
        parser.add_argument(flag, help=argparse.SUPPRESS)
    for name, (value, meaning) in REMOVED.items():
        one = Option(name=name, default=value, kind=type(value), text=meaning, group="removed")
        flags = [one.flag, "--percent-dense"] if name == "grow_scale" else [one.flag]
        facts = argument_facts(one) | {"dest": name, "default": None, "help": argparse.SUPPRESS}
        vars(parser.add_argument(*flags, **facts))["declared"] = one
    for flag, reason in REFUSED.items():
        parser.add_argument(flag, nargs="*", action=_Refuse, reason=reason)


def rows() -> list[Row]:
    """All of them as a table."""
    return [
        *(Row(flag, name) for name, flag in ALIASES.items()),
        Row("--feature-lr X", f"sh0_lr X and shN_lr X / {_FEATURE_LR_SHARE}"),
        Row("-w, --white-background", "background white"),
        Row("--random-background", "background random"),
        Row("--train-test-exp", "exposure on; psnr_cc fits colours on half of a held-out view"),
        Row("--disable-viewer", "port 0, overriding `--port`"),
        *(Row(flag, "without effect") for flag in _WITHOUT_EFFECT),
        Row("--percent-dense", f"without effect: {REMOVED['grow_scale'][1]}"),
        *(Row(flag, f"refused: {reason}") for flag, reason in REFUSED.items()),
    ]


def translated(args: argparse.Namespace) -> dict[str, Any]:
    """The options of `TrainConfig` that the given 3DGS names set.

    Raises:
        ConfigError: contradicting options.
    """
    if args.white_background and args.random_background:
        raise ConfigError("Give either `--white-background` or `--random-background`.")
    found: dict[str, Any] = {}
    if args.white_background or args.random_background:
        found["background"] = Background.WHITE if args.white_background else Background.RANDOM
    if args.train_test_exp:
        found["exposure"] = Switch.ON
    if args.feature_lr is not None:
        found |= {"sh0_lr": args.feature_lr, "shN_lr": args.feature_lr / _FEATURE_LR_SHARE}
    return found


class _Refuse(argparse.Action):
    """An option without a counterpart here."""

    def __init__(self, *args: Any, reason: str, **kwargs: Any) -> None:
        super().__init__(*args, help=argparse.SUPPRESS, **kwargs)
        self._reason = reason

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        parser.error(f"{option_string}: {self._reason}; leave it out")
