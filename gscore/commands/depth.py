"""`gscore depth`: predict depth maps of a capture, align them with its points, show them."""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

from ..config import DataConfig
from ..datasets import Dataset, load_dataset
from ..depth.align import align_official, reliable
from ..depth.fit import Fit, median_scale
from ..depth.fitting import Alignment, find_kind, robust, view_samples
from ..depth.maps import SHEET, DepthKind, MapFolder, read_map, stem, to_inverse
from ..depth.network import WHERE, Network, Normalization
from ..depth.observations import Observations, observations
from ..depth.params import DEFAULT_FOLDER, params_path, write_params
from ..depth.predict import Prediction, predict_views
from ..depth.priors import fit_table
from ..depth.sheet import write_sheet
from ..errors import Cancelled, ConfigError
from ..metrics.colormap import colorize
from .display import clock
from .interrupt import Interrupt
from .output import check_folder

_PERIOD = 5.0
"""Seconds between two lines of progress where stderr is not a terminal."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    parser.add_argument("source", type=Path, help="the capture: photos with a COLMAP model")
    parser.add_argument(
        "--model",
        type=Path,
        metavar="FILE.onnx",
        help="network to predict with; without one the maps that are there are aligned",
    )
    parser.add_argument(
        "-d",
        "--depths",
        default=DEFAULT_FOLDER,
        metavar="DIR",
        help="folder of the depth maps in SOURCE (depths)",
    )
    parser.add_argument(
        "--align",
        choices=("robust", "official"),
        default="robust",
        help="official: medians and mean absolute deviations, as the 3DGS tools",
    )
    parser.add_argument(
        "--kind",
        type=DepthKind,
        choices=tuple(DepthKind),
        default=DepthKind.AUTO,
        help="what the network or the maps hold; auto: the points tell",
    )
    parser.add_argument(
        "--normalization",
        type=Normalization,
        choices=tuple(Normalization),
        default=Normalization.AUTO,
        help="how the network wants its photos; auto: the file tells",
    )
    parser.add_argument(
        "--input-size",
        type=int,
        default=0,
        metavar="N",
        help="pixels of the shorter side of what the network sees, where it is free",
    )
    parser.add_argument("--overwrite", action="store_true", help="predict views that have a map")
    parser.add_argument("-i", "--images", default="images", help="folder of the photos in SOURCE")
    parser.add_argument("--masks", default="", metavar="DIR", help="folder of masks in SOURCE")
    parser.add_argument(
        "--mask-mode",
        choices=("auto", "composite", "ignore", "none"),
        default="auto",
        help="composite: what masks hide is left out of the maps",
    )
    parser.add_argument("--frame", type=int, metavar="N", help="frame of a multi-view video")
    parser.add_argument("--threads", type=int, default=0, help="0: all cores")
    parser.add_argument("--json", action="store_true", help="the results as JSON, last on stdout")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(args: argparse.Namespace) -> int:
    """Predict, align, write depth_params.json and the contact sheet."""
    if args.input_size < 0:
        raise ConfigError(f"--input-size is {args.input_size}, expected a positive number.")
    network = None
    if args.model is not None:
        network = Network(
            args.model,
            normalization=args.normalization,
            size=args.input_size,
            threads=args.threads,
        )
    config = DataConfig(
        source=args.source,
        images=args.images,
        masks=args.masks,
        mask_mode=args.mask_mode,
        depths=args.depths,
        frame=args.frame,
        resolution=1,
    )
    dataset = load_dataset(config)
    folder = dataset.source / args.depths
    if network is None and not folder.is_dir():
        raise ConfigError(
            f"There is no folder {folder} with depth maps to align, and no network to make them: "
            f"give one with --model FILE.onnx. {WHERE}."
        )
    check_folder(folder)
    seen = observations(config, dataset)
    prediction = None
    if network is not None:
        progress = _Progress(quiet=args.quiet)
        with Interrupt() as interrupt:
            try:
                prediction = _predict(network, dataset, seen, folder, args, progress, interrupt)
            except Cancelled:
                print(
                    f"Stopped after {progress.done} views; the maps written so far are whole. Run "
                    f"the same command again to go on.",
                    file=sys.stderr,
                )
                return interrupt.exit_code
    return _finish(args, config, dataset, seen, folder, network, prediction)


def _predict(
    network: Network,
    dataset: Dataset,
    seen: list[Observations],
    folder: Path,
    args: argparse.Namespace,
    progress: "_Progress",
    interrupt: Interrupt,
) -> Prediction:
    if not args.quiet:
        profile = network.profile
        size = network.input_size(*dataset.files[0].photo_size)
        print(
            f"{network.path.name}: taken for {profile.family}, input {size[0]} x {size[1]}, "
            f"normalization {profile.normalization}",
            file=sys.stderr,
        )
    return predict_views(
        network,
        dataset,
        seen,
        folder,
        kind=args.kind,
        overwrite=args.overwrite,
        on_view=progress,
        cancelled=lambda: interrupt.received,
    )


def _finish(
    args: argparse.Namespace,
    config: DataConfig,
    dataset: Dataset,
    seen: list[Observations],
    folder: Path,
    network: Network | None,
    prediction: Prediction | None,
) -> int:
    """Align the maps that are there, write what came out and say it."""
    found = MapFolder(folder)
    maps = [found.find(name) for name in dataset.names]
    if not any(maps):
        raise ConfigError(
            f"{folder} has no depth map of any view ({len(found)} maps there), and no network to "
            f"make them: give one with --model FILE.onnx. {WHERE}."
        )
    # Maps that were predicted hold inverse depth, whatever the network gave.
    kind = DepthKind.INVERSE if prediction is not None else args.kind
    alignment, fits = _align(dataset, maps, seen, kind, official=args.align == "official")
    path = params_path(dataset.source, folder, writing=True)
    write_params(path, fits, alignment.kind)
    sheet = folder / SHEET
    shown = write_sheet(sheet, dataset, maps, alignment.fits, alignment.kind, colorize)
    table = fit_table(dataset.names, maps, alignment)
    accepted = sum(row["accepted"] for row in table)
    warnings = [*dataset.warnings, *alignment.warnings]
    for sentence in warnings:
        print(f"Warning: {sentence}", file=sys.stderr)
    if args.json:
        result = {
            "views": len(dataset),
            "predicted": len(prediction.written) if prediction else 0,
            "kept": len(prediction.kept) if prediction else 0,
            "accepted": accepted,
            "align": args.align,
            "kind": alignment.kind.value,
            "folder": str(folder),
            "params": str(path),
            "sheet": str(sheet),
            "model": _model_facts(network) if network else None,
            "table": table,
            "warnings": warnings,
        }
        print(json.dumps(result, allow_nan=False))
        return 0
    what = "depth" if alignment.kind is DepthKind.DEPTH else "inverse depth"
    print(_table_text(table))
    print(
        f"{accepted} of {sum(1 for m in maps if m)} maps of {what} aligned by the {args.align} "
        f"rule: {path}"
    )
    print(f"{shown} views on {sheet}")
    return 0


def _align(
    dataset: Dataset,
    maps: list[Path | None],
    seen: list[Observations],
    kind: DepthKind,
    *,
    official: bool,
) -> tuple[Alignment, dict[str, Fit]]:
    """The alignment, and the fits to write: official tools judge reliability when they read."""
    samples = view_samples(maps, seen, dataset)
    found, warnings = find_kind(samples) if kind is DepthKind.AUTO else (kind, ())
    if not official:
        alignment = robust(samples, found, warnings)
        return alignment, _by_stem(dataset, alignment.fits)
    fits: list[Fit | None] = []
    for path, view in zip(maps, seen, strict=True):
        if path is None:
            fits.append(None)
            continue
        values = read_map(path)
        if found is DepthKind.DEPTH:
            values = to_inverse(values, found)
        values[values != values] = 0
        fits.append(align_official(values, view))
    median = median_scale([fit.scale for fit in fits if fit is not None])
    alignment = Alignment(fits=reliable(fits, median), kind=found, warnings=warnings)
    return alignment, _by_stem(dataset, fits)


def _by_stem(dataset: Dataset, fits: list[Fit | None]) -> dict[str, Fit]:
    pairs = zip(dataset.names, fits, strict=True)
    return {stem(name): fit for name, fit in pairs if fit is not None}


def _model_facts(network: Network) -> dict[str, Any]:
    profile = network.profile
    return {
        "file": str(network.path),
        "family": profile.family,
        "normalization": profile.normalization.value,
        "kind": profile.kind.value,
        "input_size": [profile.width, profile.height],
    }


def _table_text(table: list[dict[str, Any]]) -> str:
    width = max(len(row["view"]) for row in table)
    lines = [f"{'view':{width}}  points  inliers     scale    offset   error"]
    for row in table:
        error = "-" if row["error"] is None else f"{row['error']:.1%}"
        numbers = f"{row['points']:6}  {row['inliers']:7.0%}  {row['scale']:8.4g}"
        lines.append(
            f"{row['view']:{width}}  {numbers}  {row['offset']:8.3g}  {error:>6}  {row['reason']}"
        )
    return "\n".join(line.rstrip() for line in lines)


class _Progress:
    """A line that moves on a terminal, and a line every few seconds elsewhere."""

    def __init__(self, *, quiet: bool) -> None:
        self.done = 0
        self._quiet = quiet
        self._start = self._last = time.monotonic()

    def __call__(self, done: int, total: int, name: str) -> None:
        self.done = done
        now = time.monotonic()
        moving = sys.stderr.isatty()
        if self._quiet or not (moving or done == total or now - self._last > _PERIOD):
            return
        self._last = now
        left = (now - self._start) / done * (total - done)
        text = f"{done}/{total} {name}  {clock(left)} left"
        print(f"\r{text:60}" if moving else text, end="" if moving else "\n", file=sys.stderr)
        if moving and done == total:
            print(file=sys.stderr)
