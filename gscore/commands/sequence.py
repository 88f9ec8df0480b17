"""`gscore sequence`: training of a multi-view video, each frame from the previous splats."""

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..control import Control
from ..errors import ConfigError
from ..events import Show, Warn
from ..io.output_paths import check_output_path
from ..io.sequences import SEQUENCE_FILE
from ..option_marks import mark_option
from ..quoting import as_typed
from ..sequence_options import SequenceOptions
from ..text_format import count_text, quality_text
from . import train as train_command
from .args.run_options import declare, passed_options
from .args.train_request import TrainRequest
from .args.viewer_options import viewer_clients_of
from .terminal.output import check_folder, other_files
from .terminal.run_job import run_verb
from .torchrun import agent, train_in_turn

if TYPE_CHECKING:
    from ..trainer.distributed.process_group import ProcessGroup
    from ..trainer.sequence import SequenceResult

_ONE_FRAME = {
    "block": "the frames of a sequence are not cut into blocks",
    "rig": "all frames use the cameras of the first, unless `--no-fixed-rig`",
    "start_checkpoint": "continue with `--resume`, or use `--start-splats`",
}
"""Options of `gscore train` that do not apply to a sequence, and what to do instead."""
_SELDOM = ("port", "no_sfm")
"""Options hidden here to keep the help short; `gscore options` lists them."""
_FRAME = "train only the keyframe interval of this frame, for job arrays; all share one output"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `gscore train`, and those of the sequence."""
    train_command.add_arguments(parser)
    for action in parser._actions:
        if action.dest in _ONE_FRAME or action.dest in _SELDOM:
            action.help = argparse.SUPPRESS
        if action.dest == "frame":
            action.help = _FRAME
    group = parser.add_argument_group(
        "sequence",
        "SOURCE is a folder of PKU-DyMVHumans, a folder of numbered captures, or a path with "
        "{frame:06d} for the frame number, also in --images and --masks. Each frame is trained "
        "into a folder OUT/frame_NNNNNN.",
    )
    declare(group, SequenceOptions)


def run(args: argparse.Namespace) -> int:
    """Train all frames and print a summary; returns the exit code."""
    request = TrainRequest.of(args)
    options = passed_options(SequenceOptions, args)

    def work(request: TrainRequest, group: "ProcessGroup | None") -> int:
        return _run(request, options, group)

    return train_in_turn(request, work)


def _run(request: TrainRequest, given: dict[str, Any], group: "ProcessGroup | None") -> int:
    return run_verb(
        request.shown,
        lambda show, control: _train(request, given, show, control, group),
        facts=_facts,
        lines=_summary,
    )


def _train(
    request: TrainRequest,
    given: dict[str, Any],
    show: Show,
    control: Control,
    group: "ProcessGroup | None",
) -> "SequenceResult":
    from ..trainer.distributed.consistency import all_ready
    from ..trainer.sequence import read_options, train_sequence

    frame = request.data.get("frame")
    with all_ready(group):
        _check(request, show, group)
        stored = read_options(request.output) if request.resume else None
        options = replace(stored or SequenceOptions(), **given)
        # Without `frame`, which would also be an option of each frame.
        data, config = request.without("frame").configs_with_messages(show)
    with viewer_clients_of(request.live, data.source, show) as viewers:
        return train_sequence(
            config,
            data,
            request.output,
            show,
            control,
            options=options,
            resume=request.resume,
            overwrite=request.overwrite,
            viewers=viewers,
            frame=frame,
            group=group,
            agent=agent(),
        )


def _check(request: TrainRequest, show: Show, group: "ProcessGroup | None") -> None:
    """Check the request as far as possible before any photo is read."""
    for name, instead in _ONE_FRAME.items():
        if name in request.given:
            raise ConfigError(f"{mark_option(name)} is for a single training: {instead}.")
    if group and "frame" in request.data:
        raise ConfigError("`--frame` is for one process; torchrun distributes all frames.")
    output = request.output
    check_output_path(output)
    check_folder(output)
    frames = [path.name for path in output.glob("frame_*") if path.is_dir()]
    others = other_files(output, (SEQUENCE_FILE, "config.json", *frames))
    if others and not request.shown.events:
        show(Warn(message=f"{output} contains other files, which are kept: {others}"))


def _facts(result: "SequenceResult") -> dict[str, Any]:
    facts = result.headline | {"reason": result.reason, "output": str(result.output)}
    return facts | {"per_frame": [frame.to_dict(result.output) for frame in result.frames]}


def _summary(result: "SequenceResult") -> list[str]:
    numbers = result.headline
    how = "Finished" if result.reason == "finished" else f"Stopped ({result.reason})"
    lines = [
        f"{how}: {len(result.frames)} of {count_text(result.total, 'frame')}, "
        f"{numbers['train_seconds']:.1f} s of training."
    ]
    if worth := quality_text(numbers):
        split = result.frames[0].metrics["split"]
        lines.append(f"{split.capitalize()} views, mean of the frames: {worth}.")
    output = result.output
    lines.append(f"Results: {output / SEQUENCE_FILE}, {output / 'frame_*' / 'point_cloud.ply'}")
    if result.reason != "finished":
        lines.append(f"To continue: {as_typed('sequence', '-o', result.output, '--resume')}")
    return lines
