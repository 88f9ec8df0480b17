"""The options of `gscore depth`."""

import argparse
from pathlib import Path

from ...depth.maps import DepthKind
from ...depth.network import Normalization
from ...depth.params import DEPTH_FOLDER
from ..parser import add_threads_option
from .data_options import add_mask_options, add_split_options


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    parser.add_argument("source", type=Path, nargs="?", help="capture: photos with a COLMAP model")
    parser.add_argument(
        "--model",
        metavar="NETWORK",
        help="depth network: an ONNX file, or a name of --list-models; without it, existing maps"
        " are aligned",
    )
    parser.add_argument(
        "--download",
        action="store_true",
        help="download the named network if it is not on this machine",
    )
    parser.add_argument(
        "--list-models",
        action="store_true",
        help="list the named networks with size, licence and local availability",
    )
    parser.add_argument(
        "--method",
        choices=("network", "stereo"),
        help="source of the maps: a network (--model), or stereo, with depths that other photos "
        "confirm",
    )
    parser.add_argument(
        "-d",
        "--depths",
        default=DEPTH_FOLDER,
        metavar="DIR",
        help="folder of the depth maps inside SOURCE (depths)",
    )
    parser.add_argument(
        "--align",
        choices=("robust", "official"),
        default="robust",
        help="fit of the maps to the SfM points: robust against outliers, or official as in the "
        "3DGS tools (robust)",
    )
    parser.add_argument(
        "--kind",
        type=DepthKind,
        choices=tuple(DepthKind),
        default=DepthKind.AUTO,
        help="meaning of larger numbers in maps: nearer (inverse) or farther (depth); auto: from "
        "the points",
    )
    parser.add_argument(
        "--normalization",
        type=Normalization,
        choices=tuple(Normalization),
        default=Normalization.AUTO,
        help="input normalisation of the network; auto: from its file",
    )
    parser.add_argument(
        "--input-size",
        type=int,
        default=0,
        metavar="N",
        help="shorter side of the network's input in pixels, if the network accepts any size",
    )
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help="predict existing maps again, and replace a depth_params.json or contact sheet of "
        "another program",
    )
    parser.add_argument(
        "--check",
        action="store_true",
        help="list the maps that a training would use, and why it would not use the others; "
        "write nothing",
    )
    parser.add_argument(
        "-i", "--images", default="images", help="folder of the photos inside SOURCE"
    )
    masks = parser.add_argument_group("masks", "With composite, masked pixels have no depth.")
    add_mask_options(masks)
    parser.add_argument("--frame", type=int, metavar="N", help="frame of a multi-view video")
    held_out = parser.add_argument_group(
        "test views",
        "Maps of held-out photos are fitted to their own points only and do not influence other "
        "maps. Stereo neither reads these photos nor makes maps for them.",
    )
    add_split_options(held_out)
    add_threads_option(parser)
    parser.add_argument(
        "--json", action="store_true", help="the results as JSON at the end of stdout"
    )
    parser.add_argument(
        "--events", choices=("jsonl",), help="events as JSON lines on stdout, commands on stdin"
    )
    parser.add_argument("--quiet", action="store_true", help="print errors only")
