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
    parser.add_argument(
        "source", type=Path, nargs="?", help="the capture: photos with a COLMAP model"
    )
    parser.add_argument(
        "--model",
        metavar="NETWORK",
        help="network to predict with: an ONNX file, or a name of --list-models; without one the "
        "maps that are there are aligned",
    )
    parser.add_argument(
        "--download",
        action="store_true",
        help="fetch a network given by name where it is not on this machine yet",
    )
    parser.add_argument(
        "--list-models",
        action="store_true",
        help="list the networks that have a name, with size, licence and whether they are here",
    )
    parser.add_argument(
        "--method",
        choices=("network", "stereo"),
        help="how maps are made: by a network (--model), or by stereo from the photos themselves, "
        "which needs none and states depths where other photos confirm them",
    )
    parser.add_argument(
        "-d",
        "--depths",
        default=DEPTH_FOLDER,
        metavar="DIR",
        help="folder of the depth maps in SOURCE (depths)",
    )
    parser.add_argument(
        "--align",
        choices=("robust", "official"),
        default="robust",
        help="how maps are fitted to the points that COLMAP found: robust against wrong ones, or "
        "official, as the 3DGS tools do (medians and mean absolute deviations)",
    )
    parser.add_argument(
        "--kind",
        type=DepthKind,
        choices=tuple(DepthKind),
        default=DepthKind.AUTO,
        help="whether larger numbers in maps are nearer (inverse) or farther (depth); auto: found "
        "by comparing with the points",
    )
    parser.add_argument(
        "--normalization",
        type=Normalization,
        choices=tuple(Normalization),
        default=Normalization.AUTO,
        help="how the network wants the numbers of its photos; auto: by its file",
    )
    parser.add_argument(
        "--input-size",
        type=int,
        default=0,
        metavar="N",
        help="shorter side in pixels of what the network is shown, where it takes any size",
    )
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help="predict views again that have a map, and replace a depth_params.json or contact "
        "sheet that another program wrote",
    )
    parser.add_argument(
        "--check",
        action="store_true",
        help="say which maps a training would use and why not others; write nothing",
    )
    parser.add_argument("-i", "--images", default="images", help="folder of the photos in SOURCE")
    masks = parser.add_argument_group(
        "masks", "With composite, what they hide is left out of maps."
    )
    add_mask_options(masks)
    parser.add_argument("--frame", type=int, metavar="N", help="frame of a multi-view video")
    held_out = parser.add_argument_group(
        "test views",
        "Those that a training is to hold out: their maps are fitted to their own points alone and "
        "have no part in placing the others. Stereo does not look at them and makes no map of "
        "them.",
    )
    add_split_options(held_out)
    add_threads_option(parser)
    parser.add_argument("--json", action="store_true", help="the results as JSON, last on stdout")
    parser.add_argument(
        "--events", choices=("jsonl",), help="events as JSON lines on stdout, commands on stdin"
    )
    parser.add_argument("--quiet", action="store_true", help="say nothing but errors")
