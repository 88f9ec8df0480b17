"""Plan of the curves of `gscore bench time-error`: trainings, checked before the first one."""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

from ...bench.time_error import Curve, Variant, read_peers
from ...bench.training import open_sizes
from ...config import Skip, TrainConfig
from ...datasets import Dataset
from ...errors import ConfigError
from ...quoting import quoted
from .config_changes import changed
from .sweeps import SizesPlan, plan_sizes
from .training_options import named_sources, training_configs


@dataclass(frozen=True, kw_only=True)
class CapturePlan:
    """The trainings and curves of one capture."""

    name: str
    variants: list[Variant]
    eval_views: Dataset
    """The photos that all variants are measured on."""
    peers: list[Curve]
    sizes: SizesPlan | None


def plans_of(args: argparse.Namespace) -> list[CapturePlan]:
    """One plan per capture; no photo is decoded yet.

    Raises:
        GsError: an invalid capture, name, seed, ablation or file of peers.
    """
    ablations = list(dict.fromkeys(args.ablations))
    peers = {path: read_peers(path) for path in args.peers}
    sources = named_sources(args.sources)
    for path, (capture, _) in peers.items():
        if capture not in sources:
            raise ConfigError(
                f"{path} contains curves of the capture {quoted(capture)}, which is not measured "
                f"here; there are: {', '.join(sources)}."
            )
    plans = []
    for name, source in sources.items():
        presets = [(p, *training_configs(args, source, p)) for p in dict.fromkeys(args.presets)]
        photos, eval_views = open_sizes([data for _, data, _ in presets])
        variants = [
            Variant(
                label=f"{preset} {label}".strip(), config=one, photos=own, eval_views=eval_views
            )
            for (preset, _, config), own in zip(presets, photos, strict=True)
            for label, one in _changed(config, ablations, args.seeds)
        ]
        of_others = [c for capture, found in peers.values() if capture == name for c in found]
        sizes = plan_sizes(args, presets)
        plans.append(
            CapturePlan(
                name=name, variants=variants, eval_views=eval_views, peers=of_others, sizes=sizes
            )
        )
    return plans


def _changed(
    config: TrainConfig, ablations: list[str], seeds: list[int]
) -> Iterator[tuple[str, TrainConfig]]:
    """`config` unchanged and with each ablation, with labels."""
    for seed in seeds:
        replace(config, seed=seed)  # raises for invalid seeds
    yield "", config
    for ablation in ablations:
        parts = ablation.split(",")
        label = ", ".join(f"without {p}" if p in tuple(Skip) else p for p in parts)
        yield label, changed(config, parts, flag="--ablations")
