"""`gscore train`: training with the option names of 3DGS, and its results."""

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from ..config import DataConfig, TrainConfig
from ..control import Control
from ..errors import ConfigError, DatasetError
from ..events import CONVERGED, ENDED, FINISHED, TARGET, Show, Warn
from ..io.output_paths import check_output_path
from ..io.runs import CAPTURE, other_files_in_run
from ..io.unsupported_formats import describe_unsupported
from ..presets import RECIPES
from ..quoting import as_typed, first_few
from ..sfm import SearchRequest, find_cameras
from ..sfm.output_path import has_no_cameras
from ..sfm.photos import check_no_cameras_above, photos_of, same_photos
from ..sfm.staging import frames_request, is_staged, of_frames, photos_from, stage_photos
from ..text_format import (
    colour_text,
    count_text,
    has_exposure_correction,
    quality_text,
    size_text,
    trust_text,
    verdict_text,
    views_text,
    worst_view_text,
)
from ..video import extract_frames, is_video
from .args.data_options import add_data_options
from .args.option_names_3dgs import add_3dgs_names
from .args.run_options import Set, declare
from .args.train_request import TrainRequest
from .args.viewer_options import add_live_options, check_live_options, viewer_clients_of
from .block_runs import train_blocks, wants_blocks
from .parser import add_option
from .terminal.output import check_folder
from .terminal.run_job import STOPPED, add_output_options, run_verb
from .torchrun import agent, train_distributed

if TYPE_CHECKING:  # training imports torch, which takes seconds to load and would delay --help
    from ..trainer.distributed.process_group import ProcessGroup
    from ..trainer.files.run_result import TrainResult

