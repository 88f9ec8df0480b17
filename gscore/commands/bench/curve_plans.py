"""What `gscore bench time-error` is to train: looked up and checked before anything is trained."""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...bench.peers import read_peers
from ...bench.time_error import Curve, Variant
from ...bench.training import open_sizes
from ...config import Skip, Strategy, TrainConfig
from ...datasets import Dataset
from ...errors import ConfigError
from .sweeps import SizesPlan, plan_sizes
from .training_options import training_configs


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is trained and shown of one capture."""

    name: str
    variants: list[Variant]
    judged: Dataset
    """What all variants are measured on."""
    peers: list[Curve]
    sizes: SizesPlan | None


def plans_of(args: argparse.Namespace) -> list[Plan]:
    """One a capture; no photo is decoded yet.

    Raises:
        GsError: a capture, a name, a seed, an ablation or a file of peers that cannot be used.
    """
    ablations = [("", {}), *(_ablation(name) for name in dict.fromkeys(args.ablations))]
    peers = {path: read_peers(path) for path in args.peers}
    sources: dict[str, Path] = {}
    for source in args.sources:
        name = source.resolve().name
        if name in sources:
            raise ConfigError(f"Two captures are called {name!r}; give each a name of its own.")
        sources[name] = source
    for path, (capture, _) in peers.items():
        if capture not in sources:
            raise ConfigError(
                f"{path} holds curves of the capture {capture!r}, which is not measured here; "
                f"there are: {', '.join(sources)}."
            )
    plans = []
    for name, source in sources.items():
        presets = [(p, *training_configs(args, source, p)) for p in dict.fromkeys(args.presets)]
        photos, judged = open_sizes([data for _, data, _ in presets])
        variants = [
            Variant(label=f"{preset} {label}".strip(), config=one, photos=own, judged=judged)
            for (preset, _, config), own in zip(presets, photos, strict=True)
            for label, one in _changed(config, ablations, args.seeds)
        ]
        of_others = [c for capture, found in peers.values() if capture == name for c in found]
        sizes = plan_sizes(args, presets)
        plans.append(
            Plan(name=name, variants=variants, judged=judged, peers=of_others, sizes=sizes)
        )
    return plans


def _changed(
    config: TrainConfig, ablations: list[tuple[str, dict[str, Any]]], seeds: list[int]
) -> Iterator[tuple[str, TrainConfig]]:
    for seed in seeds:
        replace(config, seed=seed)  # which refuses bad ones
    for label, change in ablations:
        yield label, replace(config, **change)


def _ablation(name: str) -> tuple[str, dict[str, Any]]:
    if name in tuple(Strategy):
        return name, {"strategy": Strategy(name)}
    if name in tuple(Skip):
        return f"without {name}", {"without": (Skip(name),)}
    known = ", ".join((*Strategy, *Skip))
    raise ConfigError(f"There is no ablation {name!r}; there are: {known}.")
