"""Quality plan of `gscore bench quality`: trainings, checked before the first one."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ...bench.leave_out import THINNED
from ...bench.time_error import Variant
from ...bench.training import open_sizes
from ...config import DataConfig
from ...errors import ConfigError
from ...presets import RECIPES
from ...quoting import quoted
from .shared import changed, named_sources, training_configs


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One split of one capture, and the trainings on it."""

    capture: str
    """Its name, with the thinning if any."""
    offset: int
    seeds: list[int]
    datas: list[DataConfig]
    """Capture options of each variant; only the size of the photos differs."""
    variants: list[Variant]
    """The first is the baseline; all are measured on the same photos."""


@dataclass(frozen=True, kw_only=True)
class QualityRequest:
    """A variant on the command line."""

    label: str
    preset: str
    changes: tuple[str, ...]


def variants_of(args: argparse.Namespace) -> list[QualityRequest]:
    """The unchanged preset, and each variant of `--compare`.

    Raises:
        ConfigError: two variants have one name, or a text is not NAME=CHANGES.
    """
    variants = [QualityRequest(label=args.preset, preset=args.preset, changes=())]
    for text in args.compare:
        name, equals, changes = text.partition("=")
        if not (name and equals and changes):
            raise ConfigError(
                "`--compare` takes NAME=CHANGES, such as both=mcmc,free-space=0, got "
                f"{quoted(text)}."
            )
        if name in [variant.label for variant in variants]:
            raise ConfigError(f"`--compare`: two variants are called {quoted(name)}.")
        variants.append(_request(args, name, changes.split(",")))
    return variants


def _request(args: argparse.Namespace, label: str, changes: Sequence[str]) -> QualityRequest:
    presets = [part.removeprefix("preset=") for part in changes if part.startswith("preset=")]
    for preset in presets:
        if preset not in RECIPES:
            raise ConfigError(
                f"`--compare {label}`: there is no preset {quoted(preset)}; there are: "
                f"{', '.join(RECIPES)}."
            )
    rest = tuple(part for part in changes if not part.startswith("preset="))
    return QualityRequest(label=label, preset=[args.preset, *presets][-1], changes=rest)


def cells_of(args: argparse.Namespace, variants: Sequence[QualityRequest]) -> list[Cell]:
    """One cell per capture, thinning and offset; no photo is decoded yet.

    Raises:
        GsError: an invalid capture, option or offset.
    """
    return [
        _cell(args, name, source, offset, thin, variants)
        for name, source in named_sources(args.sources).items()
        for thin in args.thin
        for offset in args.offsets
    ]


def _cell(
    args: argparse.Namespace,
    name: str,
    source: Path,
    offset: int,
    thin: int,
    variants: Sequence[QualityRequest],
) -> Cell:
    datas, configs = [], []
    for variant in variants:
        data, config = training_configs(args, source, variant.preset)
        datas.append(_held_out(data, offset))
        configs.append(changed(config, variant.changes, flag="--compare"))
    _check_different([one.label for one in variants], list(zip(datas, configs, strict=True)))
    photos, eval_views = open_sizes(datas)
    for dataset in {id(dataset): dataset for dataset in photos}.values():
        dataset.train = dataset.train[::thin]
    return Cell(
        capture=name if thin == 1 else f"{name}{THINNED}{thin}",
        offset=offset,
        seeds=args.seeds,
        datas=datas,
        variants=[
            Variant(label=one.label, config=config, photos=own, eval_views=eval_views)
            for one, config, own in zip(variants, configs, photos, strict=True)
        ],
    )


def _check_different(labels: Sequence[str], options: Sequence[object]) -> None:
    """Raise if two variants are the same training, whose difference would be noise."""
    for place, one in enumerate(options):
        first = options.index(one)
        if first < place:
            raise ConfigError(
                f"`--compare {labels[place]}` changes nothing: it is the same as {labels[first]}."
            )


def _held_out(data: DataConfig, offset: int) -> DataConfig:
    if data.test_list is not None or data.test_first or data.test_last:
        raise ConfigError(
            "This bench selects test views by `--offsets`; leave out other options that select "
            "test views."
        )
    return replace(data, eval=True, test_offset=offset)
