"""`gscore depth`: prediction of depth maps, alignment with a capture's points, contact sheet."""

import argparse

from ..depth.catalogue import known, network_names
from ..depth.network import NETWORK_HINT
from ..errors import ConfigError
from .args.depth_options import add_arguments as add_arguments
from .depth_maps.make_maps import StopMessage, make_maps
from .depth_maps.networks import list_models
from .depth_maps.result_text import facts_of, print_result
from .terminal.output import print_json
from .terminal.run_job import OutputOptions, run_job


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
    result, code = run_job(
        OutputOptions.of(args),
        lambda show, control: make_maps(args, show, control, message),
        stopped=message,
    )
    if result is None:
        return code
    if args.json:
        print_json(facts_of(args, result))
    elif not (args.events or args.quiet):
        print_result(args, result)
    return code


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
