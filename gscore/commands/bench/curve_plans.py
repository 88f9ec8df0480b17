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
from ...config_file import from_dict, to_dict
from ...datasets import Dataset
from ...errors import ConfigError
from ...json_text import parse_json
from ...shown import quoted
from ...trainer.files.checkpoint import FREE
from .sweeps import SizesPlan, plan_sizes
from .training_options import training_configs

_NOT_HERE = ("seed", "start_opacity", *sorted(FREE - {"iterations"}))
"""Options that the bench sets otherwise, or that change nothing in a training from points."""


@dataclass(frozen=True, kw_only=True)
class CapturePlan:
    """What is trained and shown of one capture."""

    name: str
    variants: list[Variant]
    judged: Dataset
    """What all variants are measured on."""
    peers: list[Curve]
    sizes: SizesPlan | None


def plans_of(args: argparse.Namespace) -> list[CapturePlan]:
    """One a capture; no photo is decoded yet.

    Raises:
        GsError: a capture, a name, a seed, an ablation or a file of peers that cannot be used.
    """
    ablations = list(dict.fromkeys(args.ablations))
    peers = {path: read_peers(path) for path in args.peers}
    sources: dict[str, Path] = {}
    for source in args.sources:
        name = source.resolve().name
        if name in sources:
            raise ConfigError(
                f"Two captures are called {quoted(name)}; give each a name of its own."
            )
        sources[name] = source
    for path, (capture, _) in peers.items():
        if capture not in sources:
            raise ConfigError(
                f"{path} holds curves of the capture {quoted(capture)}, which is not measured "
                f"here; there are: {', '.join(sources)}."
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
            CapturePlan(name=name, variants=variants, judged=judged, peers=of_others, sizes=sizes)
        )
    return plans


def _changed(
    config: TrainConfig, ablations: list[str], seeds: list[int]
) -> Iterator[tuple[str, TrainConfig]]:
    """`config` as it is and with each ablation, with their labels."""
    for seed in seeds:
        replace(config, seed=seed)  # which refuses bad ones
    yield "", config
    for ablation in ablations:
        parts, changed = ablation.split(","), config
        for part in parts:
            changed = _ablated(changed, part)
        yield ", ".join(f"without {p}" if p in tuple(Skip) else p for p in parts), changed


def _ablated(config: TrainConfig, name: str) -> TrainConfig:
    """`config` with one change: a strategy, a skip switched off, or OPTION=VALUE."""
    if name in tuple(Strategy):
        return replace(config, strategy=Strategy(name))
    if name in tuple(Skip):
        return replace(config, without=(*config.without, Skip(name)))
    option, equals, value = name.partition("=")
    option = option.replace("-", "_")
    if not equals or option in _NOT_HERE or option.startswith("depth_"):
        known = ", ".join((*Strategy, *Skip))
        raise ConfigError(
            f"There is no ablation {quoted(name)}; there are: {known}, and OPTION=VALUE for "
            "options of gscore.TrainConfig that change how a training without depth maps learns."
        )
    values = to_dict(config) | {option: _value(value, getattr(config, option, None))}
    return from_dict(TrainConfig, values, where=f"--ablations {name}")


def _value(text: str, now: Any) -> Any:
    """What `text` says, for an option that has the value `now`."""
    if isinstance(now, bool) and text in ("on", "off"):
        return text == "on"
    try:
        return parse_json(text)
    except ValueError:
        return text
