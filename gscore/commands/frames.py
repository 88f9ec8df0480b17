"""`gscore frames`: sharp frames of a video, written as photos."""

import argparse
from functools import partial
from pathlib import Path

from ..errors import DatasetError
from ..io.output_paths import check_output_path
from ..video import ExtractRequest, extract_frames
from ..video.extract import Frames
from ..video.request import FRAME_FORMATS
from .parser import add_option
from .terminal.output import check_folder
from .terminal.run_job import OutputOptions, add_output_options, run_verb


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    option = partial(add_option, parser)
    option("video", "video in any format of FFmpeg", Path)
    option("-o, --output FOLDER", "new or empty folder for the frames", Path, required=True)
    option(
        "--frames N",
        "maximum number of frames; default: one per 5 %% of image motion, 30 to 300",
        int,
        default=0,
    )
    option(
        "--format",
        "jpg, quality 97 without chroma subsampling, or png (jpg)",
        choices=FRAME_FORMATS,
        default="jpg",
    )
    option(
        "--overwrite", "replace frames that gscore wrote from another video or with other options"
    )
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Choose and write the frames, and print a summary."""
    if args.video.is_dir():
        raise DatasetError(
            f"{args.video} is a folder; gscore frames reads a video. If it contains photos, use "
            "gscore train."
        )
    request = ExtractRequest(
        video=args.video, output=args.output, frames=args.frames, format=args.format
    )
    check_output_path(request.output)
    check_folder(request.output)
    return run_verb(
        OutputOptions.of(args),
        lambda show, control: extract_frames(
            request, on_event=show, control=control, overwrite=args.overwrite
        ),
        facts=Frames.facts,
        lines=Frames.lines,
        stopped=lambda: "Stopped; nothing was written.",
    )
