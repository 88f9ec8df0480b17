"""`gscore compare`: page that compares two runs on one capture, view by view."""

import argparse
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..config import DataConfig
from ..config_command import train_command
from ..config_file import to_dict
from ..datasets import Dataset, load_dataset
from ..errors import ConfigError, DatasetError
from ..io.metrics_file import read_metrics
from ..io.missing_path import missing_path
from ..metrics.comparison import ComparedRun, RunComparison, compare_runs
from ..metrics.evaluate import target_picture
from ..quoting import brief
from ..report.compare_page import PairPictures, comparison_html, names_of
from ..report.html_parts import write_html
from ..report.pictures import MAX_VIEWS, budget_each, has_pictures, thumbnails
from ..text_format import count_text
from .args.device_option import add_device_option, device_of
from .args.model_argument import ModelArgument, open_model
from .parser import add_option, add_result_options, add_threads_option
from .terminal.output import PAGE_HINT, check_page, print_result
from .terminal.status import Counted, Status, print_warnings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    option = partial(add_option, parser)
    option("first RUN_A", "folder of a run, or the output of gscore eval", Path)
    option("second RUN_B", "another run on the same capture", Path)
    option("-o, --output OUTPUT", "page (compare.html)", Path, default=Path("compare.html"))
    option(
        "-s, --source SOURCE",
        "current folder of the capture; default: as recorded by the runs",
        Path,
    )
    add_threads_option(parser)
    add_device_option(parser)
    add_result_options(parser, replaced="a page")


def run(args: argparse.Namespace) -> int:
    """Pair the views, render both runs, write the page, print the differences."""
    _check_output(args.output, overwrite=args.overwrite)
    with Status(sys.stderr, quiet=args.quiet) as status:
        comparison = _compare(args, status)
    if not args.json:
        print_warnings(comparison.warnings)
    facts = comparison.content() | {"output": str(args.output)}
    print_result(facts, _summary(comparison, args.output), json=args.json)
    return 0


def _check_output(output: Path, *, overwrite: bool) -> None:
    if output.suffix.lower() not in (".html", ".htm"):
        raise ConfigError(f"{brief(output)}: the output is a page; give a name with .html.")
    check_page(output, overwrite=overwrite)


def _compare(args: argparse.Namespace, status: Status) -> RunComparison:
    status.show(["Reading both runs"])
    folders = (args.first, args.second)
    models = [_opened(folder) for folder in folders]
    data = _data_config(models, args.source)
    labels = _labels(folders)
    first, second = (
        _compared(label, folder, model)
        for label, folder, model in zip(labels, folders, models, strict=True)
    )
    comparison = compare_runs(first, second)
    status.show([f"Reading the capture {data.source}"])
    dataset = load_dataset(data)
    status.clear()
    device = device_of(args)
    drawn = [model.drawn_by(device) for model in models]
    pictures = _pictures(comparison, drawn, dataset, args.threads, status)
    title = data.source.resolve().name
    write_html(args.output, comparison_html(comparison, pictures, title=title))
    return comparison


def _opened(folder: Path) -> ModelArgument:
    if not folder.exists():
        raise ConfigError(missing_path(folder, advice="Give the folders of two runs."))
    if not folder.is_dir():
        raise ConfigError(f"{brief(folder)} is not a folder; give the folders of two runs.")
    # The metrics.json of an evaluation in another folder states the measured splats.
    measured = None if (folder / "config.json").is_file() else read_metrics(folder).get("model")
    model = open_model(Path(measured) if measured else folder)
    if model.data is None or model.run is None:
        raise ConfigError(
            f"{brief(folder)} contains no config.json with the options of a training; give the "
            "output folder of gscore train."
        )
    return model


def _data_config(models: list[ModelArgument], source: Path | None) -> DataConfig:
    """Data options of the first run, for the capture of both."""
    first, second = (model.data for model in models if model.data is not None)
    if source is not None:
        return replace(first, source=source)
    if first.source.resolve() != second.source.resolve():
        raise ConfigError(
            f"{brief(str(models[0].run))} was trained on {brief(first.source)}, "
            f"{brief(str(models[1].run))} on {brief(second.source)}; give runs on one capture. If "
            "both contain the same photos, give their folder with -s."
        )
    if not first.source.exists():
        raise DatasetError(
            f"The capture of both runs, {brief(first.source)}, no longer exists; give its current "
            "folder with -s SOURCE."
        )
    return first


def _labels(folders: tuple[Path, Path]) -> tuple[str, str]:
    """Shortest suffixes of both paths that differ."""
    parts = [folder.resolve().parts for folder in folders]
    if parts[0] == parts[1]:
        raise ConfigError(f"{brief(folders[0])} is given twice; give two different runs.")
    for count in range(1, max(map(len, parts)) + 1):
        first, second = ("/".join(each[-count:]) for each in parts)
        if first != second:
            return first, second
    raise AssertionError("two paths differ somewhere")


def _compared(label: str, folder: Path, model: ModelArgument) -> ComparedRun:
    options: dict[str, Any] = {}
    command = ""
    metrics = read_metrics(folder) or read_metrics(model.run or folder)
    if model.data is not None and model.train is not None:
        options = to_dict(model.data) | to_dict(model.train)
        asked = metrics.get("asked")
        command = train_command(model.data, model.train, model.run or folder, requested=asked)
    return ComparedRun(
        label=label, folder=str(folder), metrics=metrics, options=options, command=command
    )


def _pictures(
    comparison: RunComparison,
    models: list[ModelArgument],
    dataset: Dataset,
    threads: int,
    status: Status,
) -> list[PairPictures]:
    """Thumbnails of the photo and both renders, of the views that get pictures."""
    drawn = [(model, model.world_of(dataset.scene.cameras)) for model in models]
    places = {name: i for i, name in enumerate(dataset.names)}
    count = len(comparison.pairs)
    names = [pair.name for i, pair in enumerate(comparison.pairs) if has_pictures(i, count)]
    missing = [name for name in names if name not in places]
    if missing:
        raise DatasetError(
            f"The capture {dataset.source} has no view {brief(missing[0])}, which both runs were "
            "measured on; give their capture with -s."
        )
    progress = Counted(status, len(names), "view")
    budget = budget_each(min(count, MAX_VIEWS))
    found = []
    for done, name in enumerate(names, start=1):
        index = places[name]
        renders = [
            np.clip(
                model.picture(cameras, index, threads=threads, mask_mode=dataset.mask_mode), 0, 1
            )
            for model, cameras in drawn
        ]
        photo, _ = target_picture(
            dataset.image(index), dataset.mask(index), dataset.mask_mode, models[0].background
        )
        uris, size = thumbnails([*renders, photo], budget)
        width, height = size
        found.append(PairPictures(
            name=name, width=width, height=height, first=uris[0], second=uris[1], photo=uris[2]
        ))  # fmt: skip
        progress(done, name)
    return found


def _summary(comparison: RunComparison, output: Path) -> list[str]:
    first, second = (run.label for run in comparison.runs)
    views, names = count_text(len(comparison.pairs), "view"), names_of(comparison)
    lines = [f"{views} measured in both {first} and {second}:"]
    for key, (a, b) in comparison.means.items():
        digits = 2 if key == "psnr" else 4
        lines.append(f"  {names[key]:5} {a:.{digits}f} and {b:.{digits}f} ({b - a:+.{digits}f})")
    for run, names in zip(comparison.runs, comparison.only_in, strict=True):
        if names:
            lines.append(f"  {count_text(len(names), 'view')} measured only in {run.label}")
    return [*lines, f"Wrote {output}.", PAGE_HINT]
