"""`gscore view`: browser page with splats, to view and to share."""

import argparse
import math
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..config import DataConfig
from ..datasets.resolution import scale_intrinsics
from ..errors import ConfigError
from ..io.output_paths import check_separate
from ..page.pack import PAGE_DEGREE, Packed, pack, unpack
from ..page.page import Page, PageCamera, most_splats, write_page
from ..quoting import quoted
from ..raster.api import render
from ..report.html_parts import PAGE, link_page
from ..report.pictures import size_within
from ..splats import Splats
from ..text_format import count_text, number, size_text
from .args.device_option import add_device_option, device_of
from .args.model_argument import ModelArgument, add_model_argument, model_path, open_model
from .parser import add_option, add_result_options, add_threads_option
from .pictures.page_views import PageViews, find_views
from .terminal.output import PAGE_HINT, check_page, print_result
from .terminal.status import Status, print_warnings

_MANY = 1_500_000
"""Splats beyond which integrated graphics cards draw fewer than 30 frames per second."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    option = partial(add_option, parser)
    add_model_argument(parser)
    option("-o, --output OUTPUT", f"page, an .html file; default: {PAGE} of the run", Path)
    option(
        "-s, --source, --cameras SOURCE",
        "capture folder, or a cameras.json, without photos; default: the run's",
        Path,
        dest="source",
    )
    option(
        "--photos N", "number of photos on the page, evenly spaced; 0: none (40)", int, default=40
    )
    option("--title TITLE", "title of the page; default: the name of the capture or file")
    add_threads_option(parser)
    add_device_option(parser)
    add_result_options(parser, replaced="a file")


def run(args: argparse.Namespace) -> int:
    """Write the page and print its size."""
    with Status(sys.stderr, quiet=args.quiet) as status:
        status.show(["Reading the splats"])
        model = open_model(model_path(args))
        output = _output(args, model)
        status.clear()
        model = model.drawn_by(device_of(args))
        result = _write(args, model, output, status)
    print_result(result, [_summary(result)], json=args.json)
    return 0


def _output(args: argparse.Namespace, model: ModelArgument) -> Path:
    """Path of the page, checked to be writable."""
    if args.photos < 0:
        raise ConfigError(f"`--photos` must be at least 0, got {quoted(args.photos)}.")
    if args.output is None and model.run is None:
        raise ConfigError(f"{model.path} is not in the folder of a run; give a page with -o.")
    output: Path = args.output or model.run / PAGE  # pyright: ignore
    if output.suffix.lower() not in (".html", ".htm"):
        raise ConfigError(f"{output}: the output is a page; give a name that ends in .html.")
    check_page(output, overwrite=args.overwrite)
    return output


def _write(
    args: argparse.Namespace, model: ModelArgument, output: Path, status: Status
) -> dict[str, Any]:
    """Facts on the written files."""
    given = [DataConfig(source=args.source)] if args.source and args.source.is_dir() else []
    for data in (None, *given, *([model.data] if model.data else [])):
        check_separate(output.parent, data)
    _check_splats(model)
    views = find_views(args, model, status)
    status.show(["Packing the splats"])
    packed = pack(model.splats)
    if not packed.head["count"]:
        raise ConfigError(f"{model.path} contains no visible splats to show.")
    status.show(["Measuring the packing error"])
    cost = difference(model, packed, views, threads=args.threads)
    warnings = [*model.warnings, *views.warnings]
    if model.splats.sh_degree > PAGE_DEGREE:
        warnings.append(
            f"A page supports SH degree {PAGE_DEGREE}; view-dependent colour of higher degrees is "
            f"lost."
        )
    if packed.head["count"] > _MANY:
        warnings.append(
            f"{number(packed.head['count'])} splats are slow on a laptop; reduce them first with "
            f"gscore convert --count {_MANY}."
        )
    status.clear()
    print_warnings(warnings)
    title = args.title or _title(model)
    size = write_page(output, _page(title, model, packed, views))
    if output.name == PAGE and output.parent == model.run:
        link_page(output.parent)
    count = packed.head["count"]
    return {
        "file": str(output),
        "bytes": size,
        "splats": count,
        "splats_left_out": len(model.splats) - count,
        "bytes_per_splat": packed.text_bytes / count,
        "sh_degree": packed.head["degree"],
        "cameras": len(views.cameras),
        "photos": sum(1 for camera in views.cameras if camera.photo),
        **cost,
    }


def _page(title: str, model: ModelArgument, packed: Any, views: PageViews) -> Page:
    count = count_text(packed.head["count"], "splat")
    return Page(
        title=title,
        splats=packed,
        cameras=views.cameras,
        first=views.first,
        focus=views.focus,
        up=views.up,
        background=model.background,
        near=model.near,
        antialias=model.antialias,
        facts=f"{count}, {count_text(len(views.cameras), 'camera')}. Made with gscore.",
    )


def _title(model: ModelArgument) -> str:
    """Default title: name of the capture if known, else of the file."""
    if model.data is not None and model.data.source.name:
        return model.data.source.name
    plain = model.path.name == "point_cloud.ply" and model.path.parent.name
    return model.path.parent.name if plain else model.path.stem


def _check_splats(model: ModelArgument) -> None:
    degree = min(model.splats.sh_degree, PAGE_DEGREE)
    if len(model.splats) > (most := most_splats(degree)):
        raise ConfigError(
            f"{model.path} has {number(len(model.splats))} splats of SH degree {degree}; a page "
            f"supports {number(most)}. Reduce them first: gscore convert IN OUT --count {_MANY}."
        )


def _summary(result: dict[str, Any]) -> str:
    size = size_text(result["bytes"])
    parts = [count_text(result["splats"], "splat"), count_text(result["cameras"], "camera")]
    if left_out := result["splats_left_out"]:
        parts[0] += f" (left out: {number(left_out)} that cannot be visible)"
    parts.append(count_text(result["photos"], "photo"))
    text = (
        f"Wrote {result['file']}: {size}, {', '.join(parts)}; "
        f"{result['bytes_per_splat']:.1f} bytes a splat."
    )
    if result["packing_psnr"] is not None:
        text += (
            f"\nPSNR of the packed splats against the originals: {result['packing_psnr']:.1f} dB."
        )
    return f"{text}\n{PAGE_HINT}"


_VIEWS = 4
_WIDEST = 800
"""px."""


def difference(
    model: ModelArgument, packed: Packed, views: PageViews, *, threads: int
) -> dict[str, float | None]:
    """Difference of renders before and after packing, mean over some views: `packing_psnr` in dB,
    null if equal, and `packing_difference`, the mean absolute difference of 8-bit values.
    """
    chosen = views.cameras or [views.first]
    places = np.linspace(0, len(chosen) - 1, min(len(chosen), _VIEWS)).round().astype(int)
    found = unpack(packed)
    squares, differences = [], []
    for place in places:
        camera = chosen[place]
        before, after = (_drawn(model, one, camera, threads) for one in (model.splats, found))
        squares.append(float(np.mean((before - after) ** 2)))
        differences.append(float(np.abs(before - after).mean()) * 255)
    worth = [-10 * math.log10(square) for square in squares if square]
    return {
        "packing_psnr": sum(worth) / len(worth) if len(worth) == len(squares) else None,
        "packing_difference": sum(differences) / len(differences),
    }


def _drawn(model: ModelArgument, splats: Splats, camera: PageCamera, threads: int) -> np.ndarray:
    """[H, W, 3] float64 in [0, 1]."""
    old = camera.width, camera.height
    size = size_within(*old, _WIDEST)
    K = scale_intrinsics(camera.K, old, size)
    options = {"background": model.background, "near": model.near, "antialias": model.antialias}
    options |= {"device": model.device, "keep": True}
    drawn = render(splats, K, camera.viewmat, *size, depths=False, threads=threads, **options)
    return np.clip(drawn.rgb.astype(np.float64), 0, 1)
