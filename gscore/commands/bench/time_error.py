"""`gscore bench time-error`: held-out error over seconds of training."""

import argparse
import json
import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...bench.time_error import (
    Curve,
    Variant,
    curve_json,
    measure_variant,
    read_curves,
    time_to_psnr,
)
from ...bench.training import load_for_bench
from ...config import PRESETS, Skip, Strategy
from ...errors import ConfigError
from ...io.files import atomic_write
from ...metrics.curves import Series
from ...metrics.figure import figure
from ...metrics.machine import machine
from ...raster import backend
from ..output import check_folder
from .sweeps import add_sweep_options, check_sweeps, sweep
from .training_options import add_training_options, training_configs


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("sources", nargs="+", type=Path, metavar="SOURCE", help="captures")
    parser.add_argument("-o", "--output", required=True, type=Path, help="folder for the results")
    parser.add_argument("--presets", nargs="+", choices=tuple(PRESETS), default=["preview"])
    parser.add_argument(
        "--ablations",
        nargs="*",
        default=(),
        metavar="NAME",
        help="also train each preset with this changed: a strategy (mcmc) or a skip switched off "
        "(" + ", ".join(Skip) + ")",
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument(
        "--peers", nargs="*", type=Path, default=(), metavar="FILE.json",
        help="curves of other programs, see docs/benchmarks.md",
    )  # fmt: skip
    add_sweep_options(parser)
    add_training_options(parser)


def run(args: argparse.Namespace) -> int:
    """Train all variants of all captures; write results.json and a figure a capture and metric."""
    check_sweeps(args)
    check_folder(args.output)
    ablations = [_ablation(name) for name in args.ablations]
    peers = [read_curves(path) for path in args.peers]
    captures: dict[str, Any] = {}
    for source in args.sources:
        name = source.resolve().name
        if name in captures:
            raise ConfigError(f"Two captures are called {name!r}; give each a name of its own.")
        curves: list[Curve] = []
        presets = [(preset, *training_configs(args, source, preset)) for preset in args.presets]
        for preset, data, config in presets:
            photos = load_for_bench(data)
            for label, change in [("", {}), *ablations]:
                variant = Variant(
                    label=f"{preset} {label}".strip(),
                    config=replace(config, **change),
                    photos=photos,
                )
                curve = measure_variant(variant, args.seeds, on_step=_Ticker(name))
                curves.append(curve)
                _say(args, name, curve)
        curves += [c for capture, found in peers if capture == name for c in found]
        captures[name] = {
            "curves": [curve_json(curve) for curve in curves],
            "time_to_psnr": time_to_psnr(curves),
        }
        _draw(args.output, name, curves)
        if not args.json:
            print(_table(name, curves), flush=True)
        sizes = sweep(args, name, presets, on_step=_Ticker(name))
        if sizes is not None:
            captures[name]["sizes"] = sizes
    content = {
        "machine": machine(),
        "isa": backend.isa(),
        "threads": args.threads or backend.default_threads(),
        "seeds": args.seeds,
        "captures": captures,
    }
    text = json.dumps(content)
    atomic_write(args.output / "results.json", text.encode())
    if args.json:
        print(text)
    return 0


def _ablation(name: str) -> tuple[str, dict[str, Any]]:
    if name in tuple(Strategy):
        return name, {"strategy": Strategy(name)}
    if name in tuple(Skip):
        return f"without {name}", {"without": (Skip(name),)}
    known = ", ".join((*Strategy, *Skip))
    raise ConfigError(f"There is no ablation {name!r}; there are: {known}.")


class _Ticker:
    """Says on stderr how far a training is, now and then."""

    def __init__(self, capture: str) -> None:
        self._capture = capture
        self._last = time.monotonic()

    def __call__(self, label: str, seed: int, step: int, iterations: int) -> None:
        if time.monotonic() - self._last > 10:
            self._last = time.monotonic()
            print(
                f"{self._capture}, {label}, seed {seed}: step {step} of {iterations}",
                file=sys.stderr,
                flush=True,
            )


def _say(args: argparse.Namespace, capture: str, curve: Curve) -> None:
    if not args.json:
        ends = [points[-1] for points in curve.seeds]
        psnr = [end.psnr for end in ends]
        print(
            f"{capture}, {curve.label}: {statistics.median(e.seconds for e in ends):.1f} s, "
            f"PSNR {statistics.median(psnr):.2f} ({min(psnr):.2f} to {max(psnr):.2f}) dB, "
            f"SSIM {statistics.median(e.ssim for e in ends):.4f}",
            flush=True,
        )


def _draw(output: Path, name: str, curves: list[Curve]) -> None:
    medians = [(curve.label, curve.median()) for curve in curves]
    pictures = {
        "psnr": ("PSNR, dB", lambda p: p.psnr, False),
        "1-ssim": ("1 - SSIM", lambda p: 1 - p.ssim, True),
    }
    for key, (label, value, log_y) in pictures.items():
        series = [
            Series(
                label=one,
                points=[(p.seconds, value(p)) for p in points if value(p) == value(p)],
                dots=True,
            )
            for one, points in medians
        ]
        text = figure(
            [s for s in series if s.points],
            title=f"{name}: held-out {label.split(',')[0]} over training time",
            x_label="seconds in training steps",
            y_label=label,
            log_x=True,
            log_y=log_y,
        )
        atomic_write(output / f"{name}-{key}.svg", text.encode())
    ends = [
        Series(
            label=f"{curve.label}, {curve.width} px", points=[(p[-1].splats, p[-1].psnr)], dots=True
        )
        for curve, (_, p) in zip(curves, medians, strict=True)
        if p[-1].splats
    ]
    if ends:
        text = figure(
            ends,
            title=f"{name}: PSNR over number of splats at the end",
            x_label="splats",
            y_label="PSNR, dB",
            log_x=True,
        )
        atomic_write(output / f"{name}-splats.svg", text.encode())


def _table(name: str, curves: list[Curve]) -> str:
    rows = time_to_psnr(curves)
    aims = list(rows[0]["seconds"])
    lines = [f"| {name} | final PSNR | " + " | ".join(f"s to {aim} dB" for aim in aims) + " |"]
    lines.append("|---|---|" + "---|" * len(aims))
    for row in rows:
        cells = ["-" if s is None else f"{s:.1f}" for s in row["seconds"].values()]
        lines.append(f"| {row['label']} | {row['psnr']:.2f} | " + " | ".join(cells) + " |")
    return "\n".join(lines)
