"""`gscore depth`: predict depth maps of a capture, align them with its points, show them."""

import argparse
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..config import DataConfig, Switch
from ..control import Control
from ..datasets import Dataset, load_dataset
from ..depth.align import align_official, reliable
from ..depth.catalogue import all_networks, known, network_names
from ..depth.fit import NO_FIT, Fit, median_scale
from ..depth.fitting import Alignment, align_views, robust, settled_kind
from ..depth.hub import cached_file, network_file, terms
from ..depth.maps import SHEET, DepthKind, MapFolder, read_map, stem, to_inverse
from ..depth.network import WHERE, Network, Normalization
from ..depth.observations import Observations, observations
from ..depth.params import params_path, read_params, write_params
from ..depth.predict import Prediction, predict_views
from ..depth.priors import fit_table
from ..depth.samples import Samples, unusable, view_samples
from ..depth.sheet import write_sheet
from ..errors import BackendError, Cancelled, ConfigError, FormatError
from ..events import DepthDone, DepthProgress, Saved, Show, Warn
from ..extras import need
from ..io.places import check_place
from ..report.colormap import colorize
from ..shown import shown
from ..stereo import files, stereo_maps
from ..trainer.depth.rule import coverage, decide
from ..words import count_words, size_words
from .given.data_options import with_data_options
from .given.depth_options import add_arguments as add_arguments
from .terminal.attend import attend
from .terminal.output import check_folder, check_replaced, print_json
from .terminal.status import wrapped

_MAKE = f"make them with --method stereo, which needs none, or with --model FILE.onnx. {WHERE}."
"""Ends a sentence that says that maps and a network are missing."""


@dataclass(frozen=True, kw_only=True)
class _Result:
    """What came out."""

    done: DepthDone
    alignment: Alignment
    network: Network | None
    used: str
    """What the network was taken for, in words; empty: there is none."""
    warnings: list[str]
    shown: int
    """Views on the contact sheet."""


def run(args: argparse.Namespace) -> int:
    """Predict, align, write depth_params.json and the contact sheet; or check and write nothing."""
    if args.list_models:
        return _list_models(args)
    if args.source is None:
        raise ConfigError("Say which capture: gscore depth CAPTURE --model NETWORK.")
    if args.download and (args.model is None or known(args.model) is None):
        raise ConfigError(f"--download needs a --model with a name: {', '.join(network_names())}.")
    if args.input_size < 0:
        raise ConfigError(f"--input-size is {args.input_size}, expected a positive number.")
    if args.check and (args.model is not None or args.overwrite):
        raise ConfigError("--check writes nothing; leave --model and --overwrite out.")
    if args.method == "stereo":
        _check_stereo(args)
    elif args.method == "network" and args.model is None:
        raise ConfigError(f"--method network takes a network: --model FILE.onnx. {WHERE}.")
    told = _Told()
    result, code = attend(
        args, lambda show, control: _work(args, show, control, told), stopped=told
    )
    if result is None:
        return code
    if args.json:
        print_json(_facts(args, result))
    elif not (args.events or args.quiet):
        _print(args, result)
    return code


def _check_stereo(args: argparse.Namespace) -> None:
    """Raise ConfigError for options of other methods."""
    given = {
        "--model": args.model is not None,
        "--check": args.check,
        "--align official": args.align == "official",
        "--input-size": args.input_size > 0,
    }
    for flag in (flag for flag, is_given in given.items() if is_given):
        raise ConfigError(
            f"--method stereo and {flag} exclude each other: its maps are made without a network, "
            "and have the scale of the capture."
        )


