"""`gscore frames`: sharp frames of a video, written as photos."""

import argparse
import sys
from pathlib import Path

from ..errors import DatasetError
from ..io.output_paths import check_output_path
from ..video import ExtractRequest, extract_frames
from ..video.request import FRAME_FORMATS
from .terminal.output import check_folder, print_json
from .terminal.run_job import OutputOptions, add_output_options, run_job
from .terminal.status import wrapped


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    parser.add_argument("video", type=Path, help="video in any format of FFmpeg")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="FOLDER",
        help="new or empty folder for the frames",
    )
    parser.add_argument(
        "--frames",
        type=int,
        default=0,
        metavar="N",
        help="maximum number of frames; default: one per 5 %% of image motion, 30 to 300",
    )
    parser.add_argument(
        "--format",
        choices=FRAME_FORMATS,
        default="jpg",
        help="jpg, quality 97 without chroma subsampling, or png (jpg)",
    )
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help="replace frames that gscore wrote from another video or with other options",
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
    frames, code = run_job(
        OutputOptions.of(args),
        lambda show, control: extract_frames(
            request, on_event=show, control=control, overwrite=args.overwrite
        ),
        stopped=lambda: "Stopped; nothing was written.",
    )
    if frames is None:
        return code
    if args.json:
        print_json(frames.facts())
    elif not (args.events or args.quiet):
        print(wrapped("\n".join(frames.lines()), sys.stdout))
    return code
