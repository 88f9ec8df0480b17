"""`gscore sfm`: structure from motion of photos or a video, written as a capture."""

import argparse
from functools import partial
from pathlib import Path

from ..control import Control
from ..errors import ConfigError
from ..io.output_paths import check_output_path
from ..quoting import brief
from ..sfm import SearchRequest, SearchResult, find_cameras
from ..sfm.search_request import MAPPERS, MATCHERS
from ..sfm.staging import photos_from
from ..video import is_video
from .parser import add_option, add_threads_option
from .terminal.output import check_folder
from .terminal.run_job import OutputOptions, Show, add_output_options, run_verb


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    option = partial(add_option, parser)
    option(
        "source...",
        "folder of photos, with sub-folders; or videos, whose sharp frames are written to "
        "CAPTURE/images",
        Path,
    )
    option(
        "-o, --output CAPTURE",
        "capture: a new folder with links to the photos, or the parent of the photo folder "
        "`images`",
        Path,
        required=True,
    )
    option(
        "--matching",
        "pairs to match: all, or neighbours by name; auto: all up to 120 photos, else by "
        "content too (auto)",
        choices=MATCHERS,
        default="auto",
    )
    option(
        "--mapper",
        "poses all together, or photo by photo; auto: global, incremental if many photos get "
        "none (auto)",
        choices=MAPPERS,
        default="auto",
    )
    option(
        "--camera-model NAME",
        "lens model by COLMAP's name, such as OPENCV or OPENCV_FISHEYE (SIMPLE_RADIAL)",
        default="SIMPLE_RADIAL",
    )
    option(
        "--focal-length PX",
        "known focal length in pixels of the photos; refined where the matches determine it"
        " (from EXIF)",
        default=0.0,
    )
    option("--frames N", "maximum number of frames of a video (by motion, 30 to 300)", default=0)
    group = parser.add_argument_group("masks", "Masked pixels give no features.")
    option = partial(add_option, group)
    option("--masks DIR", "folder of masks (masks, if it exists)", Path)
    option("--no-masks", "use whole photos, without masks")
    option("--invert-masks", "masks are white where pixels are ignored")
    add_threads_option(parser)
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Find the cameras, write the capture, print its quality."""
    request = SearchRequest(
        photos=args.source[0],
        output=args.output,
        masks=args.masks,
        use_masks=not args.no_masks,
        invert_masks=args.invert_masks,
        matching=args.matching,
        mapper=args.mapper,
        camera_model=args.camera_model.upper(),
        focal_length=args.focal_length,
        threads=args.threads,
    )
    if args.frames and not any(map(is_video, args.source)):
        names = " and ".join(map(brief, args.source))
        raise ConfigError(f"`--frames` is for videos; {names} is not a video.")
    check_output_path(request.output)
    check_folder(request.output)
    return run_verb(
        OutputOptions.of(args),
        lambda show, control: _find(request, args, show, control),
        facts=SearchResult.facts,
        lines=SearchResult.lines,
        stopped=lambda: "Stopped; the same command continues from here.",
    )


def _find(
    request: SearchRequest, args: argparse.Namespace, show: Show, control: Control
) -> SearchResult:
    with photos_from(
        request, args.source, frames=args.frames, on_event=show, control=control
    ) as photos:
        return find_cameras(photos, on_event=show, control=control)
