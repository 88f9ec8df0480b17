"""Data options: capture, masks and test views, for verbs that do not train."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...config import DataConfig
from ...errors import ConfigError
from ...hold_out import SPLIT, parse_hold_out
from ...option_marks import mark_option
from ...options import Option, flag_of
from .run_options import declare, help_text, passed_options

_MASKS = ("masks", "mask_mode", "invert_masks")
HOLD_OUT = Option(
    name="hold_out",
    default=None,
    kind=str,
    text="Held-out photos: 8 (every eighth by name), first:10, last:10, or a text file of names. "
    "The file has one name per line. Default with --eval: 8, unless the capture lists its own.",
    group="capture",
    metavar="WHICH",
    basic=True,
)
"""One option for four fields of `DataConfig`."""
_MAX_WIDTH = DataConfig.max_width
"""Width up to which 3DGS uses photos at full size, px."""


def add_data_options(parser: argparse.ArgumentParser) -> None:
    """Declare them under the names of `gscore train` and the 3DGS tools."""
    group = parser.add_argument_group("capture")
    declare(group, DataConfig, names=("images", *_MASKS, "resolution"))
    add_split_options(group)
    declare(group, DataConfig, names=("frame", "rig"))


def add_mask_options(group: argparse._ActionsContainer) -> None:
    """Declare the options of masks: their folder and meaning."""
    declare(group, DataConfig, names=_MASKS)


def add_split_options(group: argparse._ActionsContainer) -> None:
    """Declare the option that selects held-out views, and the four older ones it replaces."""
    action = group.add_argument(
        HOLD_OUT.flag, type=_hold_out, metavar=HOLD_OUT.metavar, help=help_text(HOLD_OUT)
    )
    vars(action)["declared"] = HOLD_OUT
    for name in SPLIT:
        kind = Path if name == "test_list" else int
        group.add_argument(flag_of(name), type=kind, help=argparse.SUPPRESS)


def with_data_options(config: DataConfig, args: argparse.Namespace) -> DataConfig:
    """The config with the options of the command line."""
    return replace(config, **given_data(args))


def given_data(args: argparse.Namespace) -> dict[str, Any]:
    """The given options of `DataConfig`; a split option turns on `eval`.

    Raises:
        ConfigError: rules for the split that contradict.
    """
    given = passed_options(DataConfig, args)
    if given.get("resolution") == -1:  # the preset or run may have another width limit
        given["max_width"] = _MAX_WIDTH
    if split := _given_split(args):
        # The offset belongs to the rule that is replaced.
        given = {"eval": True, "test_offset": None} | given | split
    return given


def _given_split(args: argparse.Namespace) -> dict[str, Any]:
    """The values of `SPLIT` if one of them, or `--hold-out`, was given; else empty.

    Raises:
        ConfigError: rules that contradict.
    """
    names = [name for name in ("hold_out", *SPLIT) if getattr(args, name, None) is not None]
    if len(names) > 1 and set(names) != {"test_first", "test_last"}:
        flags = [mark_option(name) for name in names]
        raise ConfigError(
            f"{' and '.join(flags)} are different ways to choose test views; give one of them."
        )
    if names == ["hold_out"]:
        return args.hold_out
    plain = DataConfig(source=Path())
    chosen = {name: getattr(plain, name) for name in SPLIT} if names else {}
    return chosen | {name: getattr(args, name) for name in names}


def _hold_out(text: str) -> dict[str, Any]:
    try:
        return parse_hold_out(text)
    except ConfigError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
