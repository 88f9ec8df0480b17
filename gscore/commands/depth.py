"""`gscore depth`: prediction of depth maps, alignment with a capture's points, contact sheet."""

import argparse
from functools import partial
from pathlib import Path
from typing import Any

from ..depth.catalogue import known, network_names
from ..depth.maps import DepthKind
from ..depth.network import NETWORK_HINT, Network, Normalization
from ..depth.params import DEPTH_FOLDER
from ..errors import ConfigError
from ..text_format import count_text
from .args.data_options import add_mask_options, add_split_options
from .depth_maps.make_maps import DepthResult, StopMessage, list_models, make_maps
from .parser import add_option, add_threads_option
from .terminal.run_job import OutputOptions, add_output_options, run_verb


def run(args: argparse.Namespace) -> int:
    """Predict, align, write depth_params.json and the contact sheet; or check and write nothing."""
    if args.list_models:
        return list_models(args)
    if args.source is None:
        raise ConfigError("Give a capture: gscore depth CAPTURE --model NETWORK.")
    if args.download and (args.model is None or known(args.model) is None):
        raise ConfigError(
            f"`--download` needs a `--model` with a name: {', '.join(network_names())}."
        )
    if args.input_size < 0:
        raise ConfigError(f"`--input-size` is {args.input_size}, expected a positive number.")
    if args.check and (args.model is not None or args.overwrite):
        raise ConfigError("`--check` writes nothing; leave `--model` and `--overwrite` out.")
    if args.method == "stereo":
        _check_stereo(args)
    elif args.method == "network" and args.model is None:
        raise ConfigError(
            f"`--method network` needs a network: `--model FILE.onnx`. {NETWORK_HINT}."
        )
    message = StopMessage()
    return run_verb(
        OutputOptions.of(args),
        lambda show, control: make_maps(args, show, control, message),
        facts=partial(facts_of, args),
        lines=partial(result_lines, args),
        stopped=message,
    )


def _check_stereo(args: argparse.Namespace) -> None:
    """Raise ConfigError for options of other methods."""
    given = {
        "`--model`": args.model is not None,
        "`--check`": args.check,
        "`--align official`": args.align == "official",
        "`--input-size`": args.input_size > 0,
    }
    for flag in (flag for flag, is_given in given.items() if is_given):
        raise ConfigError(
            f"`--method stereo` and {flag} exclude each other: stereo uses no network, and its "
            "maps have the scale of the capture."
        )


def _model_facts(network: Network) -> dict[str, Any]:
    profile = network.profile
    return {
        "file": str(network.path),
        "family": profile.family,
        "normalization": profile.normalization.value,
        "kind": profile.kind.value,
        "input_size": [profile.width, profile.height],
    }


def _table_text(table: list[dict[str, Any]]) -> str:
    width = max(len(row["view"]) for row in table)
    lines = [f"{'view':{width}}  points  inliers     scale    offset   error"]
    for row in table:
        error = "-" if row["error"] is None else f"{row['error']:.1%}"
        inliers = f"{row['inliers']:.0%}" if row["points"] else "-"
        scale, offset = "-", "-"
        if row["map"]:
            scale, offset = f"{row['scale']:.4g}", f"{row['offset']:.3g}"
        lines.append(
            f"{row['view']:{width}}  {row['points']:6}  {inliers:>7}  {scale:>8}  {offset:>8}  "
            f"{error:>6}  {row['reason']}"
        )
    return "\n".join(line.rstrip() for line in lines)


def facts_of(args: argparse.Namespace, result: DepthResult) -> dict[str, Any]:
    """The result as JSON values."""
    done = result.done
    return {
        "views": done.views,
        "predicted": done.predicted,
        "kept": done.kept,
        "accepted": done.accepted,
        "align": _rule(args),
        "kind": result.alignment.kind.value,
        "folder": done.folder,
        "params": done.params or None,
        "sheet": done.sheet or None,
        "model": _model_facts(result.network) if result.network else None,
        "why": done.why,
        "table": done.table,
        "warnings": result.warnings,
    }


def _rule(args: argparse.Namespace) -> str:
    """The rule that determined the scale of the maps."""
    if args.method == "stereo":
        return "stereo"
    return "auto" if args.check else args.align


def result_lines(args: argparse.Namespace, result: DepthResult) -> list[str]:
    """The result as lines of text."""
    done = result.done
    what = "depth" if result.alignment.kind is DepthKind.DEPTH else "inverse depth"
    lines = [_table_text(done.table)]
    if result.used:
        lines.append(f"Predicted with {result.used}.")
    count = f"{done.accepted} of {sum(1 for row in done.table if row['map'])} maps of {what}"
    if args.check:
        lines.append(f"{count} would be used with their scale; nothing was written")
    else:
        rule = (
            "scaled by stereo" if args.method == "stereo" else f"aligned by the {args.align} rule"
        )
        lines.append(f"{count} {rule}: {done.params}")
        if not any(row["points"] for row in done.table):
            lines.append(
                "The capture has no points where these maps have depths, so only a comparison with "
                "the photos shows their quality."
            )
        lines.append(f"{count_text(result.shown, 'view')} on {done.sheet}")
    return [*lines, done.why]


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