def _work(args: argparse.Namespace, show: Show, control: Control, told: "_Told") -> _Result:
    """Everything after the options; `told` hears how far it is."""
    show(DepthProgress(done=0, total=0, view="", eta_s=float("nan"), phase="reading"))
    network = None
    if args.model is not None:
        need("onnxruntime", "Predicting depth")
        path, normalization = _network_of(args, show)
        network = Network(
            path,
            normalization=normalization,
            size=args.input_size,
            threads=args.threads,
        )
    config = with_data_options(DataConfig(source=args.source, resolution=1), args)
    dataset = load_dataset(config)
    folder = dataset.source / args.depths
    check_place(folder, config, depths=False)
    if args.method == "stereo":
        return _by_stereo(args, config, dataset, folder, show, control, told)
    if network is None and not folder.is_dir():
        raise ConfigError(
            f"There is no folder {folder} with depth maps to align, and no network to make them: "
            f"{_MAKE}"
        )
    if not args.check:
        check_folder(folder)
        check_replaced([folder / SHEET], overwrite=args.overwrite)
        _check_scales(params_path(dataset.source, folder, writing=True), args.overwrite, show)
    seen = observations(config, dataset)
    prediction = None
    if network is not None:
        using = f"predicting with {_network_words(network, dataset)}"
        show(DepthProgress(done=0, total=len(dataset), view="", eta_s=float("nan"), phase=using))
        prediction = predict_views(
            network,
            dataset,
            seen,
            folder,
            kind=args.kind,
            overwrite=args.overwrite,
            on_view=_Progress(show, control, told, "predicting"),
            cancelled=lambda: control.stopping,
        )
    progress = _Progress(show, control, told, "aligning")
    return _finish(args, config, dataset, seen, folder, network, prediction, show, progress)


def _by_stereo(
    args: argparse.Namespace,
    config: DataConfig,
    dataset: Dataset,
    folder: Path,
    show: Show,
    control: Control,
    told: "_Told",
) -> _Result:
    """Maps of the views that are not held out, from each other, in the scale of the capture."""
    check_folder(folder)
    check_replaced([folder / SHEET], overwrite=args.overwrite)
    files.check_maps_folder(folder, dataset.names, overwrite=args.overwrite)
    path = params_path(dataset.source, folder, writing=True)
    _check_scales(path, args.overwrite, show)
    progress = _Progress(show, control, told, "comparing photos")
    dataset.keep_few()
    found = stereo_maps(
        dataset,
        dataset.train,
        threads=args.threads,
        on_view=lambda done, total: progress(done, total, dataset.names[dataset.train[done - 1]]),
    )
    if found.reason:
        raise ConfigError(f"Stereo finds no depth in {dataset.source}: {found.reason}.")
    fits = files.write_maps(found, dataset, dataset.train, folder)
    write_params(path, fits, DepthKind.INVERSE)
    return _finish(
        args,
        replace(config, depth_align="official"),
        dataset,
        observations(config, dataset),
        folder,
        None,
        Prediction(written=[dataset.names[i] for i in found.maps], kept=[], kind=DepthKind.INVERSE),
        show,
        _Progress(show, control, told, "aligning"),
    )


def _network_of(args: argparse.Namespace, show: Show) -> tuple[Path, Normalization]:
    """The file of --model and how its photos are to be turned into numbers."""
    entry = known(args.model)
    path = Path(args.model)
    if entry is None or path.is_file():
        if entry is None and not path.suffix:
            raise ConfigError(
                f"There is no model {shown(path)}: give an ONNX file, or one of "
                f"{', '.join(network_names())}."
            )
        return path, args.normalization
    if args.download and cached_file(entry) is None:
        phase = f"downloading {entry.name}: {terms(entry)}"
        show(DepthProgress(done=0, total=0, view="", eta_s=float("nan"), phase=phase))
    found = network_file(entry, download=args.download)
    auto = args.normalization is Normalization.AUTO
    return found, entry.normalization if auto else args.normalization


def _list_models(args: argparse.Namespace) -> int:
    """The networks that have a name."""
    rows = []
    for network in all_networks():
        try:
            here = cached_file(network)
        except BackendError:  # nothing can have been downloaded through the hub's library
            here = None
        rows.append(
            {
                "name": network.name,
                "bytes": network.bytes,
                "licence": network.licence,
                "input": network.input,
                "kind": network.kind.value,
                "page": network.page,
                "source": network.source,
                "file": None if here is None else str(here),
            }
        )
    if args.json:
        print_json({"models": rows})
        return 0
    for row in rows:
        here = "on this machine" if row["file"] else f"{size_words(row['bytes'])} to download"
        print(f"{row['name']}  ({here}; licence {row['licence']}; input {row['input']})")
        print(f"    {row['page']}, weights of {row['source']}")
    return 0


