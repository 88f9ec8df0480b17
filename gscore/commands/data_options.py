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
    group.add_argument("--masks", metavar="DIR", help="folder of masks in SOURCE")
    group.add_argument(
        "--mask-mode",
        choices=("auto", "composite", "ignore", "none"),
        help="composite: masks are opacity; ignore: masked-out pixels do not count",
    )
    group.add_argument(
        "-r",
        "--resolution",
        type=float,
        help="1, 2, 4, 8: divide by it; larger: width in pixels; -1: as is, at most 1600 px wide, "
        "whatever the preset or the run takes",
    )
    add_split_options(group)
    group.add_argument("--frame", type=int, metavar="N", help="frame of a multi-view video")
    group.add_argument(
        "--rig", type=Path, metavar="DIR", help="take the cameras and the world of that capture"
    )


def add_split_options(group: argparse._ActionsContainer) -> None:
    """Declare the options that choose test views."""
    group.add_argument("--test-every", type=int, metavar="N", help="every N-th view is a test view")
    group.add_argument("--test-list", type=Path, metavar="FILE", help="names of the test views")
    group.add_argument("--test-first", type=int, metavar="N", help="the first N are test views")
    group.add_argument("--test-last", type=int, metavar="N", help="the last N are test views")


def add_depth_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options that say which depth maps to read and how."""
    group = parser.add_argument_group("depth maps")
    group.add_argument(
        "-d", "--depths", metavar="DIR", help="folder of inverse depth maps in SOURCE"
    )
    group.add_argument(
        "--depth-align",
        choices=("auto", "official", "robust", "none"),
        help="how depth maps get the scale of the capture (auto: depth_params.json, else robust)",
    )


_MAX_WIDTH = next(field.default for field in fields(DataConfig) if field.name == "max_width")
"""What 3DGS takes photos as they are up to, px."""
_SPLIT = ("test_every", "test_list", "test_first", "test_last")
_OTHER = ("images", "masks", "mask_mode", "depths", "depth_align", "resolution", "frame", "rig")


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
        given = {name: getattr(plain, name) for name in _SPLIT} | given | {"eval": True}
    return replace(config, **given)
