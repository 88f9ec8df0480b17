"""The options of `gscore depth`."""

import argparse
from functools import partial
from pathlib import Path

from ...depth.maps import DepthKind
from ...depth.network import Normalization
from ...depth.params import DEPTH_FOLDER
from ..parser import add_option, add_threads_option
from ..terminal.run_job import add_output_options
from .data_options import add_mask_options, add_split_options


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    option = partial(add_option, parser)
    option("source?", "capture: photos with a COLMAP model", Path)
    option(
        "--model NETWORK",
        "depth network: an ONNX file, or a name of --list-models; without it, existing maps"
        " are aligned",
    )
    option("--download", "download the named network if it is not on this machine")
    option("--list-models", "list the named networks with size, licence and local availability")
    option(
        "--method",
        "source of the maps: a network (--model), or stereo, with depths that other photos confirm",
        choices=("network", "stereo"),
    )
    option(
        "-d, --depths DIR", "folder of the depth maps inside SOURCE (depths)", default=DEPTH_FOLDER
    )
    option(
        "--align",
        "fit of the maps to the SfM points: robust against outliers, or official as in the "
        "3DGS tools (robust)",
        choices=("robust", "official"),
        default="robust",
    )
    option(
        "--kind",
        "meaning of larger numbers in maps: nearer (inverse) or farther (depth); auto: from "
        "the points",
        DepthKind,
        choices=tuple(DepthKind),
        default=DepthKind.AUTO,
    )
    option(
        "--normalization",
        "input normalisation of the network; auto: from its file",
        Normalization,
        choices=tuple(Normalization),
        default=Normalization.AUTO,
    )
    option(
        "--input-size N",
        "shorter side of the network's input in pixels, if the network accepts any size",
        default=0,
    )
    option(
        "--overwrite",
        "predict existing maps again, and replace a depth_params.json or contact sheet of "
        "another program",
    )
    option(
        "--check",
        "list the maps that a training would use, and why it would not use the others; "
        "write nothing",
    )
    option("-i, --images IMAGES", "folder of the photos inside SOURCE", default="images")
    masks = parser.add_argument_group("masks", "With composite, masked pixels have no depth.")
    add_mask_options(masks)
    option("--frame N", "frame of a multi-view video", int)
    held_out = parser.add_argument_group(
        "test views",
        "Maps of held-out photos are fitted to their own points only and do not influence other "
        "maps. Stereo neither reads these photos nor makes maps for them.",
    )
    add_split_options(held_out)
    add_threads_option(parser)
    add_output_options(parser)
