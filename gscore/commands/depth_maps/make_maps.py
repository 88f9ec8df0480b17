"""Depth map production: a network by name or file, or stereo; alignment, output files."""

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

from ...config import DataConfig, Switch
from ...control import Control
from ...datasets import Dataset, load_dataset
from ...depth.align import align_official, reliable
from ...depth.catalogue import all_networks, known, network_names
from ...depth.fit import NO_FIT, Fit, median_scale
from ...depth.fitting import Alignment, align_views, resolved_kind, robust
from ...depth.hub import cached_file, network_file, terms
from ...depth.maps import SHEET, DepthKind, MapFolder, read_map, stem, to_inverse
from ...depth.network import NETWORK_HINT, Network, Normalization
from ...depth.observations import Observations, observations
from ...depth.params import params_path, read_params, write_params
from ...depth.predict import Prediction, predict_views
from ...depth.priors import fit_table
from ...depth.samples import Samples, unusable, view_samples
from ...depth.sheet import write_sheet
from ...errors import BackendError, Cancelled, ConfigError, FormatError
from ...events import DepthDone, DepthProgress, Saved, Show, Warn, seconds_left
from ...extras import need
from ...io.output_paths import check_output_path
from ...quoting import brief
from ...report.colormap import colorize
from ...stereo import files, stereo_maps
from ...text_format import count_text, size_text
from ...trainer.depth.rule import coverage, decide
from ..args.data_options import with_data_options
from ..terminal.output import check_folder, check_replaced, print_json

_MAKE = f"use `--method stereo`, which needs no network, or `--model FILE.onnx`. {NETWORK_HINT}."
"""Remedy for missing maps without a network."""


@dataclass(frozen=True, kw_only=True)
class DepthResult:
    """Result of `make_maps`."""

    done: DepthDone
    alignment: Alignment
    network: Network | None
    used: str
    """Description of the network and its detected family; empty: no network."""
    warnings: list[str]
    shown: int
    """Views on the contact sheet."""


def make_maps(
    args: argparse.Namespace, show: Show, control: Control, message: "StopMessage"
) -> DepthResult:
    """Make, align and write maps as the options request; `message` receives the progress.

    Raises:
        GsError: an input is unusable, or a file would be replaced.
    """
    show(DepthProgress(done=0, total=0, view="", eta_s=float("nan"), phase="reading"))
    network = None
    if args.model is not None:
        need("onnxruntime", "Predicting depth")
        path, normalization = network_path(args, show)
        network = Network(
            path,
            normalization=normalization,
            size=args.input_size,
            threads=args.threads,
        )
    config = with_data_options(DataConfig(source=args.source, resolution=1), args)
    dataset = load_dataset(config)
    folder = dataset.source / args.depths
    check_output_path(folder, config, depths=False)
    if args.method == "stereo":
        return _by_stereo(args, config, dataset, folder, show, control, message)
    if network is None and not folder.is_dir():
        raise ConfigError(
            f"There is no folder {folder} with depth maps to align, and no network to predict "
            f"them: {_MAKE}"
        )
    if not args.check:
        check_folder(folder)
        check_replaced([folder / SHEET], overwrite=args.overwrite)
        _check_scales(params_path(dataset.source, folder, writing=True), args.overwrite, show)
    observed = observations(config, dataset)
    prediction = None
    if network is not None:
        using = f"predicting with {network_text(network, dataset)}"
        show(DepthProgress(done=0, total=len(dataset), view="", eta_s=float("nan"), phase=using))
        prediction = predict_views(
            network,
            dataset,
            observed,
            folder,
            kind=args.kind,
            overwrite=args.overwrite,
            on_view=_Progress(show, control, message, "predicting"),
            cancelled=lambda: control.stopping,
        )
    progress = _Progress(show, control, message, "aligning")
    return _finish(args, config, dataset, observed, folder, network, prediction, show, progress)


def _by_stereo(
    args: argparse.Namespace,
    config: DataConfig,
    dataset: Dataset,
    folder: Path,
    show: Show,
    control: Control,
    message: "StopMessage",
) -> DepthResult:
    """Maps of the training views by stereo, in the scale of the capture."""
    check_folder(folder)
    check_replaced([folder / SHEET], overwrite=args.overwrite)
    files.check_maps_folder(folder, dataset.names, overwrite=args.overwrite)
    path = params_path(dataset.source, folder, writing=True)
    _check_scales(path, args.overwrite, show)
    progress = _Progress(show, control, message, "comparing photos")
    dataset.limit_cache()
    found = stereo_maps(
        dataset,
        dataset.train,
        threads=args.threads,
        on_view=lambda done, total: progress(done, total, dataset.names[dataset.train[done - 1]]),
    )
    if found.reason:
        raise ConfigError(f"Stereo found no depth in {dataset.source}: {found.reason}.")
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
        _Progress(show, control, message, "aligning"),
    )


def _check_scales(path: Path, overwrite: bool, show: Show) -> None:
    """Check the scales that would be replaced: those of another program, or entered by hand, may be
    exact, unlike a fit to the points.

    Raises:
        ConfigError: gscore did not write them, and `overwrite` is off.
        DatasetError: the file has another layout.
    """
    if not path.is_file():
        return
    try:
        # Only gscore states the number of compared points.
        ours = all(entry.points is not None for entry in read_params(path).values())
    except FormatError as error:
        show(Warn(message=f"{error} The file is replaced."))
        return
    if ours:
        return
    if not overwrite:
        raise ConfigError(
            f"{path} was not written by gscore depth, so its scales are kept. `--check` shows how "
            "a training uses them, `--overwrite` replaces them."
        )
    show(Warn(message=f"The scales in {path}, written by another program, are replaced."))