def _check_scales(path: Path, overwrite: bool, show: Show) -> None:
    """Look at the scales that would be replaced: those of another program, or typed by hand, may be
    exact, which what the points tell never is.

    Raises:
        ConfigError: gscore did not write them, and they are not to be overwritten.
        DatasetError: the file has another layout.
    """
    if not path.is_file():
        return
    try:
        # Only gscore states how many points it compared.
        ours = all(entry.points is not None for entry in read_params(path).values())
    except FormatError as error:
        show(Warn(message=f"{error} It is replaced now."))
        return
    if ours:
        return
    if not overwrite:
        raise ConfigError(
            f"{path} was not written by gscore depth, so its scales stay as they are. --check says "
            "what a training makes of them, --overwrite replaces them."
        )
    show(Warn(message=f"The scales in {path}, which gscore had not written, are replaced."))


def _finish(
    args: argparse.Namespace,
    config: DataConfig,
    dataset: Dataset,
    seen: list[Observations],
    folder: Path,
    network: Network | None,
    prediction: Prediction | None,
    show: Show,
    progress: "_Progress",
) -> _Result:
    """Align the maps that are there and write what came out."""
    found = MapFolder(folder)
    maps = [found.find(name) for name in dataset.names]
    if not any(maps):
        raise ConfigError(
            f"{folder} has no depth map of any view ({count_words(len(found), 'map')} there), and "
            f"no network to make them: {_MAKE}"
        )
    # Maps that were predicted hold inverse depth, whatever the network gave.
    kind = DepthKind.INVERSE if prediction is not None else args.kind
    samples = view_samples(
        maps, seen, dataset, on_view=lambda i: progress(i + 1, len(maps), dataset.names[i])
    )
    path = sheet = None
    shown = 0
    if args.check:
        alignment = align_views(config, dataset, folder, samples, kind=kind)
        alignment = replace(alignment, warnings=(*unusable(samples), *alignment.warnings))
    else:
        if args.method == "stereo":  # placed already; the points say how well
            alignment = align_views(config, dataset, folder, samples, kind=kind, together=False)
            fits = _by_stem(dataset, alignment.fits)
        else:
            official = args.align == "official"
            alignment, fits = _align(dataset, maps, seen, samples, kind, official=official)
        path, sheet = params_path(dataset.source, folder, writing=True), folder / SHEET
        write_params(path, fits, alignment.kind)
        show(Saved(step=0, path=str(path)))
        shown = write_sheet(sheet, dataset, maps, alignment.fits, alignment.kind, colorize)
        show(Saved(step=0, path=str(sheet)))
    warnings = [*dataset.warnings, *alignment.warnings]
    for sentence in warnings:
        show(Warn(message=sentence))
    table = fit_table(dataset.names, maps, alignment)
    done = DepthDone(
        views=len(dataset),
        accepted=sum(row["accepted"] for row in table),
        predicted=len(prediction.written) if prediction else 0,
        kept=len(prediction.kept) if prediction else 0,
        folder=str(folder),
        params=str(path or ""),
        sheet=str(sheet or ""),
        table=table,
        why=_why(dataset, samples),
    )
    show(done)
    return _Result(
        done=done,
        alignment=alignment,
        network=network,
        used=_network_words(network, dataset) if network else "",
        warnings=warnings,
        shown=shown,
    )


def _why(dataset: Dataset, samples: list[Samples | None]) -> str:
    """What the automatic rule of a training on all views says of these maps."""
    usable = sum(part is not None and not part.trouble for part in samples)
    facts = coverage(dataset.scene, range(len(dataset)))
    return decide(Switch.AUTO, facts, usable=usable)[1]


