"""Capture of a model: its data options and the views to measure."""

import argparse
from dataclasses import replace

from ...config import DataConfig
from ...datasets import Dataset
from ...errors import ConfigError, DatasetError
from .data_options import with_data_options
from .model_argument import ModelArgument


def data_config_of(args: argparse.Namespace, model: ModelArgument) -> DataConfig:
    """Data options of the run, overridden by the command line; a PLY alone needs `-s`."""
    if model.data is not None:
        config = model.data
        if args.source is not None:
            config = DataConfig(
                source=args.source, resolution=config.resolution, max_width=config.max_width
            )
            # Names and folders of the old capture do not apply to another one. If the old one no
            # longer exists, it was moved here.
            if args.source.resolve() == model.data.source.resolve():
                config = model.data
            elif not model.data.source.exists():
                config = replace(model.data, source=args.source)
        elif not config.source.exists():
            raise DatasetError(
                f"The capture of {model.run}, {config.source}, no longer exists; give its current "
                "folder with -s SOURCE."
            )
    elif args.source is None:
        raise ConfigError(f"The capture of {model.path} is unknown; give it with -s SOURCE.")
    else:
        config = DataConfig(source=args.source, eval=True)
    return with_data_options(config, args)


def views_of(split: str | None, dataset: Dataset) -> tuple[str, list[int]]:
    """Name and indices of the views to measure."""
    if split == "test" and not dataset.test:
        raise DatasetError(
            "The run has no held-out views; choose another `--split`, or select test views with "
            "`--hold-out`."
        )
    if split == "test" or (split is None and dataset.test):
        return "test", dataset.test
    if split == "all":
        return "all", sorted([*dataset.train, *dataset.test])
    return "train", dataset.train
