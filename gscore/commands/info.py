"""`gscore info`: summary of a capture, photos, a video, a splat file or a run."""

import argparse
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..config import DataConfig
from ..datasets.programs import find_program
from ..errors import DatasetError
from ..events import MASKED_OF
from ..formats import is_splat_file
from ..inspection import CaptureFacts, inspect
from ..io.block_record import block_records, read_block
from ..io.files import check_regular
from ..io.lod_file import is_lod_file, open_lod_file
from ..io.metrics_file import metrics_problem, read_metrics
from ..io.missing_path import missing_path
from ..io.runs import checkpoints_in, read_run, training_in
from ..io.sequences import read_sequence
from ..quoting import as_typed, brief
from ..sfm.photos import check_no_cameras_above, is_photo_folder
from ..splats import Splats, sigmoid
from ..text_format import (
    count_text,
    point_text,
    quality_text,
    size_text,
    step_text,
    stopped_text,
    time_text,
)
from ..video import is_video
from .args.data_options import add_mask_options, with_data_options
from .args.model_argument import ModelArgument, find_splats, open_model
from .lod import lod_facts, lod_text
from .parser import add_option
from .photo_folder_info import photos_facts, photos_text, video_facts, video_text
from .terminal.output import print_result

_QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)
_EXPONENT = 350.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    option = partial(add_option, parser)
    option("path", "folder of a capture, photos or a run; a video; or a splat file", Path)
    option("-i, --images IMAGES", "folder of the photos inside the capture", default="images")
    add_mask_options(parser)
    option("--json", "one JSON object on stdout")


def run(args: argparse.Namespace) -> int:
    """Print the summary of a path."""
    path = args.path
    if not path.exists():
        raise DatasetError(missing_path(path, "file or folder"))
    if not path.is_dir():
        check_regular(path)
    if is_lod_file(path):
        with open_lod_file(path) as file:
            facts = lod_facts(path, file.index)
    elif is_video(path):
        facts = video_facts(path)
    elif (
        path.is_file()
        and find_program(path) is None
        and (path.suffix.lower() != ".json" or is_splat_file(path))
    ):
        facts = _model_facts(open_model(path))
    elif path.is_dir() and (index := read_sequence(path)):
        facts = {"kind": "sequence", "path": str(path), **vars(index)}
    elif path.is_dir() and _holds_model(path):
        facts = _run_facts(path)
    elif is_photo_folder(path) and not block_records(path):
        check_no_cameras_above(path)
        facts = photos_facts(path, with_data_options(DataConfig(source=path), args))
    else:
        facts = _capture_facts(path, args)
    print_result(facts, [_text(facts)], json=args.json)
    return 0


def _holds_model(folder: Path) -> bool:
    try:
        find_splats(folder)
    except DatasetError:
        return (folder / "config.json").is_file() or training_in(folder) is not None
    return True


def _model_facts(model: ModelArgument) -> dict[str, Any]:
    splats = model.splats
    size = model.file.storage_bytes
    return {
        "kind": "splats",
        "path": str(model.path),
        "splats": len(splats),
        "sh_degree": splats.sh_degree,
        "storage_bytes": size,
        "bytes_per_splat": round(size / len(splats), 1) if len(splats) else None,
        "format": model.file.format,
        "layout": model.file.layout,
        "antialias": model.antialias,
        "origin": None if model.origin is None else model.origin.tolist(),
        "comments": list(model.file.comments),
        **(_statistics(splats) if len(splats) else {}),
        "warnings": list(model.warnings),
    }


def _statistics(splats: Splats) -> dict[str, Any]:
    """Statistics of positions, sizes and opacities, float64."""
    means = splats.means.astype(np.float64)
    # Clipped so that exponentials and their quotients fit float64.
    logs = np.clip(splats.scales.astype(np.float64), -_EXPONENT, _EXPONENT)
    opacity, scales = sigmoid(splats.opacities), np.exp(logs)
    largest, smallest = scales.max(axis=1), scales.min(axis=1)
    return {
        "bounds": [means.min(axis=0).tolist(), means.max(axis=0).tolist()],
        # A few far splats make the plain bounds useless.
        "bounds_of_98_percent": np.quantile(means, (0.01, 0.99), axis=0).tolist(),
        "quantiles": list(_QUANTILES),
        "opacity": np.quantile(opacity, _QUANTILES).tolist(),
        "largest_scale": np.quantile(largest, _QUANTILES).tolist(),
        "elongation": np.quantile(largest / smallest, _QUANTILES).tolist(),
        "nearly_transparent": float((opacity < 0.005).mean()),
    }


