"""`gscore refit`: splats fitted to the drawing rules of the viewer that will show them."""

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..control import Control
from ..datasets import Dataset, load_dataset
from ..errors import Cancelled, ConfigError, DatasetError
from ..events import RefitDone, RefitProgress, Show, Warn, seconds_left
from ..formats import files_of, format_to_write, write_splat_file
from ..io.ply.comments import near_comment
from ..quoting import brief
from ..raster.request import Frustum
from ..scene import Cameras
from ..splats import Splats
from ..text_format import count_text, number
from ..viewers.rules import VIEWERS, ViewerRules, rules_of
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
from .terminal.output import check_folder, check_replaced, print_result
from .terminal.run_job import OutputOptions, add_output_options, run_job

_STOPPED = "Stopped; nothing was written."
_STEPS = 300
_VIEWS = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    add_model_argument(parser)
    text = f"viewer that will show the splats: {', '.join(VIEWERS)}"
    add_option(parser, "--for-viewer VIEWER", text, required=True)
    text = "splat file; default: refit_VIEWER.ply next to the model"
    add_option(parser, "-o, --output FILE", text, Path)
    text = "capture; default: that of the training"
    add_option(parser, "-s, --source CAPTURE", text, Path)
    add_option(parser, "--iterations N", f"steps; default: {_STEPS}", default=_STEPS)
    text = "most photos to measure, held-out ones if there are any; 0: measure nothing; default: "
    add_option(parser, "--views N", f"{text}{_VIEWS}", default=_VIEWS)
    add_option(parser, "--all-viewers", "measure in every viewer; takes minutes")
    add_option(parser, "--overwrite", "replace a file that gscore did not write")
    add_threads_option(parser)
    add_device_option(parser)
    add_output_options(parser)
    add_data_options(parser)


def run(args: argparse.Namespace) -> int:
    """Fit, write the splats, and print the measurements."""
    result, code = run_job(
        OutputOptions.of(args),
        lambda show, control: _refit(args, show, control),
        stopped=lambda: _STOPPED,
    )
    if result is None:
        return code
    quiet = bool(args.events or args.quiet)
    print_result(result, [refit_text(result)], json=args.json, quiet=quiet)
    return code


def _refit(args: argparse.Namespace, show: Show, control: Control) -> dict[str, Any]:
    rules = rules_of(args.for_viewer)
    for name, value, least in (("--iterations", args.iterations, 1), ("--views", args.views, 0)):
        if value < least:
            raise ConfigError(f"`{name}` must be at least {least}, got {value}.")
    show(_progress("reading"))
    model = open_model(model_path(args))
    output = args.output or model.path.parent / f"refit_{rules.name}.ply"
    _check_output(output, model, overwrite=args.overwrite)
    config = data_config_of(args, model)
    dataset = load_dataset(config)
    cameras = model.world_of(dataset.scene.cameras)
    model = model.drawn_by(device_of(args, cancel=lambda: control.stopping, warn=False))
    for sentence in filter(None, (*model.warnings, *dataset.warnings, model.device.note)):
        show(Warn(message=sentence))
    if not dataset.train:
        raise DatasetError(f"{config.source} has no training photos; choose another `--hold-out`.")
    began = time.monotonic()
    fitted = _fitted(args, model, cameras, dataset.train, rules, show, control)
    result = {
        "path": str(output),
        "model": str(model.path),
        "viewer": rules.name,
        "label": rules.label,
        "source": rules.source,
        "splats": len(fitted),
        "steps": args.iterations,
        "seconds": time.monotonic() - began,
        "modelled": True,
    }
    if args.views:
        result |= _measured(args, model, fitted, dataset, cameras, rules, show, control)
    result["device"] = model.device.name
    comments = (f"Made by gscore refit for {rules.name}", near_comment(model.near))
    written = write_splat_file(output, fitted, origin=model.origin, comments=comments)
    for sentence in written.notes:
        show(Warn(message=sentence))
    show(RefitDone(path=str(output), viewer=rules.name, measured=result.get("viewers", {})))
    return result


