"""`gscore bench WHAT`: measure speed, and error over time, on this machine."""

import argparse
from importlib import import_module

from ..parser import add_option, sentence

WHAT = {
    "raster": "forward and backward passes of the rasterizer",
    "step": "a training step and its parts",
    "skips": "gain of each skip (optimisation) on a capture",
    "quality": "held-out quality over captures, seeds and splits, and the effect of changes",
    "time-error": "held-out error over seconds of training, for presets and variants",
    "memory": "memory of a training of many splats",
    "scaling": "cost over splats, pixels, threads and views",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    what = parser.add_subparsers(dest="what", required=True, metavar="WHAT")
    for name, text in WHAT.items():
        one = what.add_parser(name, help=text, description=sentence(text), allow_abbrev=False)
        _module(name).add_arguments(one)
        add_option(one, "--json", "the result as JSON on stdout")


def run(args: argparse.Namespace) -> int:
    """Run the measurement and print it."""
    return _module(args.what).run(args)


def _module(name: str):
    return import_module("." + name.replace("-", "_"), __package__)
