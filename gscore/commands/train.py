"""`gscore train`: options under the names 3DGS users know, and what comes out of them."""

import argparse
import sys
from dataclasses import fields, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..config import PRESETS, Background, DataConfig, Skip, Strategy, Switch, TrainConfig
from ..config_file import load_config
from ..control import Control
from ..errors import ConfigError
from ..events import CONVERGED, ENDED, FINISHED, TARGET, Warn
from ..io.places import check_place
from ..io.runs import others_in_run
from ..words import count_words, number, quality_words
from .attend import Show, add_output_options, attend
from .data_options import add_data_options, add_depth_options, with_data_options
from .no_effect import idle_options
from .option_help import option_help
from .output import first_few, print_json
from .status import wrapped

if TYPE_CHECKING:  # torch, which training imports, takes seconds to load: --help need not wait
    from ..trainer.files.ended import TrainResult

_STEPS: dict[str, Any] = {"type": int, "nargs": "+", "metavar": "STEP"}
_SWITCH: dict[str, Any] = {"action": argparse.BooleanOptionalAction}


def _of_presets(name: str) -> str:
    """The values of an option in the presets."""
    values = ((key, getattr(make(Path())[1], name)) for key, make in PRESETS.items())
    return ", ".join(f"{key} {number(value)}" for key, value in values)


