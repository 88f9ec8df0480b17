"""The options of `gscore convert`."""

import argparse
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

from ...edit.request import GAP, USUAL
from ...formats import FORMATS
from ...quoting import quoted
from ...scene import FARTHEST
from ...sh import MAX_DEGREE
from ..parser import add_option, add_result_options, add_threads_option

SPZ_VERSION = 3
"""Default version of .spz files."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb, in the order of the steps."""
    option = partial(add_option, parser)
    endings = [ending for one in FORMATS if one.write for ending in one.endings]
    parser.description = (
        f"{parser.description or ''} Steps run in the order of this list, regardless of the order "
        f"of the options. Endings of OUT: {', '.join(endings)}."
    ).strip()
    option("input IN", "splat file, or the folder of a run", Path)
    option("output OUT", "output file; its ending selects the format", Path)
    option(
        "--spz-version",
        "version of SPZ: 3, for all readers, or 4, with zstd (3)",
        choices=(3, 4),
        default=SPZ_VERSION,
    )
    option(
        "--proxy MESH", "mesh to write along, hidden, into glTF and USD, as of gscore mesh", Path
    )
    add_threads_option(parser)
    add_result_options(parser, replaced="files")
    _add_join_and_crop(parser)
    _add_clean(parser)
    _add_fewer_and_place(parser)
    option = partial(add_option, parser.add_argument_group("cameras, for contributions and losses"))
    option(
        "-s, --source SOURCE",
        "a capture, the folder of a run or a cameras.json; default: the run's",
        Path,
    )
    option("--views N", "maximum number of views that measure the loss (60)", _count)
    option("--picture FILE.png", "picture of one view, before and after side by side", Path)
    option("--picture-view NAME", "view of the picture, by name or number; default: the middle one")


def _add_join_and_crop(parser: argparse.ArgumentParser) -> None:
    option = partial(add_option, parser.add_argument_group("1. merge"))
    option("--merge FILE...", "further splat files in the same world", Path, default=[])
    option("--level N", "level to write of a file of levels of detail; 0: the finest (0)", int)
    option = partial(
        add_option, parser.add_argument_group("2. crop: keep splats inside all of these")
    )
    option("--box X0 Y0 Z0 X1 Y1 Z1", "box between two corners", _finite)
    option("--sphere X Y Z R", "centre and radius", _finite)
    option("--frustum VIEW...", "splats visible in any of these views, by name or number")
    option("--outside", "keep the splats outside instead")
    option(
        "--heal X Y Z R", "then fill the hole in this sphere with splats from around it", _finite
    )


def _add_clean(parser: argparse.ArgumentParser) -> None:
    option = partial(add_option, parser.add_argument_group("3. clean up"))
    option(
        "--clean",
        f"usual limits, unless given: opacity {USUAL.min_opacity:g}, contribution "
        f"{USUAL.min_contribution:g}, isolation {USUAL.max_isolation:g}, clusters of "
        f"{USUAL.min_cluster}",
    )
    option("--min-opacity X", "drop splats with a lower opacity, 0 to 1", _share)
    option("--max-size X", "drop splats with a larger standard deviation, world units", _positive)
    option(
        "--min-contribution PX",
        "drop splats that contribute less to every view: blending weights summed over pixels",
        _positive,
    )
    option(
        "--max-isolation X",
        "drop splats whose distance to their neighbours exceeds the neighbours' own "
        "distances by this factor",
        _positive,
    )
    option("--min-cluster N", "drop separate clusters of fewer splats", _count)
    option(
        "--gap X",
        "distance between clusters, as a share of the median distance of splats from the "
        f"middle ({GAP:g})",
        _positive,
    )


def _add_fewer_and_place(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("4. fewer coefficients and splats")
    option = partial(add_option, group)
    option(
        "--sh-degree", "maximum degree of view-dependent colour", int, choices=range(MAX_DEGREE + 1)
    )
    which = partial(add_option, group.add_mutually_exclusive_group())
    which("--count N", "keep the N most important splats", _count)
    which("--size MB", "keep the splats that fit into a file of this size", _positive)
    option = partial(
        add_option, parser.add_argument_group("5. transform, after the steps that use cameras")
    )
    option("--scale X", "scale factor about the origin", _positive)
    option("--rotate X Y Z", "rotation in degrees about the x, then y, then z axis", _finite)
    option("--move X Y Z", "translation in world units, applied last", _finite)
    option(
        "--matrix FILE",
        "text file with the old-to-new transform, 16 numbers row by row, instead of the "
        "three above",
        Path,
    )


def _finite(text: str) -> float:
    what = f"a number from {-FARTHEST:g} to {FARTHEST:g}"
    return _number(text, lambda value: abs(value) <= FARTHEST, what)


def _positive(text: str) -> float:
    what = f"a number above 0 and up to {FARTHEST:g}"
    return _number(text, lambda value: 0 < value <= FARTHEST, what)


def _share(text: str) -> float:
    return _number(text, lambda value: 0 <= value <= 1, "a number from 0 to 1")


def _count(text: str) -> int:
    value = _number(text, lambda value: value >= 1 and value == int(value), "a whole number from 1")
    return int(value)


def _number(text: str, fits: Callable[[float], bool], what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and fits(value)):
        raise argparse.ArgumentTypeError(f"{quoted(text)} is not {what}")
    return value
