"""`gscore eval`: metrics of trained splats against the photos of a capture."""

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..config import DataConfig
from ..control import Control
from ..datasets import Dataset, load_dataset
from ..errors import Cancelled, ConfigError, GsError
from ..events import EvalDone, EvalProgress, Show, Warn, headline_psnr, seconds_left
from ..formats import format_to_write, write_splat_file
from ..hold_out import SPLIT
from ..io.metrics_file import metrics_problem, read_metrics
from ..io.output_paths import check_output_path
from ..io.ply.comments import near_comment, stated_near
from ..io.region_file import read_region
from ..metrics import Course, Metrics, evaluate, find_lpips, headline, lpips_warnings
from ..metrics.photo_mismatch import photo_mismatch_warnings
from ..metrics.photo_renders import PhotoRenders
from ..metrics.splat_errors import SplatErrors
from ..metrics.trust import state_reach
from ..quoting import as_typed, brief
from ..raster import native_library
from ..raster.request import Frustum
from ..report import PictureCollector, cameras_section, splat_histograms, write_results
from ..report.colormap import brightest, error_map
from ..report.html_parts import link_page
from ..scene import Cameras
from ..text_format import (
    colour_text,
    count_text,
    number,
    psnr_name,
    quality_text,
    stopped_text,
    trust_text,
    verdict_text,
    views_text,
    worst_view_text,
)
from .args.data_options import add_data_options
from .args.device_option import add_device_option, device_of
from .args.model_argument import (
    ModelArgument,
    add_model_argument,
    data_config_of,
    model_path,
    open_model,
    views_of,
)
from .parser import add_option, add_threads_option
from .pictures.render_cameras import captured_cameras
from .terminal.output import check_folder, check_replaced, print_result
from .terminal.run_job import OutputOptions, add_output_options, run_job
from .terminal.status import print_warnings