def _progress(phase: str, done: int = 0, total: int = 0, eta: float = math.nan) -> RefitProgress:
    return RefitProgress(phase=phase, done=done, total=total, eta_s=eta)


def _check_output(output: Path, model: ModelArgument, *, overwrite: bool) -> None:
    """Raise if the output cannot be written, or is the model or a file of its run."""
    format_to_write(output)
    check_folder(output.parent)
    if (
        output.name == "point_cloud.ply"
        and model.run is not None
        and (output.resolve().parent == model.run.resolve())
    ):
        raise ConfigError(f"{brief(output)} is the result of the training; choose another output.")
    if any(output.exists() and output.samefile(read) for read in files_of(model.path)):
        raise ConfigError(f"{brief(output)} is the input file; choose another output to keep it.")
    check_replaced([output], overwrite=overwrite)


def _view(model: ModelArgument, cameras: Cameras, index: int) -> Frustum:
    size = int(cameras.widths[index]), int(cameras.heights[index])
    return Frustum(cameras.viewmats[index], cameras.Ks[index], *size, model.near)


def _counter(phase: str, total: int, show: Show, control: Control) -> Callable[[], None]:
    """Called after each step or picture: shows the progress; raises Cancelled on a stop."""
    began, done = time.monotonic(), 0

    def count() -> None:
        nonlocal done
        if control.stopping:
            raise Cancelled(_STOPPED)
        done += 1
        show(_progress(phase, done, total, seconds_left(began, done, total)))

    return count


def _fitted(
    args: argparse.Namespace,
    model: ModelArgument,
    cameras: Cameras,
    train: list[int],
    rules: ViewerRules,
    show: Show,
    control: Control,
) -> Splats:
    from ..viewers.refit import RefitSettings, refit

    count = _counter("fitting", args.iterations, show, control)
    settings = RefitSettings(
        steps=args.iterations,
        antialias=model.antialias,
        background=model.background,
        threads=args.threads,
        device=model.device,
    )
    views = [_view(model, cameras, index) for index in train]
    return refit(model.splats, views, rules, settings, on_step=lambda step, loss: count())


def _measured(
    args: argparse.Namespace,
    model: ModelArgument,
    fitted: Splats,
    dataset: Dataset,
    cameras: Cameras,
    rules: ViewerRules,
    show: Show,
    control: Control,
) -> dict[str, Any]:
    from ..viewers.measure import measured, strided
    from ..viewers.refit import tensors_of

    split, indices = views_of(None, dataset)
    indices = strided(indices, args.views)
    viewers = [*VIEWERS.values()] if args.all_viewers else [rules]
    total = 2 * len(viewers) * len(indices)
    how = {"threads": args.threads, "mask_mode": dataset.mask_mode}
    own, found = measured(
        {"before": tensors_of(model.splats), "after": tensors_of(fitted)},
        viewers,
        dataset,
        {index: _view(model, cameras, index) for index in indices},
        {index: model.picture(cameras, index, **how) for index in indices},
        model.exposures,
        background=model.background,
        on_picture=_counter("measuring", total, show, control),
    )
    names = [cameras.names[index] for index in indices]
    return {"split": split, "views": names, "own": own, "viewers": found}


def refit_text(result: dict[str, Any]) -> str:
    """The result of a refit as lines of text."""
    text = (
        f"{result['path']}: {count_text(result['splats'], 'splat')} for {result['label']}, "
        f"{number(result['steps'])} steps"
    )
    if "viewers" not in result:
        return text
    kind = "test view" if result["split"] == "test" else "training view"
    lines = [
        text,
        f"PSNR of {count_text(len(result['views']), kind)}, and mean difference to gscore's own "
        "picture of 255, before and after, modelled by the viewer's published rules:",
        f"  gscore: {_psnr(result['own'])}",
    ]
    for name, found in result["viewers"].items():
        both = [f"{_psnr(one)} ({one['difference']:.2f})" for one in found.values()]
        lines.append(f"  {VIEWERS[name].label}: {' -> '.join(both)}")
    return "\n".join(lines)


def _psnr(found: dict[str, Any]) -> str:
    return "no PSNR" if found["psnr"] is None else f"{found['psnr']:.2f} dB"