def _align(
    dataset: Dataset,
    maps: list[Path | None],
    seen: list[Observations],
    samples: list[Samples | None],
    kind: DepthKind,
    *,
    official: bool,
) -> tuple[Alignment, dict[str, Fit]]:
    """The alignment, and the fits to write: official tools judge reliability when they read."""
    found, warnings = settled_kind(kind, samples, dataset)
    warnings = (*unusable(samples), *warnings)
    if not official:
        alignment = robust(samples, found, dataset, warnings)
        return alignment, _by_stem(dataset, alignment.fits)
    fits: list[Fit | None] = []
    for path, part, view in zip(maps, samples, seen, strict=True):
        if path is None or part is None:
            fits.append(None)
            continue
        if part.trouble:
            fits.append(NO_FIT.refused(part.trouble))
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
        inliers = f"{row['inliers']:.0%}" if row["points"] else "-"  # of none there is no share
        scale, offset = "-", "-"
        if row["map"]:
            scale, offset = f"{row['scale']:.4g}", f"{row['offset']:.3g}"
        lines.append(
            f"{row['view']:{width}}  {row['points']:6}  {inliers:>7}  {scale:>8}  {offset:>8}  "
            f"{error:>6}  {row['reason']}"
        )
    return "\n".join(line.rstrip() for line in lines)


def _facts(args: argparse.Namespace, result: _Result) -> dict[str, Any]:
    done = result.done
    return {
        "views": done.views,
        "predicted": done.predicted,
        "kept": done.kept,
        "accepted": done.accepted,
        "align": _rule(args),
        "kind": result.alignment.kind.value,
        "folder": done.folder,
        "params": done.params or None,
        "sheet": done.sheet or None,
        "model": _model_facts(result.network) if result.network else None,
        "why": done.why,
        "table": done.table,
        "warnings": result.warnings,
    }


def _rule(args: argparse.Namespace) -> str:
    """The rule by which maps got their scale."""
    if args.method == "stereo":
        return "stereo"
    return "auto" if args.check else args.align


def _print(args: argparse.Namespace, result: _Result) -> None:
    done = result.done
    what = "depth" if result.alignment.kind is DepthKind.DEPTH else "inverse depth"
    lines = [_table_text(done.table)]
    if result.used:
        lines.append(f"Predicted with {result.used}.")
    count = f"{done.accepted} of {sum(1 for row in done.table if row['map'])} maps of {what}"
    if args.check:
        lines.append(f"{count} would be used with their scale; nothing was written")
    else:
        rule = (
            "placed by stereo" if args.method == "stereo" else f"aligned by the {args.align} rule"
        )
        lines.append(f"{count} {rule}: {done.params}")
        if not any(row["points"] for row in done.table):
            lines.append(
                "The capture has no points where these maps state depths, so nothing but the "
                "photos says how good they are."
            )
        lines.append(f"{count_words(result.shown, 'view')} on {done.sheet}")
    print(wrapped("\n".join([*lines, done.why]), sys.stdout))


def _network_words(network: Network, dataset: Dataset) -> str:
    profile = network.profile
    width, height = network.input_size(*dataset.files[0].photo_size)
    return (
        f"{network.path.name}, taken for {profile.family}: input {width} x {height} px, "
        f"normalization {profile.normalization}"
    )


class _Told:
    """How far the work was when it was stopped, as a sentence."""

    def __init__(self) -> None:
        self.predicted = 0

    def __call__(self) -> str:
        return (
            f"Stopped after {count_words(self.predicted, 'view')}; the maps written so far are "
            "whole. Run the same command again to go on."
        )


class _Progress:
    """Tells after each view how far a phase is, and ends it where that was asked for."""

    def __init__(self, show: Show, control: Control, told: _Told, phase: str) -> None:
        self._show, self._control, self._told, self._phase = show, control, told, phase
        self._start = time.monotonic()

    def __call__(self, done: int, total: int, name: str) -> None:
        if self._phase == "predicting":
            self._told.predicted = done
        elif self._control.stopping:
            raise Cancelled(f"Depth was stopped while {self._phase}.")
        left = (time.monotonic() - self._start) / done * (total - done)
        self._show(DepthProgress(done=done, total=total, view=name, eta_s=left, phase=self._phase))
