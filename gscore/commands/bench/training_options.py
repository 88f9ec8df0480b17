"""Training options of benches: the capture and changes of a preset."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ...config import LIFTED_BY, DataConfig, Strategy, TrainConfig
from ...errors import ConfigError
from ...presets import PRESETS
from ...quoting import quoted
from ..args.data_options import add_data_options, with_data_options
from ..parser import add_threads_option

_EVERY = 8
"""Every eighth view is held out by default."""


def add_training_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options that change a preset, and those of the capture."""
    parser.add_argument(
        "--iterations", type=int, help="number of training steps; default: the preset's"
    )
    parser.add_argument(
        "--max-splats", type=int, help="cap of the number of splats; default: the preset's"
    )
    parser.add_argument("--strategy", choices=tuple(Strategy), help="densification strategy")
    add_threads_option(parser)
    add_data_options(parser)


def named_sources(sources: Sequence[Path]) -> dict[str, Path]:
    """Captures by the names of their folders.

    Raises:
        ConfigError: two have one name.
    """
    named: dict[str, Path] = {}
    for source in sources:
        name = source.resolve().name
        if name in named:
            raise ConfigError(f"Two captures are called {quoted(name)}; give them different names.")
        named[name] = source
    return named


def training_configs(
    args: argparse.Namespace, source: Path, preset: str
) -> tuple[DataConfig, TrainConfig]:
    """Preset `preset` for `source` with the given options; some views are always held out."""
    data, train = PRESETS[preset](source)
    data = with_data_options(data, args)
    if not data.eval:
        data = replace(data, eval=True, test_every=_EVERY)
    given = {
        name: getattr(args, name)
        for name in ("iterations", "max_splats")
        if getattr(args, name) is not None
    }
    given |= {LIFTED_BY[name]: 0 for name in given}  # as for `gscore train`
    if args.strategy is not None:
        given["strategy"] = Strategy(args.strategy)
    return data, replace(train, threads=args.threads, **given)