def _run_facts(folder: Path) -> dict[str, Any]:
    checkpoints = checkpoints_in(folder)
    facts: dict[str, Any] = {"kind": "run", "path": str(folder), "checkpoints": len(checkpoints)}
    metrics = read_metrics(folder)
    keys = ("psnr", "ssim", "lpips", "lpips_net", "split")
    keys += ("steps", "train_seconds", "gscore", "models", "blurs", "transients")
    facts["metrics"] = None
    if metrics:
        facts["metrics"] = {key: metrics.get(key) for key in keys}
        if "psnr_masked" in metrics:
            facts["metrics"] |= {
                key: metrics[key] for key in ("psnr_masked", MASKED_OF) if key in metrics
            }
    problem = metrics_problem(folder)
    facts["warnings"] = [problem] if problem else []
    process = training_in(folder)
    facts |= {"in_training": process is not None, "process": process or None}
    facts["unfinished"] = _unfinished(folder, metrics)
    try:
        find_splats(folder)
    except DatasetError:
        return facts | {"model": None, "source": None}
    model = open_model(folder)
    facts["source"] = str(model.data.source) if model.data else None
    return facts | {"model": _model_facts(model)}


def _unfinished(folder: Path, metrics: dict[str, Any]) -> str:
    """Progress of an unfinished run; empty: finished."""
    run = read_run(folder)
    if run is None:
        return ""
    if run.steps > (metrics.get("steps") or 0):
        return f"its last checkpoint is after {step_text(run.steps, run.iterations)}"
    return stopped_text(metrics, run.iterations)


def _capture_facts(path: Path, args: argparse.Namespace) -> dict[str, Any]:
    from ..datasets import load_dataset  # needs Pillow to read photos

    config = with_data_options(DataConfig(source=path, resolution=1), args)
    dataset = load_dataset(config)
    found = inspect(config)
    scene = dataset.scene
    cameras = scene.cameras
    sizes = Counter(
        f"{w} x {h}" for w, h in zip(cameras.widths.tolist(), cameras.heights.tolist(), strict=True)
    )
    centers = cameras.centers
    facts: dict[str, Any] = {
        "kind": "capture",
        "path": str(path),
        "views": len(cameras),
        "names": [cameras.names[0], cameras.names[-1]],
        "sizes": dict(sizes.most_common()),
        "focal_px": [float(cameras.Ks[:, 0, 0].min()), float(cameras.Ks[:, 0, 0].max())],
        "undistorted": any(file.plan is not None for file in dataset.files),
        "focal_y_px": [float(cameras.Ks[:, 1, 1].min()), float(cameras.Ks[:, 1, 1].max())],
        "camera_extent": float(
            1.1 * np.linalg.norm(centers - centers.mean(axis=0), axis=1).max(initial=0.0)
        ),
        "points": found.points,
        "origin": None if cameras.origin is None else cameras.origin.tolist(),
        "masks": dataset.mask_mode,
        "masks_inverted": config.invert_masks,
        "decoded_bytes": dataset.nbytes,
        "depths": found.depths,
        "warnings": list(dict.fromkeys((*dataset.warnings, *(p.text for p in found.problems)))),
    }
    record = read_block(path)
    if record is not None:
        facts["block"] = {"index": record.index, "count": record.count}
    return facts | {"model": _colmap_facts(found), "cameras_of": _cameras_of(found)}


def _colmap_facts(found: CaptureFacts) -> dict[str, Any] | None:
    """The COLMAP model before undistortion; None for other captures."""
    if found.kind != "COLMAP":
        return None
    return {
        "path": str(found.model),
        "cameras": found.cameras,
        "images": found.photos + len(found.missing),
        "points": found.points,
        "mean_error_px": found.error_px,
    }


def _cameras_of(found: CaptureFacts) -> dict[str, Any] | None:
    """Program and file of the cameras; None for a COLMAP model or a video."""
    if found.kind in ("COLMAP", "video") or found.model is None:
        return None
    return {"format": found.kind, "path": str(found.model), "cameras": found.cameras}


def _text(facts: dict[str, Any]) -> str:
    lines = {
        "splats": _splats_text,
        "levels of detail": lod_text,
        "run": _run_text,
        "sequence": _sequence_text,
        "photos": photos_text,
        "video": video_text,
        "capture": _capture_text,
    }[facts["kind"]]
    return "\n".join(lines(facts) + [f"Warning: {w}" for w in facts.get("warnings", [])])


def _splats_text(facts: dict[str, Any]) -> list[str]:
    marks = ["trained with antialiasing"] if facts["antialias"] else []
    marks += [f'comment "{line}"' for line in facts["comments"]]
    lines = [
        f"{facts['path']}: {count_text(facts['splats'], 'splat')}, SH degree "
        f"{facts['sh_degree']}, {size_text(facts['storage_bytes'])}, {facts['layout']} layout"
        + (f", {', '.join(marks)}" if marks else "")
    ]
    if "bounds" not in facts:
        return lines
    low, high = facts["bounds_of_98_percent"]
    lines += [
        f"  98 % of them between {point_text(low)} and {point_text(high)}",
        "  bounds             " + " and ".join(map(point_text, facts["bounds"])),
        "                     " + "".join(f"{f'{q:.0%}':>10}" for q in _QUANTILES),
    ]
    rows = (("opacity", "opacity"), ("largest_scale", "largest scale"), ("elongation",) * 2)
    for key, label in rows:
        lines.append(f"  {label:19}" + "".join(f"{v:10.3g}" for v in facts[key]))
    share = 100 * facts["nearly_transparent"]
    if share >= 0.05:  # else it would be 0.0
        lines.append(f"  {share:.1f} % have an opacity below 0.005 and could be removed")
    return lines


