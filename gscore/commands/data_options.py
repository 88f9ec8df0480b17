"""Options that say how to read a capture, for verbs that do not train."""

import argparse
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from ..config import DataConfig, flag_of
from ..errors import ConfigError


def add_data_options(parser: argparse.ArgumentParser) -> None:
    """Declare them, under the names `gscore train` and the 3DGS tools use."""
    group = parser.add_argument_group("capture")
    group.add_argument("-i", "--images", metavar="DIR", help="folder of the photos in SOURCE")
    add_mask_options(group)
    group.add_argument(
        "-r",
        "--resolution",
        type=float,
        help="size of the photos: 1, 2, 4, 8 divide it; a larger number is the width in pixels; "
        "-1: as they are, at most 1600 wide, whatever the preset or the run takes",
    )
    add_split_options(group)
    group.add_argument(
        "--frame", type=int, metavar="N", help="of a multi-view video: number of the frame to read"
    )
    group.add_argument(
        "--rig",
        type=Path,
        metavar="DIR",
        help="another capture by the same cameras, which stand where that one says",
    )


def add_mask_options(group: argparse._ActionsContainer) -> None:
    """Declare the options that say where masks are and what they mean."""
    group.add_argument("--masks", metavar="DIR", help="folder of masks in SOURCE (masks)")
    group.add_argument(
        "--mask-mode",
        choices=("auto", "composite", "ignore", "none"),
        help="ignore: pixels where the mask is black do not count; composite: the mask is the "
        "opacity of the subject, and nothing else is trained; none: masks are not read; auto: "
        "composite for photos with transparency and masks that cut out a subject, else ignore",
    )
    group.add_argument(
        "--invert-masks",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="mask files are white where pixels do not count, instead of black",
    )


def add_split_options(group: argparse._ActionsContainer) -> None:
    """Declare the options that choose test views."""
    group.add_argument(
        "--test-every",
        type=int,
        metavar="N",
        help="every N-th photo is held out of the training, to measure on it (8)",
    )
    group.add_argument(
        "--test-list",
        type=Path,
        metavar="FILE",
        help="text file with the names of the photos to hold out, one a line",
    )
    group.add_argument("--test-first", type=int, metavar="N", help="hold the first N photos out")
    group.add_argument("--test-last", type=int, metavar="N", help="hold the last N photos out")


def add_depth_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options that say which depth maps to read and how."""
    group = parser.add_argument_group("depth maps")
    group.add_argument(
        "-d",
        "--depths",
        metavar="DIR",
        help="folder of depth maps in SOURCE; gscore depth makes and checks them",
    )
    group.add_argument(
        "--depth-align",
        choices=("auto", "official", "robust", "none"),
        help="how depth maps get the scale of the capture: official: as depth_params.json says; "
        "robust: by the points that COLMAP found; none: they have it; auto: official where it "
        "agrees with the points, else robust",
    )


_MAX_WIDTH = next(field.default for field in fields(DataConfig) if field.name == "max_width")
"""What 3DGS takes photos as they are up to, px."""
_SPLIT = ("test_every", "test_list", "test_first", "test_last")
_OTHER = (
    *("images", "masks", "mask_mode", "invert_masks", "depths", "depth_align", "resolution"),
    *("frame", "rig"),
)


def with_data_options(config: DataConfig, args: argparse.Namespace) -> DataConfig:
    """The config with what was given on the command line; naming a split means to use it."""
    given: dict[str, Any] = {
        name: getattr(args, name)
        for name in (*_SPLIT, *_OTHER)
        if getattr(args, name, None) is not None
    }
    if given.get("resolution") == -1:  # as is; presets and runs may have a width of their own
        given["max_width"] = _MAX_WIDTH
    split = [name for name in _SPLIT if name in given]
    if len(split) > 1 and set(split) != {"test_first", "test_last"}:
        flags = [flag_of(name) for name in split]
        raise ConfigError(
            f"{' and '.join(flags)} are different ways to choose test views; give one of them."
        )
    if split:
        plain = DataConfig(source=config.source)
        given = {name: getattr(plain, name) for name in _SPLIT} | given
        given |= {"eval": True, "test_offset": None}  # which belongs to the rule that was replaced
    return replace(config, **given)
