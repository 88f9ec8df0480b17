"""`gscore train`: training with the option names of 3DGS, and its results."""

import argparse
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..config import LIFTED_BY, DataConfig, TrainConfig
from ..control import Control
from ..errors import ConfigError
from ..events import CONVERGED, ENDED, FINISHED, TARGET, Show, Warn
from ..io.output_paths import check_output_path
from ..io.runs import options_of_run, other_files_in_run
from ..presets import PRESETS
from ..quoting import as_typed, brief
from ..text_format import (
    colour_words,
    count_words,
    has_exposure_correction,
    quality_words,
    size_words,
)
from .args.data_options import add_data_options, with_data_options
from .args.option_names_3dgs import add_3dgs_names, translate
from .args.run_options import Set, declare, passed_options
from .args.unused_options import unused_options
from .args.viewer_options import add_live_options, check_live_options, viewer_clients_of
from .block_runs import train_blocks, wants_blocks
from .find_cameras import is_finding, with_cameras
from .terminal.output import check_folder, first_few, print_json
from .terminal.run_job import STOPPED, add_output_options, run_job
from .terminal.status import wrapped
from .terminal.torchrun_launch import under_torchrun
from .torchrun import agent, train_distributed

if TYPE_CHECKING:  # training imports torch, which takes seconds to load and would delay --help
    from ..trainer.distributed.process_group import ProcessGroup
    from ..trainer.files.run_result import TrainResult

