"""`gscore sequence`: the frames of a multi-view video, each from the splats of the one before."""

import argparse
import sys
from dataclasses import replace
from typing import TYPE_CHECKING

from ..control import Control
from ..errors import ConfigError
from ..events import Show, Warn
from ..io.places import check_place
from ..io.sequences import SEQUENCE_FILE
from ..sequence_options import SequenceOptions
from ..words import count_words, quality_words
from . import train as train_command
from .attend import attend
from .declared import declare, given_options
from .live import onlookers_of
from .output import check_folder, others_in, print_json
from .status import wrapped

if TYPE_CHECKING:
    from ..trainer.sequence import SequenceResult

_ONE_FRAME = {
    "frame": ("--frame", "choose frames with --frames"),
    "rig": ("--rig", "the cameras of the first frame are taken for all, unless --no-fixed-rig"),
    "start_checkpoint": ("--start-checkpoint", "go on with --resume, or use --start-splats"),
}
"""Options of `gscore train` that concern one frame only."""
_SELDOM = ("port",)
"""Those that matter less here than what a sequence has besides; `gscore options` lists them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `gscore train`, and those of the sequence."""
    train_command.add_arguments(parser)
    for action in parser._actions:
        if action.dest in _ONE_FRAME or action.dest in _SELDOM:
            action.help = argparse.SUPPRESS
    group = parser.add_argument_group(
        "sequence",
        "SOURCE is a folder of PKU-DyMVHumans, a folder of numbered captures, or a path with "
        "{frame:06d} where the number stands; --images and --masks may hold that too. Each frame "
        "gets a folder OUT/frame_NNNNNN with the results of a training.",
    )
    declare(group, SequenceOptions)


def run(args: argparse.Namespace) -> int:
    """Train all frames and say how it went; returns the exit code."""
    result, code = attend(args, lambda show, control: _train(args, show, control))
    if result is None:
        return code
    if args.json:
        facts = result.headline | {"reason": result.reason, "output": str(args.output)}
        facts["per_frame"] = [frame.to_dict(result.output) for frame in result.frames]
        print_json(facts)
    elif not (args.quiet or args.events):
        print(wrapped(_summary(result), sys.stdout))
    return code


def _train(args: argparse.Namespace, show: Show, control: Control) -> "SequenceResult":
    for name, (option, instead) in _ONE_FRAME.items():
        if getattr(args, name) is not None:
            raise ConfigError(f"{option} is for one frame: {instead}.")
    from ..trainer.sequence import read_options, train_sequence

    check_place(args.output)
    check_folder(args.output)
    frames = [path.name for path in args.output.glob("frame_*") if path.is_dir()]
    others = others_in(args.output, (SEQUENCE_FILE, "config.json", *frames))
    if others and not args.events:
        show(Warn(message=f"{args.output} holds other files too; they stay: {others}"))
    stored = read_options(args.output) if args.resume else None
    given = given_options(SequenceOptions, args)
    data, config = train_command.told_configs(args, show)
    with onlookers_of(args, data.source, show) as onlookers:
        return train_sequence(
            config,
            data,
            args.output,
            show,
            control,
            options=replace(stored or SequenceOptions(), **given),
            resume=args.resume,
            overwrite=args.overwrite,
            onlookers=onlookers,
        )


def _summary(result: "SequenceResult") -> str:
    numbers = result.headline
    how = "Finished" if result.reason == "finished" else f"Stopped ({result.reason})"
    lines = [
        f"{how}: {len(result.frames)} of {count_words(result.total, 'frame')}, "
        f"{numbers['train_seconds']:.1f} s of training."
    ]
    if worth := quality_words(numbers):
        split = result.frames[0].metrics["split"]
        lines.append(f"{split.capitalize()} views, mean of the frames: {worth}.")
    output = result.output
    lines.append(f"Results: {output / SEQUENCE_FILE}, {output / 'frame_*' / 'point_cloud.ply'}")
    if result.reason != "finished":
        lines.append(f"To go on: gscore sequence -o {result.output} --resume")
    return "\n".join(lines)
