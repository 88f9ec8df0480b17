"""Curves of `gscore bench time-error`: trainings, checked before the first; results.json."""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ..._version import __version__
from ...bench.time_error import Curve, Variant, curve_json, read_peers, time_to_psnr
from ...bench.training import first_size, open_sizes
from ...config import Skip, TrainConfig
from ...datasets import Dataset
from ...errors import ConfigError
from ...events import strict_json
from ...io.files import atomic_write
from ...metrics.machine import machine
from ...quoting import quoted
from ...raster import native_library
from .shared import changed, named_sources, training_configs
from .sweeps import SizesPlan, plan_sizes


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


class ResultsFile:
    """The results so far; docs/metrics.md describes the file."""

    def __init__(self, args: argparse.Namespace) -> None:
        self._path = args.output / "results.json"
        self._captures: dict[str, dict[str, Any]] = {}
        self._content = {
            "gscore": __version__,
            "finished": False,
            "machine": machine(),
            "isa": native_library.isa(),
            "threads": args.threads or native_library.default_threads(),
            "seeds": args.seeds,
            "captures": self._captures,
        }

    def add_curves(self, plan: CapturePlan, curves: Sequence[Curve]) -> None:
        """Store all curves of a capture so far."""
        eval_views = plan.eval_views
        self._captures[plan.name] = {
            "judged_on": first_size(eval_views),
            "held_out": [eval_views.names[index] for index in eval_views.test],
            "curves": [curve_json(curve) for curve in curves],
            "time_to_psnr": time_to_psnr(curves),
        }
        self._write()

    def add_sizes(self, plan: CapturePlan, found: dict[str, Any]) -> None:
        """Store all sizes of a capture so far."""
        self._captures[plan.name]["sizes"] = found
        self._write()

    def finish(self) -> None:
        """Mark the results as complete."""
        self._content["finished"] = True
        self._write()

    def text(self) -> str:
        """The content of the file."""
        return strict_json(self._content)

    def _write(self) -> None:
        atomic_write(self._path, self.text().encode())