_FOUND = ("source", "images", "masks", "invert_masks")
"""Options that change where the cameras were found first."""
_HOW = {
    FINISHED: "Finished",
    TARGET: "Reached the target PSNR",
    CONVERGED: "Converged (the PSNR no longer rose)",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `gscore train`."""
    option = partial(add_option, parser)
    option(
        "source?",
        "capture: a folder of photos with a COLMAP model; or photos alone or a video, whose"
        " cameras are found first",
        Path,
        unless=("source_option", "resume", "config"),
    )
    option(
        "-s, --source, --source-path SOURCE_OPTION", argparse.SUPPRESS, Path, dest="source_option"
    )
    option("-o, -m, --output, --model-path OUTPUT", "folder for results", Path, required=True)
    option(
        "--preset",
        "level (normal) of steps, splats, --sh-degree and photo width; 3dgs: the published recipe",
        choices=tuple(RECIPES),
    )
    option("--config FILE.json", "config.json of another run, whose options are used", Path)
    which = partial(add_option, parser.add_mutually_exclusive_group())
    which("--resume", "continue from the last checkpoint in the output folder")
    which("--overwrite", "replace another run in the output folder; other files stay")
    which("--start-checkpoint FILE", "continue from this checkpoint", Path)
    option(
        "--block N",
        "train only this block of a folder made by gscore split; default: all in turn",
        int,
    )
    option("--no-sfm", "fail on photos without cameras instead of finding the cameras first")
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
    add_option(group, "--set NAME=VALUE", "set an option by name; repeatable", action=Set)
    add_output_options(parser)
    add_3dgs_names(parser)


def run(args: argparse.Namespace) -> int:
    """Train and print a summary; returns the exit code."""
    request = TrainRequest.of(args)
    if wants_blocks(request):
        return train_blocks(request, _run)
    return train_distributed(request, _run)


def _run(request: TrainRequest, group: "ProcessGroup | None") -> int:
    return run_verb(
        request.shown,
        lambda show, control: _train(request, show, control, group),
        facts=lambda done: (
            done[0].headline | {"reason": done[0].reason, "output": str(request.output)}
        ),
        lines=lambda done: _summary(*done),
        stopped=lambda: _stopped(request.output),
    )


def _train(
    request: TrainRequest, show: Show, control: Control, group: "ProcessGroup | None"
) -> tuple["TrainResult", TrainConfig]:
    data, config = request.configs_with_messages(show)
    on_card = request.configs(card=True)
    from ..trainer.files.run_folder import check_option_files, check_writable
    from ..trainer.run import train

    def check(names: list[str] | None) -> None:
        check_live_options(request.live)
        check_option_files(config, data, names=names, start_checkpoint=request.start_checkpoint)

    output = request.output
    check_output_path(output, data)  # before listing files: not those of / or the capture
    check_folder(output)
    check_writable(output, resume=request.resume, overwrite=request.overwrite)
    others = first_few(other_files_in_run(output))
    if others and not request.shown.events:
        show(Warn(message=f"{output} contains other files, which are kept: {others}"))
    data = with_cameras(
        data,
        output,
        show,
        control,
        # Not on a single rank of several: the others need the cameras too.
        allowed=request.finds_cameras and not group,
        check=check,
        threads=config.threads,
    )
    on_card = replace(on_card[0], **{name: getattr(data, name) for name in _FOUND}), on_card[1]
    with viewer_clients_of(request.live, data.source, show, after_the_end=True) as viewers:
        result = train(
            config,
            data,
            output,
            show,
            control,
            resume=request.resume,
            overwrite=request.overwrite,
            start_checkpoint=request.start_checkpoint,
            viewers=viewers,
            group=group,
            agent=agent(),
            on_card=on_card,
        )
    return result, config


def _stopped(output: Path) -> str:
    if is_finding(output):
        return "Stopped while finding cameras; the same command continues from here."
    return STOPPED


def _summary(result: "TrainResult", config: TrainConfig) -> list[str]:
    metrics = result.metrics
    if result.ended_before:
        return [_nothing_to_do(result)]
    how = _HOW.get(result.reason, f"Stopped ({result.reason})")
    if result.reason == FINISHED and config.time_budget:
        how = "Used the time budget"
    lines = [
        f"{how} after {count_text(result.steps, 'step')}, {result.train_seconds:.1f} s of "
        f"training: {count_text(len(result.splats), 'splat')}."
    ]
    if worth := quality_text(metrics):
        worth += colour_text(metrics) if has_exposure_correction(metrics) else ""
        lines.append(f"{views_text(metrics)}: {worth}")
    lines += filter(None, (f(metrics) for f in (verdict_text, worst_view_text, trust_text)))
    if config.target_psnr and result.reason in (FINISHED, CONVERGED):
        lines.append(f"The target of {config.target_psnr:g} dB was not reached.")
    if ranks := metrics.get("ranks"):
        sent, waited = ranks["sent_bytes_per_batch"], ranks["waited_seconds_per_batch"]
        lines.append(
            f"{ranks['count']} ranks: each batch sent {size_text(max(sent))} between ranks, and "
            f"took {min(waited):.3f} to {max(waited):.3f} s of waiting and sending."
        )
    output = result.output
    lines.append(f"Results: {output / 'point_cloud.ply'}, {output / 'report.html'}")
    if result.reason not in ENDED:
        lines.append(f"To continue: {as_typed('train', '-o', output, '--resume')}")
    made = "orbit.mp4" if find_spec("av") else "pictures"
    lines.append(f"To render it: {as_typed('render', output, '-o', output / made)}")
    return lines


def _nothing_to_do(result: "TrainResult") -> str:
    how = _HOW[result.reason]
    return (
        f"{result.output} was complete already: {how[0].lower()}{how[1:]} after "
        f"{count_text(result.steps, 'step')}. Give a larger `--iterations` or `--time-budget` to "
        f"continue, or measure it again with: {as_typed('eval', result.output)}"
    )


def with_cameras(
    data: DataConfig,
    output: Path,
    show: Show,
    control: Control,
    *,
    allowed: bool,
    check: Callable[[list[str] | None], None],
    threads: int,
) -> DataConfig:
    """The data options as given, or for the capture found by SfM from photos or a video.

    Args:
        data: Its source may be a folder of photos without cameras, or a video.
        output: Folder of the training, for the capture; a capture of the same photos in it is
            reused.
        show: Receives progress events.
        control: Polled for stop requests.
        allowed: Whether SfM may run.
        check: Called before SfM, which takes long, with the names of the photos, or None if they
            do not exist yet; raises if the training is impossible.
        threads: CPU threads; 0: all cores.

    Raises:
        Cancelled: `control` requested a stop; the same call continues from there.
        DatasetError: not `allowed`, no cameras can be found, or the parent folder contains them.
        ConfigError: the folder contains a capture of other photos.
        BackendError: pycolmap is missing or too old, or PyAV is missing.
        GsError: the video cannot be read, or the output cannot be written.
    """
    if not has_no_cameras(data.source):
        return data
    check_no_cameras_above(data.source)
    if not allowed:
        raise DatasetError(
            f"Leave out `--no-sfm` to find the cameras. {describe_unsupported(data.source)}"
        )
    capture = output / CAPTURE
    # Masks are written in the training's default form, white where pixels count.
    found = replace(data, source=capture, images="images", masks="", invert_masks=False)
    request = SearchRequest(
        photos=data.source,
        output=capture,
        masks=Path(data.masks) if data.masks else None,
        use_masks=data.mask_mode != "none",
        invert_masks=data.invert_masks,
        threads=threads,
        excluded=output,
    )
    if not (capture / "sparse").exists():
        whole = not (is_video(data.source) or is_staged(request, [data.source]))
        check([name for name, *_ in photos_of(request)] if whole else None)
        with photos_from(request, [data.source], on_event=show, control=control) as photos:
            find_cameras(photos, on_event=show, control=control)
        return found
    if is_video(data.source):
        extract_frames(frames_request(request), on_event=show, control=control)  # reuses frames
        request = of_frames(request)
    elif is_staged(request, [data.source]):
        request = stage_photos(request, [data.source], on_event=show, control=control)  # reuses
    if not same_photos(capture, photos_of(request)):
        raise ConfigError(
            f"{capture} contains the cameras of other photos than those in {data.source}. Choose "
            "another output folder, or remove that one to find the cameras again."
        )
    return found


def is_finding(output: Path) -> bool:
    """Whether the folder of a training contains an unfinished SfM."""
    return (output / f".{CAPTURE}.sfm").is_dir()