_HOW = {
    FINISHED: "Finished",
    TARGET: "Reached the target PSNR",
    CONVERGED: "Converged (the PSNR no longer rose)",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `gscore train`."""
    parser.add_argument(
        "source",
        nargs="?",
        type=Path,
        help="capture: a folder of photos with a COLMAP model; or photos alone or a video, whose"
        " cameras are found first",
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
        help="quality level: sets --iterations, --max-splats, --sh-degree and photo width (normal)",
    )
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE.json",
        help="config.json of another run, whose options are used",
    )
    existing = parser.add_mutually_exclusive_group()
    existing.add_argument(
        "--resume",
        action="store_true",
        help="continue from the last checkpoint in the output folder",
    )
    existing.add_argument(
        "--overwrite",
        action="store_true",
        help="replace another run in the output folder; other files stay",
    )
    existing.add_argument(
        "--start-checkpoint", type=Path, metavar="FILE", help="continue from this checkpoint"
    )
    parser.add_argument(
        "--block",
        type=int,
        metavar="N",
        help="train only this block of a folder made by gscore split; default: all in turn",
    )
    parser.add_argument(
        "--no-sfm",
        action="store_true",
        help="fail on photos without cameras instead of finding the cameras first",
    )
    add_data_options(parser)
    declare(parser.add_argument_group("depth maps"), DataConfig, names=("depths", "depth_align"))
    group = parser.add_argument_group(
        "run",
        "The most important options. `gscore options` lists all with their ranges; set the others "
        "with --set NAME=VALUE, their long flags, or their 3DGS names.",
    )
    declare(group, DataConfig, names=("eval",))
    declare(group, TrainConfig)
    add_live_options(group)
    group.add_argument(
        "--set", action=Set, metavar="NAME=VALUE", help="set an option by name; repeatable"
    )
    add_output_options(parser)
    add_3dgs_names(parser)


def run(args: argparse.Namespace) -> int:
    """Train and print a summary; returns the exit code."""
    if wants_blocks(args):
        return train_blocks(args, _run)
    return train_distributed(args, _run) if under_torchrun() else _run(args, None)


def _run(args: argparse.Namespace, team: "ProcessGroup | None") -> int:
    result, code = run_job(
        args,
        lambda show, control: _train(args, show, control, team),
        stopped=lambda: _stopped(args),
    )
    if result is None:
        return code
    if args.json:
        numbers = result.headline | {"reason": result.reason, "output": str(args.output)}
        print_json(numbers)
    elif not (args.quiet or args.events):
        print(wrapped(_summary(result, configs(args)[1]), sys.stdout))
    return code


def configs(args: argparse.Namespace) -> tuple[DataConfig, TrainConfig]:
    """The options of a preset, a config file or the resumed run, overridden by the given ones."""
    source = args.source or args.source_option
    if args.source and args.source_option and args.source != args.source_option:
        raise ConfigError(
            f"Two captures were given: {brief(args.source)} and {brief(args.source_option)}."
        )
    if args.config and args.preset:
        raise ConfigError(
            "Give either `--preset` or `--config`: a config file contains all options."
        )
    stored = args.config
    if args.resume and not (args.config or (args.preset and source)):
        stored = args.output / "config.json"
        if not stored.is_file():
            from ..trainer.files.run_folder import check_free

            check_free(args.output)  # a run that has just begun has written nothing yet
            raise ConfigError(f"{args.output} contains no run to resume; leave out `--resume`.")
    if args.preset and stored:
        source = options_of_run(stored)[0].source
        data, config = PRESETS[args.preset](source)
    elif stored:
        data, config = options_of_run(stored)
        data = replace(data, source=source or data.source)
    elif source is None:
        raise ConfigError("No capture was given: `gscore train SOURCE -o OUTPUT`.")
    else:
        data, config = PRESETS[args.preset or "normal"](source)
    translate(args)
    data = with_data_options(data, args)
    config = replace(config, **_given(args))
    if args.iterations is not None and config.time_budget > 0:
        raise ConfigError(
            f"A time budget ({config.time_budget:g} s) determines the number of steps; leave out "
            "`--iterations`, or give `--time-budget 0`."
        )
    return data, config


def _given(args: argparse.Namespace) -> dict[str, Any]:
    """The given options; an explicit number lifts its limit by the photos."""
    given = passed_options(TrainConfig, args)
    return {LIFTED_BY[name]: 0 for name in LIFTED_BY.keys() & given.keys()} | given


def configs_with_messages(args: argparse.Namespace, show: Show) -> tuple[DataConfig, TrainConfig]:
    """As `configs`, with a warning about options without effect in this run."""
    given = argparse.Namespace(**vars(args))  # `configs` sets some
    data, config = configs(args)
    if idle := unused_options(given, data, config):
        show(Warn(message=idle, code="no_effect"))
    return data, config


def _train(
    args: argparse.Namespace, show: Show, control: Control, team: "ProcessGroup | None"
) -> "TrainResult":
    data, config = configs_with_messages(args, show)
    from ..trainer.files.run_folder import check_writable
    from ..trainer.run import train

    check_output_path(args.output, data)  # before listing files: not those of / or the capture
    check_folder(args.output)
    check_writable(args.output, resume=args.resume, overwrite=args.overwrite)
    others = first_few(other_files_in_run(args.output))
    if others and not args.events:
        show(Warn(message=f"{args.output} contains other files, which are kept: {others}"))
    data = with_cameras(
        data,
        args.output,
        show,
        control,
        # Not on a single rank of several: the others need the cameras too.
        allowed=not (args.no_sfm or team),
        check=lambda names: _check_given(args, config, data, names),
        threads=config.threads,
    )
    with viewer_clients_of(args, data.source, show, after_the_end=True) as viewers:
        return train(
            config,
            data,
            args.output,
            show,
            control,
            resume=args.resume,
            overwrite=args.overwrite,
            start_checkpoint=args.start_checkpoint,
            viewers=viewers,
            team=team,
            agent=agent(),
        )


def _check_given(
    args: argparse.Namespace, config: TrainConfig, data: DataConfig, names: list[str] | None
) -> None:
    """Check the arguments before the cameras of photos are found."""
    from ..trainer.files.option_files import check_option_files

    check_live_options(args)
    check_option_files(config, data, names=names, start_checkpoint=args.start_checkpoint)


def _stopped(args: argparse.Namespace) -> str:
    if is_finding(args.output):
        return "Stopped while finding cameras; the same command continues from here."
    return STOPPED


def _summary(result: "TrainResult", config: TrainConfig) -> str:
    metrics = result.metrics
    if result.ended_before:
        return _nothing_to_do(result)
    how = _HOW.get(result.reason, f"Stopped ({result.reason})")
    if result.reason == FINISHED and config.time_budget:
        how = "Used the time budget"
    lines = [
        f"{how} after {count_words(result.steps, 'step')}, {result.train_seconds:.1f} s of "
        f"training: {count_words(len(result.splats), 'splat')}."
    ]
    if worth := quality_words(metrics):
        view = "test view" if metrics["split"] == "test" else "training view"
        worth += colour_words(metrics) if has_exposure_correction(metrics) else ""
        lines.append(f"{count_words(len(metrics['views']), view)}: {worth}")
    if config.target_psnr and result.reason in (FINISHED, CONVERGED):
        lines.append(f"The target of {config.target_psnr:g} dB was not reached.")
    if ranks := metrics.get("ranks"):
        sent, waited = ranks["sent_bytes_per_batch"], ranks["waited_seconds_per_batch"]
        lines.append(
            f"{ranks['count']} ranks: each batch sent {size_words(max(sent))} between ranks, and "
            f"took {min(waited):.3f} to {max(waited):.3f} s of waiting and sending."
        )
    output = result.output
    lines.append(f"Results: {output / 'point_cloud.ply'}, {output / 'report.html'}")
    if result.reason not in ENDED:
        lines.append(f"To continue: {as_typed('train', '-o', output, '--resume')}")
    made = "orbit.mp4" if find_spec("av") else "pictures"
    lines.append(f"To render it: {as_typed('render', output, '-o', output / made)}")
    return "\n".join(lines)


def _nothing_to_do(result: "TrainResult") -> str:
    how = _HOW[result.reason]
    return (
        f"{result.output} was complete already: {how[0].lower()}{how[1:]} after "
        f"{count_words(result.steps, 'step')}. Give a larger `--iterations` or `--time-budget` to "
        f"continue, or measure it again with: {as_typed('eval', result.output)}"
    )
