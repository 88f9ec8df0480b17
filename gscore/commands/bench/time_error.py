"""`gscore bench time-error`: held-out error over training time in seconds."""

import argparse
import math
import statistics
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ...bench.time_error import (
    Curve,
    curve_json,
    labels,
    measure_variant,
    read_peers,
    time_to_psnr,
)
from ...bench.training import first_size, open_variants
from ...config import Skip, TrainConfig
from ...errors import ConfigError
from ...io.files import atomic_write
from ...presets import RECIPES
from ...quoting import quoted
from ...raster import native_library
from ...report.curves import Series
from ...report.figure import figure
from ...text_format import markdown_table
from ..args.device_option import device_of
from ..parser import add_option
from ..terminal.output import check_replaced
from ..terminal.status import Status
from .shared import (
    Cell,
    ResultsFile,
    Ticker,
    add_training_options,
    changed,
    check_bench,
    named_sources,
    train_cells,
    training_configs,
)
from .sweeps import add_sweep_options, check_sweeps, plan_sizes, sizes_file, train_sizes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    option = partial(add_option, parser)
    option("sources SOURCE...", "captures", Path)
    option("-o, --output OUTPUT", "folder for the results", Path, required=True)
    option("--overwrite", "replace a results.json and figures that gscore did not write")
    option("--presets...", choices=tuple(RECIPES), default=["preview"])
    option(
        "--ablations NAME*",
        "also train each preset with this change: a strategy (mcmc), a disabled skip ("
        + ", ".join(Skip)
        + "), an option of gscore.TrainConfig (free-space=0), or several with commas",
        default=(),
    )
    option("--seeds SEEDS...", kind=int, default=[0, 1, 2])
    option("--peers FILE.json*", "curves of other programs, see docs/metrics.md", Path, default=())
    add_sweep_options(parser)
    add_training_options(parser)


def run(args: argparse.Namespace) -> int:
    """Train all variants of all captures; write results.json and figures by capture and metric."""
    check_sweeps(args)
    check_bench(args)
    cells = deque(_cells(args))
    written = [args.output / "results.json"]
    for cell in cells:
        written += [*figure_files(args.output, cell.capture), sizes_file(args.output, cell.capture)]
    check_replaced(written, overwrite=args.overwrite)
    threads = args.threads or native_library.default_threads()
    device = device_of(args)
    results = ResultsFile(args.output, device, threads=threads, seeds=args.seeds, captures={})
    train_cells(cells, lambda cell, status: _measure(args, cell, results, status))
    results.write(finished=True)
    if args.json:
        print(results.text())
    return 0


def _measure(args: argparse.Namespace, cell: Cell, results: ResultsFile, status: Status) -> None:
    ticker, eval_views = Ticker(cell.capture, status), cell.variants[0].eval_views
    content: dict[str, Any] = {
        "judged_on": first_size(eval_views),
        "held_out": [eval_views.names[index] for index in eval_views.test],
    }

    def write(**found: Any) -> None:
        content.update(found)
        results.write(captures=results.content["captures"] | {cell.capture: content})

    curves: list[Curve] = []
    for variant in cell.variants:
        curves.append(measure_variant(variant, args.seeds, on_step=ticker))
        known = [*curves, *cell.peers]
        write(curves=[curve_json(one) for one in known], time_to_psnr=time_to_psnr(known))
        _print(args, cell.capture, curves[-1])
    curves += cell.peers
    write_curves(args.output, cell.capture, curves)
    if not args.json:
        print(table(cell.capture, curves), flush=True)
    if cell.sizes:
        train_sizes(args, cell, on_step=ticker, on_found=lambda found: write(sizes=found))


def _print(args: argparse.Namespace, capture: str, curve: Curve) -> None:
    if not args.json:
        ends = [points[-1] for points in curve.seeds]
        psnr = [end.psnr for end in ends]
        print(
            f"{capture}, {curve.label}: {statistics.median(e.seconds for e in ends):.1f} s, "
            f"PSNR {statistics.median(psnr):.2f} ({min(psnr):.2f} to {max(psnr):.2f}) dB, "
            f"SSIM {statistics.median(e.ssim for e in ends):.4f}",
            flush=True,
        )


def _cells(args: argparse.Namespace) -> list[Cell]:
    """One cell per capture; no photo is decoded yet.

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
    cells = []
    for name, source in sources.items():
        presets = [(p, *training_configs(args, source, p)) for p in dict.fromkeys(args.presets)]
        options = [
            (f"{preset} {label}".strip(), data, one)
            for preset, data, config in presets
            for label, one in _changed(config, ablations, args.seeds)
        ]
        cells.append(
            Cell(
                capture=name,
                variants=open_variants(options),
                sizes=plan_sizes(args, presets),
                peers=[c for capture, found in peers.values() if capture == name for c in found],
            )
        )
    return cells


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


_PSNR, _SSIM, _SPLATS = "psnr", "1-ssim", "splats"


def figure_files(output: Path, name: str) -> list[Path]:
    """Files written by `write_curves`."""
    return [_file(output, name, key) for key in (_PSNR, _SSIM, _SPLATS)]


def write_curves(output: Path, name: str, curves: list[Curve]) -> None:
    """Write PSNR and 1 - SSIM over time, and PSNR over splats, of the capture `name`."""
    medians = [(label, c.median()) for label, c in zip(labels(curves), curves, strict=True)]
    pictures = {
        _PSNR: ("PSNR, dB", lambda p: p.psnr, False),
        _SSIM: ("1 - SSIM", lambda p: 1 - p.ssim, True),
    }
    for key, (label, value, log_y) in pictures.items():
        series = [
            Series(
                label=one,
                points=[(p.seconds, value(p)) for p in points if math.isfinite(value(p))],
                dots=True,
            )
            for one, points in medians
        ]
        series = [s for s in series if s.points]
        if not series:
            continue
        text = figure(
            series,
            title=f"{name}: held-out {label.split(',')[0]} over training time",
            x_label="seconds in training steps",
            y_label=label,
            log_x=True,
            log_y=log_y,
        )
        atomic_write(_file(output, name, key), text.encode())
    ends = [
        Series(
            label=f"{curve.label}, {curve.width} px", points=[(p[-1].splats, p[-1].psnr)], dots=True
        )
        for curve, (_, p) in zip(curves, medians, strict=True)
        if p[-1].splats and math.isfinite(p[-1].psnr)
    ]
    if ends:
        text = figure(
            ends,
            title=f"{name}: PSNR over number of splats at the end",
            x_label="splats",
            y_label="PSNR, dB",
            log_x=True,
        )
        atomic_write(_file(output, name, _SPLATS), text.encode())


def table(name: str, curves: list[Curve]) -> str:
    """Seconds to PSNR levels of each curve in Markdown, one table per picture width."""
    rows = time_to_psnr(curves)
    widths = list(dict.fromkeys(row["width"] for row in rows))
    tables = []
    for width in widths:
        own = [row for row in rows if row["width"] == width]
        head = name if len(widths) == 1 else f"{name}, {width} px"
        aims = [f"s to {aim} dB" for aim in own[0]["seconds"]]
        rows_of_width = [
            [row["label"], f"{row['psnr']:.2f}"]
            + ["-" if s is None else f"{s:.1f}" for s in row["seconds"].values()]
            for row in own
        ]
        tables.append(markdown_table([head, "final PSNR", *aims], rows_of_width))
    return "\n\n".join(tables)


def _file(output: Path, name: str, key: str) -> Path:
    return output / f"{name}-{key}.svg"