def _run_text(facts: dict[str, Any]) -> list[str]:
    lines = [f"{facts['path']}: a run" + (f" on {facts['source']}" if facts["source"] else "")]
    metrics = facts["metrics"]
    if metrics and (worth := quality_text(metrics)):
        models = f", {metrics['models']} models as one" if metrics["models"] else ""
        lines.append(
            f"  {brief(metrics['split'])} views: {worth}; "
            f"{count_text(metrics['steps'], 'step')} in {time_text(metrics['train_seconds'])}"
            f"{models}"
        )
    if metrics and (found := _photos_text(metrics)):
        lines.append(f"  {found}")
    count = facts["checkpoints"]
    if facts["in_training"]:
        by = f", by process {facts['process']}" if facts["process"] else ""
        lines.append(f"  in training now{by}; files here are older or incomplete")
    elif unfinished := facts["unfinished"]:
        hint = (
            f"; continue with: {as_typed('train', '-o', facts['path'], '--resume')}"
            if count
            else ""
        )
        lines.append(f"  {unfinished}{hint}")
    lines.append(f"  {count_text(count, 'checkpoint')}")
    if facts["model"] is None:
        return [*lines, "  no point_cloud.ply yet"]
    return lines + _splats_text(facts["model"])


def _photos_text(metrics: dict[str, Any]) -> str:
    """Photos that are trained on in part, or blurred; empty: none."""
    kinds = (("transients", "with parts left out"), ("blurs", "blurred"))
    found = [f"{len(metrics[key])} {words}" for key, words in kinds if metrics[key]]
    return f"training photos: {', '.join(found)} (see report.html)" if found else ""


def _sequence_text(facts: dict[str, Any]) -> list[str]:
    frames, total = facts["frames"], facts["mean"].get("frames_total")
    done = count_text(len(frames), "frame")
    done = f"{len(frames)} of {count_text(total, 'frame')}" if total else done
    lines = [f"{facts['path']}: a sequence, {done} complete"]
    for entry in frames:
        worth = quality_text(entry)
        quality = f", {entry.get('split')} views: {worth}" if worth else ""
        took = time_text(entry.get("train_seconds") or 0.0)
        lines.append(
            f"  {entry['folder']}: {count_text(entry.get('splats', 0), 'splat')}, "
            f"{count_text(entry.get('steps'), 'step')} in {took}{quality}"
        )
    if len(frames) != total:
        lines.append(f"  continue with: {as_typed('sequence', '-o', facts['path'], '--resume')}")
    return lines


def _capture_text(facts: dict[str, Any]) -> list[str]:
    sizes = ", ".join(f"{n} of {size} px" for size, n in facts["sizes"].items())
    low, high = facts["focal_px"]
    inverted = " inverted" if facts["masks_inverted"] else ""
    focal = _focal_text(low, high)
    down = _focal_text(*facts["focal_y_px"])
    undistorted = " after undistortion" if facts["undistorted"] else ""
    focal += " px" if down == focal else f" px across and {down} px down"
    lines = [
        f"{facts['path']}: a capture with {count_text(facts['views'], 'photo')} ({sizes})",
        f"  names from {facts['names'][0]} to {facts['names'][1]}",
        f"  focal length {focal}{undistorted}, camera extent {facts['camera_extent']:.3g}",
        f"  {count_text(facts['points'], 'point')}, masks: {facts['masks']}{inverted}, "
        f"{size_text(facts['decoded_bytes'])} of photos in memory",
    ]
    if block := facts.get("block"):
        lines.append(f"  block {block['index']} of {block['count']}, numbered from 0")
    if other := facts["cameras_of"]:
        kinds = ", ".join(f"{n} {kind}" for kind, n in other["cameras"].items())
        lines.append(f"  {other['format']} {other['path']}: cameras {kinds}")
    model = facts["model"]
    if model:
        kinds = ", ".join(f"{n} {kind}" for kind, n in model["cameras"].items())
        error = model["mean_error_px"]
        lines.append(
            f"  COLMAP model {model['path']}: cameras {kinds}; "
            f"{count_text(model['images'], 'image')}"
            + (f"; mean error {error:.2f} px" if error is not None else "")
        )
    return lines


def _focal_text(low: float, high: float) -> str:
    return f"{low:.1f}" if high - low < 0.05 else f"{low:.1f} to {high:.1f}"
