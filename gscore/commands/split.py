"""`gscore split`: blocks of a large capture, trained in turn or on several machines."""

import argparse
import sys
from functools import partial
from pathlib import Path

from ..blocks.block_cells import MARGIN, SHARE
from ..blocks.split_capture import Cut, check_empty, cut_capture, write_blocks
from ..config import DataConfig
from ..io.output_paths import check_output_path
from ..quoting import as_typed
from ..text_format import count_text, number
from .args.data_options import add_split_options, with_data_options
from .args.run_options import declare
from .parser import add_option, add_result_options
from .terminal.output import check_folder, print_result
from .terminal.status import Counted, Status, print_warnings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    option = partial(add_option, parser)
    option("source", "capture: a folder of photos with cameras", Path)
    option("-o, --output BLOCKS", "new folder for the blocks", Path, required=True)
    option("--blocks N", "number of blocks", int, required=True)
    option(
        "--margin SHARE",
        f"margin around the cell of a block when its photos are selected, as a share of its "
        f"extent ({MARGIN:g})",
        float,
        default=MARGIN,
    )
    option(
        "--share SHARE",
        f"minimum share of a photo inside the block ({SHARE:g}); higher: fewer photos, less "
        "work, lower quality",
        float,
        default=SHARE,
    )
    group = parser.add_argument_group("capture")
    declare(group, DataConfig, names=("images", "masks"))
    add_split_options(group)
    add_result_options(parser)


def run(args: argparse.Namespace) -> int:
    """Split the capture, link photos, print each block and its training command."""
    data = with_data_options(DataConfig(source=args.source, eval=True), args)
    check_output_path(args.output, data)
    check_folder(args.output)
    check_empty(args.output)
    with Status(sys.stderr, quiet=args.quiet) as status:
        status.show(["Reading the capture"])
        cut = cut_capture(data, args.blocks, margin=args.margin, share=args.share)
        counted = Counted(status, sum(len(block.views) for block in cut.blocks), "photo")
        write_blocks(cut, args.output, counted)
    if not args.json:
        print_warnings(cut.warnings)
    print_result(_facts(cut, args), _lines(cut, args.output), json=args.json, quiet=args.quiet)
    return 0


def _facts(cut: Cut, args: argparse.Namespace) -> dict:
    return {
        "output": str(args.output),
        "photos": len(cut.views),
        "points": len(cut.model.points),
        "blocks": [
            {
                "photos": len(block.views),
                "test_photos": len(block.record.test_names),
                "points": len(block.rows),
                "own_points": block.own_points,
            }
            for block in cut.blocks
        ],
        "warnings": list(cut.warnings),
    }


def _lines(cut: Cut, output: Path) -> list[str]:
    lines = [
        f"{count_text(len(cut.views), 'photo')} and "
        f"{count_text(len(cut.model.points), 'point')} in "
        f"{count_text(len(cut.blocks), 'block')}:"
    ]
    for block in cut.blocks:
        lines.append(
            f"  block_{block.record.index}: {count_text(len(block.views), 'photo')}, "
            f"{count_text(len(block.rows), 'point')}, {number(block.own_points)} in its own cell"
        )
    whole = len(cut.views)
    if min(len(block.views) for block in cut.blocks) > 0.9 * whole:
        lines.append(
            "Nearly every photo shows every block, so blocks save splats but no photos: this "
            "capture goes around one subject. A higher `--share` leaves out more photos."
        )
    lines.append(
        f"Next: {as_typed('train', output, '-o', 'RUNS')}, or on many machines with "
        "`--block` 0, 1, ...;"
    )
    lines.append("then: gscore merge RUNS -o merged.ply")
    return lines