_STOPPED = "Stopped; nothing was written."
_MOVED = 0.1
"""Median distance between cameras of the same name, as a share of the capture's radius, above which
they are of different captures."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    option = partial(add_option, parser)
    add_model_argument(parser)
    option("-s, --source SOURCE", "capture; default: that of the training", Path)
    option(
        "-o, --output OUTPUT", "folder for metrics.json and report.html; default: the run's", Path
    )
    option(
        "--split",
        "views to measure; default: test if there are test views, else all",
        choices=("test", "train", "all"),
    )
    option(
        "--lpips NETWORK",
        "LPIPS network (perceptual metric): an ONNX file, or alex, vgg or squeeze; default: "
        "not measured",
        Path,
    )
    option(
        "--lpips-download",
        "download the weights of a named --lpips network if torch's cache lacks them",
    )
    option("--overwrite", "replace a metrics.json or report.html that gscore did not write")
    option(
        "--error-map FILE",
        "also write the splats coloured by their error, from black (low) to pale yellow (high)",
        Path,
    )
    add_threads_option(parser)
    add_device_option(parser)
    add_data_options(parser)
    add_output_options(parser, quiet="no progress")


def run(args: argparse.Namespace) -> int:
    """Measure, write metrics.json and report.html, print the means."""
    result, code = run_job(
        OutputOptions.of(args),
        lambda show, control: _measure(args, show, control),
        stopped=lambda: _STOPPED,
    )
    if result is None:
        return code
    content, output = result
    facts = headline(content) | {"output": str(output)}
    print_result(facts, [_summary(content, output)], json=args.json, quiet=bool(args.events))
    return code


def _measure(args: argparse.Namespace, show: Show, control: Control) -> tuple[dict[str, Any], Path]:
    """Measure and write the results; returns the content of metrics.json and its folder."""
    _show_phase(show, "Reading the splats")
    lpips, lpips_reason = find_lpips(args.lpips, threads=args.threads, download=args.lpips_download)
    model = open_model(model_path(args))
    device = device_of(args, cancel=lambda: control.stopping, warn=False)
    model = model.drawn_by(device)
    output, config = _checked_output(args, model)
    _show_phase(show, f"Reading the capture {config.source}")
    views = _measured_views(args.split, model, config, output)
    dataset, names = views.dataset, views.cameras.names
    course = _of_the_training(model)
    problem = metrics_problem(output) if output == model.run else ""
    warnings = [*views.notes, *model.warnings, *dataset.warnings, *lpips_warnings(lpips_reason)]
    warnings += [sentence for sentence in (problem, device.note) if sentence]
    warnings += [*_stopped(model, course), *_doubts(model, views, course, args.split)]
    pictures = PictureCollector(count=len(views.indices))
    errors = None
    if args.error_map is not None:
        errors = SplatErrors(model.splats, antialias=model.antialias, threads=args.threads)
    evaluation = evaluate(
        lambda index: model.picture(
            views.cameras, index, threads=args.threads, mask_mode=dataset.mask_mode
        ),
        dataset,
        views.indices,
        lpips=lpips,
        lpips_reason=lpips_reason,
        background=model.background,
        on_view=_OnView(model, views, pictures, errors, show, control),
    )
    how = {"near": model.near, "antialias": model.antialias, "threads": args.threads}
    renders = PhotoRenders(model.splats, views.cameras, device=device, **how)
    state_reach(evaluation, renders, dataset, split=views.split, foreign=views.foreign)
    warnings += photo_mismatch_warnings(
        headline_psnr(evaluation.mean), f"The splats of {brief(str(model.path))}"
    )
    metrics = Metrics(
        evaluation=evaluation,
        split=views.split,
        train_views=[] if views.foreign else [names[i] for i in dataset.train],
        test_views=[names[i] for i in dataset.test],
        mask_mode=dataset.mask_mode,
        background=model.background,
        splats=len(model.splats),
        sh_degree=model.splats.sh_degree,
        storage_bytes=model.file.storage_bytes,
        isa=device.identity,
        threads=args.threads or native_library.default_threads(),
        course=course,
        model="" if output == model.run else str(model.path.absolute()),
    )
    mapped = _write_map(args.error_map, model, errors) if errors and args.error_map else {}
    content = write_results(
        output,
        metrics,
        data=config,
        run=model.run,
        trained=(model.data, model.train) if model.data and model.train else None,
        views=pictures.views,
        warnings=warnings,
        cameras=cameras_section(config.source, dataset.scene),
        histograms=splat_histograms([model.splats]),
    )
    link_page(output)
    if args.quiet and not args.events:  # --quiet hides only progress
        print_warnings(warnings)
    else:
        for sentence in warnings:
            show(Warn(message=sentence))
    psnrs = {view["name"]: headline_psnr(view) for view in content["views"]}
    show(EvalDone(split=views.split, path=str(output), views=psnrs, **mapped))
    return content | mapped, output


def _checked_output(args: argparse.Namespace, model: ModelArgument) -> tuple[Path, DataConfig]:
    """The folder of the results, and the options of the capture; raises GsError if a file there or
    the error map would replace another one."""
    output = args.output or model.run
    if output is None:
        raise ConfigError(
            f"{model.path} is not in the folder of a run; give a folder for metrics.json with -o"
            + ("." if args.source else " and the capture with -s.")
        )
    check_folder(output)
    config = data_config_of(args, model)
    _check_output(output, config, model, overwrite=args.overwrite)
    if args.error_map is not None:
        format_to_write(args.error_map)
        if args.error_map.resolve() == model.path.resolve():
            raise ConfigError(
                f"{args.error_map} is the model itself; give another file for the map."
            )
        check_replaced([args.error_map], overwrite=args.overwrite)
    return output, config


@dataclass(frozen=True, kw_only=True)
class _MeasuredViews:
    """The views that are measured."""

    dataset: Dataset
    """The capture, limited to the trained region of the run."""
    cameras: Cameras
    """Its cameras in the world of the splats."""
    split: str
    indices: list[int]
    """Views of `dataset`."""
    foreign: bool
    """Whether the photos are not those of the run."""
    notes: list[str]
    """Sentences for the user."""

    @property
    def names(self) -> list[str]:
        """Names of the views."""
        return [self.dataset.names[i] for i in self.indices]


def _measured_views(
    split: str | None, model: ModelArgument, config: DataConfig, output: Path
) -> _MeasuredViews:
    """Read a capture and choose the views of `split`; None: the test views, all without any."""
    dataset = load_dataset(config)
    cameras = model.world_of(dataset.scene.cameras)
    own, foreign = model.data, ""
    notes: list[str] = []
    if own is not None and config.source.resolve() == own.source.resolve():
        dataset, notes = _of_region(dataset, model)
    else:
        own, foreign = None, _other_capture(model, cameras)
        notes = [foreign] if foreign else []
    split, indices = views_of(split, dataset)
    split = "all" if foreign and split == "train" else split  # the run was not trained on them
    if own is not None and split == "test":
        notes += _trained_views(config, own, [dataset.names[i] for i in indices])
    if output == model.run and split != "test" and read_metrics(output).get("split") == "test":
        raise ConfigError(
            f"{output} contains the metrics of held-out views; give a folder with -o for those of "
            f"the {'training' if split == 'train' else 'other'} views."
        )
    return _MeasuredViews(
        dataset=dataset,
        cameras=cameras,
        split=split,
        indices=indices,
        foreign=bool(foreign),
        notes=notes,
    )


def _show_phase(show: Show, what: str) -> None:
    show(EvalProgress(done=0, total=0, view=what, eta_s=float("nan")))


def _write_map(path: Path, model: ModelArgument, errors: SplatErrors) -> dict[str, Any]:
    """Write the splats coloured by their errors; returns the fields of `EvalDone` on them."""
    found = errors.mean()
    bright = brightest(found)
    colored = error_map(model.splats, found, bright=bright)
    near = stated_near(model.file.comments)
    write_splat_file(
        path,
        colored,
        antialiased=model.antialias,
        origin=model.origin,
        comments=() if near is None else (near_comment(near),),
    )
    return {"error_map": str(path), "error_bright": bright}


class _OnView:
    """Callback for each view: stores pictures, accumulates errors of splats, shows progress."""

    def __init__(
        self,
        model: ModelArgument,
        views: _MeasuredViews,
        pictures: PictureCollector,
        errors: SplatErrors | None,
        show: Show,
        control: Control,
    ) -> None:
        self._model, self._views = model, views
        self._pictures, self._errors = pictures, errors
        self._show, self._control = show, control
        self._began = time.monotonic()

    def __call__(
        self,
        place: int,
        target: np.ndarray,
        rendered: np.ndarray,
        weights: np.ndarray | None,
        values: dict[str, Any],
    ) -> None:
        if self._control.stopping:
            raise Cancelled(_STOPPED)
        self._pictures(place, target, rendered, weights, values)
        if self._errors is not None:
            at, of = self._views.indices[place], self._views.cameras
            size = int(of.widths[at]), int(of.heights[at])
            view = Frustum(of.viewmats[at], of.Ks[at], *size, self._model.near)
            self._errors.add(view, rendered, target, weights)
        psnr = headline_psnr(values)
        worth = "identical" if psnr is None else f"{psnr_name(values)} {psnr:.2f} dB"
        done, total = place + 1, len(self._views.indices)
        left = seconds_left(self._began, done, total)
        text = f"{values['name']}: {worth}"
        self._show(EvalProgress(done=done, total=total, view=text, eta_s=left))


def _stopped(model: ModelArgument, course: Course) -> list[str]:
    """A sentence if the training was stopped before its last step."""
    requested = 0 if model.train is None or model.train.time_budget else model.train.iterations
    words = stopped_text({"reason": course.reason, "steps": course.steps}, requested)
    if not words or model.run is None:
        return []
    again = as_typed("train", "-o", model.run, "--resume")
    return [f"The training was {words}, so these figures are preliminary; continue with: {again}"]


def _doubts(
    model: ModelArgument, views: _MeasuredViews, course: Course, requested_split: str | None
) -> list[str]:
    """Sentences on the limits of the figures."""
    found = []
    if model.data is None and views.dataset.test and requested_split != "all":
        found.append(
            "The training views of this model are unknown; the test views are held out only if it "
            "was trained with the same split."
        )
    unknown = sum(name not in model.exposures for name in views.names)
    if course.exposure and course.exposure.get("learnt") and unknown:
        found.append(
            f"The exposures of {number(unknown)} of {count_text(len(views.indices), 'photo')} are "
            "unknown, so their pictures have the mean exposure and PSNR is lower where exposures "
            "differ."
        )
    return found


def _other_capture(model: ModelArgument, cameras: Cameras) -> str:
    """A sentence if the cameras, in the world of the splats, are not those of the run."""
    if model.run is None or not (model.run / "cameras.json").is_file():
        return ""
    trained = captured_cameras(None, model).cameras
    places = {name: i for i, name in enumerate(trained.names)}
    pairs = [(i, places[name]) for i, name in enumerate(cameras.names) if name in places]
    if not pairs:
        found = "none of them has the name of one of the run's"
    else:
        here, there = np.array(pairs).T
        moved = np.linalg.norm(cameras.centers[here] - trained.centers[there], axis=1)
        size = np.linalg.norm(trained.centers - trained.centers.mean(axis=0), axis=1).max()
        if np.median(moved) <= _MOVED * size:
            return ""
        found = f"{number(len(pairs))} have the names of the run's, but cameras at other places"
    return (
        f"These {count_text(len(cameras), 'photo')} are not those of the run: {found}. Figures "
        "count only if both captures are of one scene, in the same coordinates."
    )


def _trained_views(config: DataConfig, own: DataConfig, measured: Sequence[str]) -> list[str]:
    """A sentence if the run, with its `own` options, was trained on some of the `measured` views of
    its capture."""
    if all(getattr(own, name) == getattr(config, name) for name in ("eval", "test_offset", *SPLIT)):
        return []
    try:
        of_run = load_dataset(own)
    except GsError:  # a list of views that no longer exists
        return []
    count = len({of_run.names[i] for i in of_run.train} & set(measured))
    if not count:
        return []
    return [
        f"{number(count)} of {count_text(len(measured), 'test view')} were training photos of this "
        "run, so its figures are better than those of new views; give the `--hold-out` of the "
        "training, or none."
    ]


def _check_output(
    output: Path, config: DataConfig, model: ModelArgument, *, overwrite: bool
) -> None:
    """Raise if metrics.json and report.html would replace files of another run or program."""
    check_output_path(output, config)
    if model.run is not None and output.resolve() == model.run.resolve():
        return
    if (output / "config.json").is_file():
        raise ConfigError(
            f"{output} is the folder of another run with its own metrics.json; choose another "
            "output."
        )
    check_replaced((output / "metrics.json", output / "report.html"), overwrite=overwrite)


def _of_region(dataset: Dataset, model: ModelArgument) -> tuple[Dataset, list[str]]:
    """The capture limited to the trained region of the run, with masks of it, and sentences for
    the user; unchanged if the run trained everything."""
    config = model.train
    if config is None or config.region is None:
        return dataset, []
    from ..trainer.region.region_photos import RegionBox, RegionPhotos

    try:
        box = RegionBox(read_region(config.region)).about(dataset.scene.cameras.origin)
    except GsError as error:
        return dataset, [f"The run trained a region, but whole pictures are measured: {error}"]
    narrow = config.start_splats is None
    return RegionPhotos(dataset, box, near=model.near, narrow=narrow), []


def _of_the_training(model: ModelArgument) -> Course:
    """Course and end of the training, from its metrics.json."""
    if model.run is None or model.path != model.run / "point_cloud.ply":
        return Course()
    return Course.of_file(read_metrics(model.run))


def _summary(metrics: dict[str, Any], output: Path) -> str:
    why = metrics.get("psnr_masked_reason") or metrics.get("psnr_reason", "")
    worth = quality_text(metrics) or f"no PSNR ({why})"
    text = f"{views_text(metrics)}: {worth}{colour_text(metrics)}\n"
    sentences = (f(metrics) for f in (verdict_text, worst_view_text, trust_text))
    for sentence in filter(None, sentences):
        text += f"{sentence}\n"
    text += f"Results: {output / 'metrics.json'}, {output / 'report.html'}"
    if "error_map" in metrics:
        text += f"\nError map: {metrics['error_map']}, brightest from an error of "
        text += f"{metrics['error_bright']:.3f}"
    return text