_RUN: dict[str, tuple[tuple[str, ...], dict[str, Any], str]] = {
    "iterations": (
        ("--iterations",),
        {"type": int, "metavar": "N"},
        f"training steps ({_of_presets('iterations')})",
    ),
    "time_budget": (
        ("--time-budget",),
        {"type": float, "metavar": "SECONDS"},
        "as many steps as fit into so much training time, instead of --iterations (0: no budget)",
    ),
    "target_psnr": (
        ("--target-psnr",),
        {"type": float, "metavar": "DB"},
        "end when the held-out photos (else the others) are matched with this PSNR, a likeness of "
        "which more is better (0: none)",
    ),
    "early_stop": (("--early-stop",), _SWITCH, "end when that PSNR no longer rises"),
    "max_splats": (
        ("--max-splats", "--cap-max"),
        {"type": int, "metavar": "N"},
        f"never more splats than this ({_of_presets('max_splats')})",
    ),
    "strategy": (
        ("--strategy",),
        {"choices": tuple(Strategy)},
        "how splats are added and removed (default); mcmc, Markov chain Monte Carlo, moves useless "
        "ones instead: for long runs, in a few hundred steps it is far behind",
    ),
    "sh_degree": (
        ("--sh-degree",),
        {"type": int, "metavar": "N"},
        f"degree of view-dependent colour, 0 to 3 ({_of_presets('sh_degree')})",
    ),
    "seed": (("--seed",), {"type": int, "metavar": "N"}, "same seed, same result, bit for bit"),
    "threads": (("--threads",), {"type": int, "metavar": "N"}, "CPU threads; 0: all cores (0)"),
    "cache_mb": (
        ("--cache-mb",),
        {"type": int, "metavar": "MB"},
        "memory for decoded photos; 0: all, or as many as fit",
    ),
    "background": (
        ("--background",),
        {"choices": tuple(Background)},
        "what lies behind the splats",
    ),
    "antialias": (
        ("--antialias", "--antialiasing"),
        _SWITCH,
        "draw splats below the size of a pixel fainter",
    ),
    "depth_mode": (
        ("--depth-mode",),
        {"choices": tuple(Switch)},
        "let the maps of --depths guide the training; auto: where photos are few",
    ),
    "grow_with_photos": (
        ("--grow-with-photos",),
        _SWITCH,
        "add splats as photos become larger, not before; from 1,000 steps on, not with mcmc (on)",
    ),
    "coarse_by_detail": (
        ("--coarse-by-detail",),
        _SWITCH,
        "keep photos small for as long as their detail allows, not a fixed share of the steps",
    ),
    "without": (
        ("--without",),
        {"nargs": "+", "choices": [skip.value for skip in Skip], "metavar": "SKIP"},
        "do work that is skipped as needless, to prove or measure that: " + ", ".join(Skip),
    ),
    "near": (
        ("--near",),
        {"type": float, "metavar": "X"},
        "splats nearer to a camera are not drawn; world units",
    ),
    "start_splats": (
        ("--start-splats",),
        {"type": Path, "metavar": "FILE.ply"},
        "start from these splats, in the capture's world, instead of its points",
    ),
    "lpips": (
        ("--lpips",),
        {"type": Path, "metavar": "FILE.onnx"},
        "network of LPIPS, a measure of likeness as people see it; without it, not measured",
    ),
    "test_iterations": (("--test-iterations",), _STEPS, "measure after these steps too"),
    "save_iterations": (("--save-iterations",), _STEPS, "write the splats after these steps too"),
    "checkpoint_iterations": (
        ("--checkpoint-iterations",),
        _STEPS,
        "write checkpoints after these steps and keep them",
    ),
    "checkpoint_seconds": (
        ("--checkpoint-seconds",),
        {"type": float, "metavar": "SECONDS"},
        "training time between two checkpoints (300); 0: only at the end",
    ),
    "preview_seconds": (
        ("--preview-seconds",),
        {"type": float, "metavar": "SECONDS"},
        "training time between two pictures in OUT/previews; 0: none",
    ),
    "snapshot_every": (
        ("--snapshot-every",),
        {"type": int, "metavar": "N"},
        "steps between two PLYs in OUT/snapshots, of which two are kept; 0: none",
    ),
    "watchdog": (
        ("--watchdog",),
        _SWITCH,
        "where training goes astray, go back to a checkpoint and on with lower learning rates (on)",
    ),
    "detect_anomaly": (
        ("--detect-anomaly",),
        _SWITCH,
        "stop at the first number that is not finite and say where it came from; slow",
    ),
}
_METHOD = {
    "means_lr": ("--means-lr", "--position-lr-init"),
    "means_lr_final": ("--means-lr-final", "--position-lr-final"),
    "sh0_lr": ("--sh0-lr",),
    "shN_lr": ("--shN-lr",),
    "shN_every": ("--shN-every",),
    "opacities_lr": ("--opacities-lr", "--opacity-lr"),
    "scales_lr": ("--scales-lr", "--scaling-lr"),
    "quats_lr": ("--quats-lr", "--rotation-lr"),
    "lr_boost": ("--lr-boost",),
    "lr_final": ("--lr-final",),
    "ssim_weight": ("--ssim-weight", "--lambda-dssim"),
    "depth_weight": ("--depth-weight", "--depth-l1-weight-init"),
    "depth_weight_final": ("--depth-weight-final", "--depth-l1-weight-final"),
    "depth_warmup": ("--depth-warmup",),
    "depth_pearson": ("--depth-pearson",),
    "depth_points": ("--depth-points",),
    "drop_rate": ("--drop-rate",),
    "alpha_weight": ("--alpha-weight",),
    "sh_every": ("--sh-every",),
    "coarse_factor": ("--coarse-factor",),
    "coarse_until": ("--coarse-until",),
    "start_opacity": ("--start-opacity",),
    "init_opacity": ("--init-opacity",),
    "init_scale": ("--init-scale",),
    "refine_start": ("--refine-start", "--densify-from-iter"),
    "refine_stop": ("--refine-stop", "--densify-until-iter"),
    "refine_every": ("--refine-every", "--densification-interval"),
    "reset_every": ("--reset-every", "--opacity-reset-interval"),
    "grow_grad": ("--grow-grad", "--densify-grad-threshold"),
    "grow_scale": ("--grow-scale", "--percent-dense"),
    "prune_opacity": ("--prune-opacity",),
    "prune_scale": ("--prune-scale",),
    "prune_share": ("--prune-share",),
    "free_space": ("--free-space",),
    "hidden_share": ("--hidden-share",),
    "mcmc_growth": ("--mcmc-growth",),
    "mcmc_noise": ("--mcmc-noise", "--noise-lr"),
    "opacity_reg": ("--opacity-reg",),
    "scale_reg": ("--scale-reg",),
    "reg_final": ("--reg-final",),
}
_HOW = {
    FINISHED: "Finished",
    TARGET: "Reached the PSNR asked for",
    CONVERGED: "Converged (the PSNR no longer rose)",
}
_WITHOUT_EFFECT = ("--ip", "--port", "--debug-from")
"""Of 3DGS scripts: they concern its network viewer and its debug dumps, not the result."""
_FEATURE_LR_SHARE = 20
"""The 3DGS option --feature-lr also sets the rate of the higher SH bands, divided by this."""
_NOT_HERE = {
    ("--debug",): "the rasterizer has no debug dumps; see --detect-anomaly",
    ("--position-lr-max-steps",): "the rate of positions falls until the last step",
    ("--position-lr-delay-mult",): "the rate of positions is not delayed at the start",
    ("--data-device",): "photos are always kept as bytes in main memory",
    ("--optimizer-type",): "there is one optimizer, Adam",
    ("--train-test-exp",): "exposure is not optimised",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `gscore train`."""
    parser.add_argument(
        "source",
        nargs="?",
        type=Path,
        help="the capture: a folder with photos and COLMAP's model of their cameras",
    )
    parser.add_argument(
        "-s", "--source", "--source-path", dest="source_option", type=Path, help=argparse.SUPPRESS
    )
    parser.add_argument(
        "-o", "-m", "--output", "--model-path", required=True, type=Path, help="folder for results"
    )
    parser.add_argument(
        "--preset",
        choices=tuple(PRESETS),
        help="how much effort to spend (normal): sets --iterations, --max-splats, --sh-degree and "
        "the width of the photos",
    )
    parser.add_argument(
        "--config", type=Path, metavar="FILE.json", help="options of another run, its config.json"
    )
    existing = parser.add_mutually_exclusive_group()
    existing.add_argument(
        "--resume", action="store_true", help="go on from the last checkpoint in the output folder"
    )
    existing.add_argument(
        "--overwrite",
        action="store_true",
        help="replace another run in the output folder; other files there stay",
    )
    existing.add_argument(
        "--start-checkpoint", type=Path, metavar="FILE", help="go on from this checkpoint"
    )
    add_data_options(parser)
    add_depth_options(parser)
    parser.add_argument(
        "--eval",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="hold every 8th view out and measure on them; implied by the options that choose some",
    )
    group = parser.add_argument_group("run")
    for name, (flags, kind, text) in _RUN.items():
        group.add_argument(*flags, dest=name, default=None, help=text, **kind)
    group.add_argument(
        "-w", "--white-background", action="store_true", help="the same as --background white"
    )
    group.add_argument(
        "--random-background", action="store_true", help="the same as --background random"
    )
    group = parser.add_argument_group(
        "method",
        "For experiments: the defaults suit most captures. Also under their 3DGS names; "
        "gscore.TrainConfig says more on each. An extent is 1.1 times the largest distance of a "
        "camera from the middle of all; SH (spherical harmonics) are the view-dependent colour; "
        "SfM points are those that COLMAP found; to refine is to add and remove splats. Learning "
        "rates are raised in runs of less than 30,000 steps and fall over the last tenth of any; "
        "--lr-boost 1 --lr-final 1 takes them exactly as given.",
    )
    kinds = {f.name: type(f.default) for f in fields(TrainConfig)}
    for name, flags in _METHOD.items():
        kind = kinds[name]
        group.add_argument(
            *flags,
            dest=name,
            default=None,
            type=kind,
            metavar="N" if kind is int else "X",
            help=option_help(TrainConfig, name),
        )
    group.add_argument(
        "--feature-lr",
        type=float,
        metavar="X",
        help="sets --sh0-lr, and --shN-lr to a twentieth of it, as 3DGS does",
    )
    add_output_options(parser)
    for name in _WITHOUT_EFFECT:
        parser.add_argument(name, help=argparse.SUPPRESS)
    for names, reason in _NOT_HERE.items():
        parser.add_argument(*names, nargs="*", action=_Refuse, reason=reason)


def run(args: argparse.Namespace) -> int:
    """Train and say how it went; returns the exit code."""
    result, code = attend(args, lambda show, control: _train(args, show, control))
    if result is None:
        return code
    if args.json:
        numbers = result.headline | {"reason": result.reason, "output": str(args.output)}
        print_json(numbers)
    elif not (args.quiet or args.events):
        print(wrapped(_summary(result, configs(args)[1]), sys.stdout))
    return code


def configs(args: argparse.Namespace) -> tuple[DataConfig, TrainConfig]:
    """The options: of a preset, a file or the run that goes on, then those given one by one."""
    source = args.source or args.source_option
    if args.source and args.source_option and args.source != args.source_option:
        raise ConfigError(f"Two captures were given: {args.source} and {args.source_option}.")
    if args.config and args.preset:
        raise ConfigError("Give either --preset or --config: a config file holds all options.")
    stored = args.config
    if args.resume and not (args.config or (args.preset and source)):
        stored = args.output / "config.json"
        if not stored.is_file():
            from ..trainer.files.folder import check_free

            check_free(args.output)  # a run that has only just begun has written nothing yet
            raise ConfigError(f"{args.output} holds no run to resume; leave --resume out.")
    if args.preset and stored:
        source = load_config(stored)[0].source
        data, config = PRESETS[args.preset](source)
    elif stored:
        data, config = load_config(stored)
        data = replace(data, source=source or data.source)
    elif source is None:
        raise ConfigError("No capture was given: `gscore train SOURCE -o OUTPUT`.")
    else:
        data, config = PRESETS[args.preset or "normal"](source)
    if args.white_background and args.random_background:
        raise ConfigError("Give either --white-background or --random-background.")
    if args.white_background or args.random_background:
        asked = Background.WHITE if args.white_background else Background.RANDOM
        args.background = args.background or asked
    if args.feature_lr is not None:
        args.sh0_lr = args.feature_lr if args.sh0_lr is None else args.sh0_lr
        args.shN_lr = args.feature_lr / _FEATURE_LR_SHARE if args.shN_lr is None else args.shN_lr
    data = with_data_options(data, args)
    if args.eval is not None:
        data = replace(data, eval=args.eval)
    config = _with_given(config, args)
    if args.iterations is not None and config.time_budget > 0:
        raise ConfigError(
            f"A time budget ({config.time_budget:g} s) finds the number of steps itself; leave "
            "--iterations out, or give --time-budget 0."
        )
    return data, config


def told_configs(args: argparse.Namespace, show: Show) -> tuple[DataConfig, TrainConfig]:
    """As `configs`, with a warning about options that do nothing in this run."""
    given = argparse.Namespace(**vars(args))  # `configs` fills some in
    data, config = configs(args)
    if idle := idle_options(given, data, config):
        show(Warn(message=idle, code="no_effect"))
    return data, config


def _with_given(config: TrainConfig, args: argparse.Namespace) -> TrainConfig:
    names = (*_RUN, *_METHOD)
    given = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    for name, value in given.items():
        if isinstance(value, list):
            given[name] = tuple(step for step in value if step != -1)  # 3DGS: -1 is never
    if "without" in given:
        given["without"] = tuple(Skip(name) for name in args.without)
    if "strategy" in given:
        given["strategy"] = Strategy(given["strategy"])
    if "background" in given:
        given["background"] = Background(given["background"])
    if "depth_mode" in given:
        given["depth_mode"] = Switch(given["depth_mode"])
    return replace(config, **given)


def _train(args: argparse.Namespace, show: Show, control: Control) -> "TrainResult":
    data, config = told_configs(args, show)
    from ..trainer.run import train

    check_place(args.output, data)  # of / or the capture nobody wants to hear what is in it
    others = first_few(others_in_run(args.output))
    if others and not args.events:
        show(Warn(message=f"{args.output} holds other files too; they stay: {others}"))
    return train(
        config,
        data,
        args.output,
        show,
        control,
        resume=args.resume,
        overwrite=args.overwrite,
        start_checkpoint=args.start_checkpoint,
    )


def _summary(result: "TrainResult", config: TrainConfig) -> str:
    metrics = result.metrics
    if result.ended_before:
        return _nothing_to_do(result)
    how = _HOW.get(result.reason, f"Stopped ({result.reason})")
    if result.reason == FINISHED and config.time_budget:
        how = "The time was used up"
    lines = [
        f"{how} after {count_words(result.steps, 'step')}, {result.train_seconds:.1f} s of "
        f"training: {count_words(len(result.splats), 'splat')}."
    ]
    if worth := quality_words(metrics):
        view = "test view" if metrics["split"] == "test" else "training view"
        lines.append(f"{count_words(len(metrics['views']), view)}: {worth}")
    if config.target_psnr and result.reason in (FINISHED, CONVERGED):
        lines.append(f"The {config.target_psnr:g} dB asked for were not reached.")
    output = result.output
    lines.append(f"Results: {output / 'point_cloud.ply'}, {output / 'report.html'}")
    if result.reason not in ENDED:
        lines.append(f"To go on: gscore train -o {result.output} --resume")
    made = "orbit.mp4" if find_spec("av") else "pictures"
    lines.append(f"To look at it: gscore render {output} -o {output / made}")
    return "\n".join(lines)


def _nothing_to_do(result: "TrainResult") -> str:
    how = _HOW[result.reason]
    return (
        f"{result.output} was complete already: {how[0].lower()}{how[1:]} after "
        f"{count_words(result.steps, 'step')}. Give a larger --iterations or --time-budget to go "
        f"on, or measure it again with: gscore eval {result.output}"
    )


class _Refuse(argparse.Action):
    """An option of other programs that has no meaning here, with the reason."""

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