def _finish(
    args: argparse.Namespace,
    config: DataConfig,
    dataset: Dataset,
    observed: list[Observations],
    folder: Path,
    network: Network | None,
    prediction: Prediction | None,
    show: Show,
    progress: "_Progress",
) -> DepthResult:
    """Align the existing maps and write the results."""
    found = MapFolder(folder)
    maps = [found.find(name) for name in dataset.names]
    if not any(maps):
        raise ConfigError(
            f"{folder} has no depth map of any view (it has {count_text(len(found), 'map')}), and "
            f"there is no network to predict them: {_MAKE}"
        )
    # Predicted maps contain inverse depth, also from networks with depth as output.
    kind = DepthKind.INVERSE if prediction is not None else args.kind
    samples = view_samples(
        maps, observed, dataset, on_view=lambda i: progress(i + 1, len(maps), dataset.names[i])
    )
    path = sheet = None
    shown = 0
    if args.check:
        alignment = align_views(config, dataset, folder, samples, kind=kind)
        alignment = replace(alignment, warnings=(*unusable(samples), *alignment.warnings))
    else:
        if args.method == "stereo":  # already in scale; the points measure the error
            alignment = align_views(config, dataset, folder, samples, kind=kind, joint=False)
            fits = _by_stem(dataset, alignment.fits)
        else:
            official = args.align == "official"
            alignment, fits = _align(dataset, maps, observed, samples, kind, official=official)
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
    return DepthResult(
        done=done,
        alignment=alignment,
        network=network,
        used=network_text(network, dataset) if network else "",
        warnings=warnings,
        shown=shown,
    )


def _why(dataset: Dataset, samples: list[Samples | None]) -> str:
    """Decision of the automatic rule of a training on all views for these maps."""
    usable = sum(part is not None and not part.problem for part in samples)
    facts = coverage(dataset.scene, range(len(dataset)))
    return decide(Switch.AUTO, facts, usable=usable)[1]


def _align(
    dataset: Dataset,
    maps: list[Path | None],
    observed: list[Observations],
    samples: list[Samples | None],
    kind: DepthKind,
    *,
    official: bool,
) -> tuple[Alignment, dict[str, Fit]]:
    """The alignment, and the fits to write; the official tools check reliability on reading."""
    found, warnings = resolved_kind(kind, samples, dataset)
    warnings = (*unusable(samples), *warnings)
    if not official:
        alignment = robust(samples, found, dataset, warnings)
        return alignment, _by_stem(dataset, alignment.fits)
    fits: list[Fit | None] = []
    for path, part, view in zip(maps, samples, observed, strict=True):
        if path is None or part is None:
            fits.append(None)
            continue
        if part.problem:
            fits.append(NO_FIT.refused(part.problem))
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


class StopMessage:
    """The message of a stop, with the progress of the work."""

    def __init__(self) -> None:
        self.predicted = 0

    def __call__(self) -> str:
        return (
            f"Stopped after {count_text(self.predicted, 'view')}; all written maps are complete. "
            "Run the same command again to continue."
        )


class _Progress:
    """Reports the progress of a phase after each view, and ends it on request."""

    def __init__(self, show: Show, control: Control, message: StopMessage, phase: str) -> None:
        self._show, self._control, self._message, self._phase = show, control, message, phase
        self._start = time.monotonic()

    def __call__(self, done: int, total: int, name: str) -> None:
        if self._phase == "predicting":
            self._message.predicted = done
        elif self._control.stopping:
            raise Cancelled(f"Depth was stopped while {self._phase}.")
        left = seconds_left(self._start, done, total)
        self._show(DepthProgress(done=done, total=total, view=name, eta_s=left, phase=self._phase))


def network_path(args: argparse.Namespace, show: Show) -> tuple[Path, Normalization]:
    """The file of --model and its input normalisation."""
    entry = known(args.model)
    path = Path(args.model)
    if entry is None or path.is_file():
        if entry is None and not path.suffix:
            raise ConfigError(
                f"There is no model {brief(path)}: give an ONNX file, or one of "
                f"{', '.join(network_names())}."
            )
        return path, args.normalization
    if args.download and cached_file(entry) is None:
        phase = f"downloading {entry.name}: {terms(entry)}"
        show(DepthProgress(done=0, total=0, view="", eta_s=float("nan"), phase=phase))
    found = network_file(entry, download=args.download)
    auto = args.normalization is Normalization.AUTO
    return found, entry.normalization if auto else args.normalization


def list_models(args: argparse.Namespace) -> int:
    """Print the named networks; returns the exit code."""
    rows = []
    for network in all_networks():
        try:
            here = cached_file(network)
        except BackendError:  # without the hub's library nothing was downloaded
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
        here = "on this machine" if row["file"] else f"{size_text(row['bytes'])} to download"
        print(f"{row['name']}  ({here}; licence {row['licence']}; input {row['input']})")
        print(f"    {row['page']}, weights of {row['source']}")
    return 0


def network_text(network: Network, dataset: Dataset) -> str:
    """Description of a network: detected family, input size and normalisation."""
    profile = network.profile
    width, height = network.input_size(*dataset.files[0].photo_size)
    return (
        f"{network.path.name}, detected as {profile.family}: input {width} x {height} px, "
        f"normalization {profile.normalization}"
    )
