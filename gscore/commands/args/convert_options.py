"""The options of `gscore convert`."""

import argparse
import math
from collections.abc import Callable
from pathlib import Path

from ...edit.request import GAP, USUAL
from ...formats import FORMATS
from ...quoting import quoted
from ...scene import FARTHEST
from ...sh import MAX_DEGREE
from ..parser import add_threads_option

SPZ_VERSION = 3
"""Default version of .spz files."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb, in the order of the steps."""
    parser.description = (
        f"{parser.description or ''} Steps run in the order of this list, regardless of the order "
        f"of the options. Endings of OUT: {', '.join(_written_endings())}."
    ).strip()
    parser.add_argument("input", metavar="IN", type=Path, help="splat file, or the folder of a run")
    parser.add_argument(
        "output",
        metavar="OUT",
        type=Path,
        help="output file; its ending selects the format",
    )
    _add_join_and_crop(parser)
    _add_clean(parser)
    _add_fewer_and_place(parser)
    group = parser.add_argument_group("cameras, for contributions and losses")
    group.add_argument(
        "-s",
        "--source",
        type=Path,
        help="a capture, the folder of a run or a cameras.json; default: the run's",
    )
    group.add_argument(
        "--views",
        type=_count,
        default=60,
        metavar="N",
        help="maximum number of views that measure the loss (60)",
    )
    group.add_argument(
        "--picture",
        type=Path,
        metavar="FILE.png",
        help="picture of one view, before and after side by side",
    )
    group.add_argument(
        "--picture-view",
        metavar="NAME",
        help="view of the picture, by name or number; default: the middle one",
    )
    parser.add_argument(
        "--spz-version",
        type=int,
        choices=(3, 4),
        default=SPZ_VERSION,
        help="version of SPZ: 3, for all readers, or 4, with zstd (3)",
    )
    add_threads_option(parser)
    parser.add_argument(
        "--overwrite", action="store_true", help="replace files that gscore did not write"
    )
    parser.add_argument("--json", action="store_true", help="the result as JSON on stdout")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def _written_endings() -> list[str]:
    return [ending for one in FORMATS if one.write for ending in one.endings]


def _add_join_and_crop(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("1. merge")
    group.add_argument(
        "--merge",
        nargs="+",
        type=Path,
        default=[],
        metavar="FILE",
        help="further splat files in the same world",
    )
    group.add_argument(
        "--level",
        type=int,
        metavar="N",
        help="level to write of a file of levels of detail; 0: the finest (0)",
    )
    group = parser.add_argument_group("2. crop: keep splats inside all of these")
    group.add_argument(
        "--box",
        nargs=6,
        type=_finite,
        metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
        help="box between two corners",
    )
    group.add_argument(
        "--sphere", nargs=4, type=_finite, metavar=("X", "Y", "Z", "R"), help="centre and radius"
    )
    group.add_argument(
        "--frustum",
        nargs="+",
        metavar="VIEW",
        help="splats visible in any of these views, by name or number",
    )
    group.add_argument("--outside", action="store_true", help="keep the splats outside instead")


def _add_clean(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("3. clean up")
    group.add_argument(
        "--clean",
        action="store_true",
        help=f"usual limits, unless given: opacity {USUAL.min_opacity:g}, contribution "
        f"{USUAL.min_contribution:g}, isolation {USUAL.max_isolation:g}, clusters of "
        f"{USUAL.min_cluster}",
    )
    group.add_argument(
        "--min-opacity", type=_share, metavar="X", help="drop splats with a lower opacity, 0 to 1"
    )
    group.add_argument(
        "--max-size",
        type=_positive,
        metavar="X",
        help="drop splats with a larger standard deviation, world units",
    )
    group.add_argument(
        "--min-contribution",
        type=_positive,
        metavar="PX",
        help="drop splats that contribute less to every view: blending weights summed over pixels",
    )
    group.add_argument(
        "--max-isolation",
        type=_positive,
        metavar="X",
        help="drop splats whose distance to their neighbours exceeds the neighbours' own "
        "distances by this factor",
    )
    group.add_argument(
        "--min-cluster",
        type=_count,
        metavar="N",
        help="drop separate clusters of fewer splats",
    )
    group.add_argument(
        "--gap",
        type=_positive,
        metavar="X",
        help="distance between clusters, as a share of the median distance of splats from the "
        f"middle ({GAP:g})",
    )


def _add_fewer_and_place(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("4. fewer coefficients and splats")
    group.add_argument(
        "--sh-degree",
        type=int,
        choices=range(MAX_DEGREE + 1),
        help="maximum degree of view-dependent colour",
    )
    which = group.add_mutually_exclusive_group()
    which.add_argument("--count", type=_count, metavar="N", help="keep the N most important splats")
    which.add_argument(
        "--size",
        type=_positive,
        metavar="MB",
        help="keep the splats that fit into a file of this size",
    )
    group = parser.add_argument_group("5. transform, after the steps that use cameras")
    group.add_argument("--scale", type=_positive, metavar="X", help="scale factor about the origin")
    group.add_argument(
        "--rotate",
        nargs=3,
        type=_finite,
        metavar=("X", "Y", "Z"),
        help="rotation in degrees about the x, then y, then z axis",
    )
    group.add_argument(
        "--move",
        nargs=3,
        type=_finite,
        metavar=("X", "Y", "Z"),
        help="translation in world units, applied last",
    )
    group.add_argument(
        "--matrix",
        type=Path,
        metavar="FILE",
        help="text file with the old-to-new transform, 16 numbers row by row, instead of the "
        "three above",
    )


def _finite(text: str) -> float:
    return _number(text, lambda value: abs(value) <= FARTHEST, f"a number of {FARTHEST:g} at most")


def _positive(text: str) -> float:
    what = f"a number above 0, {FARTHEST:g} at most"
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
