"""`gscore render`: pictures of a model at the cameras of a capture, or a camera path as a video."""

import argparse
import math
import re
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..config import DataConfig
from ..datasets.resolution import check_resolution, small_width_warnings
from ..errors import ConfigError
from ..io.images.png import SIGNED, write_png
from ..io.lod_file import LOD_ENDING, is_lod_file
from ..io.output_paths import check_output_path, check_separate
from ..lod.lod_renderer import LOD_PX, LodModel
from ..photo_exposure import PhotoExposure
from ..quoting import as_typed, brief, quoted
from ..raster.api import Rendered
from ..scene import Cameras
from ..text_format import count_text, number
from .args.device_option import add_device_option, device_of
from .args.model_argument import (
    LodArgument,
    ModelArgument,
    add_model_argument,
    model_path,
    open_model,
)
from .parser import add_option, add_result_options, add_threads_option
from .pictures.deep import deep_channels, layer_bounds, need_deep, write_deep
from .pictures.render_cameras import FPS, PATHS, find_exposures, find_shots
from .pictures.stills import still_names, to_rgb, to_rgba, write_depth_npy, write_depth_png
from .pictures.video import need_video, write_video
from .terminal.output import (
    check_folder,
    check_replaced,
    is_ours,
    other_files,
    print_result,
)
from .terminal.status import Counted, Status, print_warnings

_COLORS = {"black": (0.0, 0.0, 0.0), "white": (1.0, 1.0, 1.0)}
_WRITTEN = (".mp4", ".png")
"""Endings of single-file outputs; any other output is a folder of pictures."""
_OTHER_FORMAT = re.compile(r"\.([a-z]{2,4}|blend|ksplat|m4v)")
"""Endings that mean a file instead of a folder."""
_DEPTH_ENDINGS = {"png": "png", "npy": "npy", "deep": "exr"}
_DEPTH_STEPS = 60_000
"""16-bit values for the depth range of the first picture; the rest is for larger depths."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    option = partial(add_option, parser)
    add_model_argument(parser)
    option("-o, --output OUTPUT", "folder for pictures, a .png, or an .mp4", Path, required=True)
    add_threads_option(parser)
    add_device_option(parser)
    add_result_options(parser, replaced="files")
    group = parser.add_argument_group("cameras")
    option = partial(add_option, group)
    option(
        "-s, --cameras, --source CAMERAS",
        "capture folder or cameras.json; default: the run's",
        Path,
        dest="cameras",
    )
    which = partial(add_option, group.add_mutually_exclusive_group())
    which("--view NAME...", "views to render, by name or number", action="extend")
    which("--all", "all views (the default for stills)")
    which("--test", "the held-out views of the run")
    which(
        "--path {orbit,spline,FILE}",
        "orbit (swing if photos lack a side), spline through all cameras, or a cameras.json "
        "(video: orbit)",
    )
    option(
        "--frames FRAMES",
        "number of pictures along the path (8 s; spline: longer with many cameras)",
        int,
    )
    option("--fps FPS", f"frames per second (as in the path's file, else {FPS:g})", float)
    option(
        "-r, --resolution RESOLUTION",
        "photo size: divisor 2, 4 or 8, or width in pixels; -1: as in the training, or that "
        "of the cameras (-1)",
        float,
        default=-1,
    )
    option = partial(add_option, parser.add_argument_group("picture"))
    option("--background COLOR", "background colour: black, white or r,g,b from 0 to 1", _color)
    option(
        "--exposure {even,photo,NAME}",
        "exposure: even, of the nearest photo, or of one by name or number (views: photo, "
        "path: even)",
    )
    option("--transparent", "PNG with alpha, without background")
    option(
        "--depth",
        "also write depths: maps of 16-bit grey or exact float32, or deep OpenEXR pictures",
        choices=tuple(_DEPTH_ENDINGS),
    )
    option("--sh-degree N", "degree of view-dependent colour; 0: none (the model's)", int)
    option("--near X", "near plane, world units; nearer splats are not rendered", float)
    option(
        "--antialias",
        "opacity compensation of splats smaller than a pixel; default: as in the training",
        action=argparse.BooleanOptionalAction,
    )
    option = partial(
        add_option, parser.add_argument_group("levels of detail, for files by gscore lod")
    )
    option(
        "--lod-px PX",
        f"tolerance of coarser levels in pixels; 0: finest everywhere ({LOD_PX:g})",
        float,
    )
    option(
        "--lod-splats N",
        "maximum number of splats per picture, met by coarser levels (no limit)",
        int,
    )


def run(args: argparse.Namespace) -> int:
    """Render and write."""
    is_video = args.output.suffix.lower() == ".mp4"
    _check_options(args, is_video=is_video)
    check_folder(args.output.parent if _is_file(args.output) else args.output)
    with Status(sys.stderr, quiet=args.quiet) as status:
        result = _render(args, status, is_video=is_video)
    print_result(result, [_summary(args, result)], json=args.json)
    return 0


def _is_file(output: Path) -> bool:
    """Whether the output is a single file instead of a folder."""
    return output.suffix.lower() in _WRITTEN


def _render(args: argparse.Namespace, status: Status, *, is_video: bool) -> dict[str, Any]:
    """Facts on the written files."""
    status.show(["Reading the splats"])
    model = _open(args)
    if not model.count:
        raise ConfigError(f"{brief(str(model.path))} contains no splats to render.")
    for data in (None, *_captures(args, model)):
        if _is_file(args.output):
            check_separate(args.output.parent, data)
        else:
            check_output_path(args.output, data)
    status.clear()
    if args.depth == "deep" and isinstance(model, LodArgument):
        raise ConfigError(
            "`--depth deep` needs a model without levels of detail; render the file from which "
            f"`gscore lod` has made {brief(str(model.path))}."
        )
    print_warnings(model.warnings)
    found = find_shots(args, model, is_video=is_video)
    if found.why:
        status.print_line(found.why)
    shots = found.cameras
    background = model.background if args.background is None else args.background
    options = {
        "background": (0.0, 0.0, 0.0) if args.transparent else background,
        "sh_degree": args.sh_degree,
        "near": model.near if args.near is None else args.near,
        "antialias": model.antialias if args.antialias is None else args.antialias,
        "depths": args.depth is not None,
        "threads": args.threads,
    }
    exposures = find_exposures(args.exposure, found, model, args.cameras)
    pictures, depths = ([args.output], []) if is_video else _stills(args, shots.names)
    if is_video:
        _check_one_size(shots)
    _check_files(pictures, depths, overwrite=args.overwrite)
    if args.exposure is None and not all(one.neutral for one in exposures):
        status.print_line("Pictures are exposed as their photos; `--exposure even` avoids that.")
    size = int(shots.widths[0]), int(shots.heights[0])
    print_warnings(small_width_warnings(args.resolution, *size))
    model = model.drawn_by(device_of(args))
    work = _Work(model, shots, options, exposures, status)
    if is_video:
        write_video(args.output, (to_rgb(r) for r in work), fps=args.fps or found.fps or FPS)
        result: dict[str, Any] = {"files": [str(args.output)]}
    else:
        result = _write_stills(args, work, pictures, depths)
    if work.empty:
        print_warnings([_empty_text(work.empty, len(shots.names), near=options["near"])])
    return result | {
        "path": found.path or None,
        "pictures": len(shots.names),
        "width": size[0],
        "height": size[1],
        "splats": model.count,
        "fps": work.fps,
        "device": model.device.name,
        **(model.drawn() if isinstance(model, LodArgument) else {}),
    }


def _empty_text(empty: int, count: int, *, near: float) -> str:
    return (
        f"No splat is in {number(empty)} of {count_text(count, 'picture')}: all are outside of the "
        f"view, or nearer than the near plane ({near:g} world units, see `--near`)."
    )


def _open(args: argparse.Namespace) -> ModelArgument | LodArgument:
    """Open the model, with the tolerance of levels of detail if it has them.

    Raises:
        ConfigError: options of levels of detail for a model without levels.
    """
    path = model_path(args)
    if not is_lod_file(path):
        if args.lod_px is not None or args.lod_splats is not None:
            raise ConfigError(
                f"`--lod-px` and `--lod-splats` need levels of detail, and {path} has none. Build "
                "them first: "
                + as_typed("lod", path, "-o", Path(path.name).with_suffix(LOD_ENDING))
            )
        return open_model(path)
    pixels = LOD_PX if args.lod_px is None else args.lod_px
    if not 0 <= pixels < math.inf or (args.lod_splats is not None and args.lod_splats < 1):
        raise ConfigError(
            f"`--lod-px` must be 0 or more, and `--lod-splats` 1 or more, got {pixels:g} and "
            f"{args.lod_splats}."
        )
    return LodArgument(model=LodModel(path), lod_px=pixels, most=args.lod_splats)


def _summary(args: argparse.Namespace, result: dict[str, Any]) -> str:
    count = count_text(result["pictures"], "picture")
    size = f"{result['width']} x {result['height']} px"
    text = f"Wrote {args.output}: {count}, {size}, rendered at {result['fps']:.1f} per second."
    others = _older(args.output, result)
    return f"{text}\nOther files in the folder are kept: {others}" if others else text


def _captures(args: argparse.Namespace, model: ModelArgument | LodArgument) -> list[DataConfig]:
    """Captures whose photos the pictures must not replace, since they have the same names."""
    given = [] if args.cameras is None else [DataConfig(source=args.cameras)]
    return given + ([] if model.data is None else [model.data])


def _older(output: Path, result: dict[str, Any]) -> str:
    """Other files in the folder of the stills, to distinguish them from the written ones."""
    written = [*result["files"], *result.get("depth_files", [])]
    parts = {Path(path).relative_to(output).parts[0] for path in written if output.is_dir()}
    return other_files(output, parts)


class _Work:
    """Iterator that renders the shots in order, times them and shows progress."""

    def __init__(
        self,
        model: ModelArgument | LodArgument,
        shots: Cameras,
        options: dict[str, Any],
        exposures: Sequence[PhotoExposure],
        status: Status,
    ) -> None:
        self.shots = shots
        self._model, self._options, self._status = model, options, status
        self._exposures = exposures
        self._seconds: list[float] = []
        self.empty = 0
        """Pictures without splats so far."""

    @property
    def fps(self) -> float:
        """Inverse of the median rendering time of a picture, without encoding and files."""
        return 1.0 / float(np.median(self._seconds)) if self._seconds else math.nan

    def __iter__(self) -> Iterator[Rendered]:
        names = self.shots.names
        progress = Counted(self._status, len(names), "picture")
        for i, name in enumerate(names):
            began = time.perf_counter()
            rendered = self._model.draw(*self._camera(i), **self._options)
            self._seconds.append(time.perf_counter() - began)
            self.empty += not rendered.alpha.any()
            if not self._exposures[i].neutral:
                rendered = rendered.exposed(self._exposures[i], self._options["background"])
            yield rendered
            progress(i + 1, name)

    def _camera(self, index: int) -> tuple[np.ndarray, np.ndarray, int, int]:
        """K, viewmat, width and height of a shot."""
        shots = self.shots
        size = int(shots.widths[index]), int(shots.heights[index])
        return shots.Ks[index], shots.viewmats[index], *size

    def samples(self, index: int, rendered: Rendered) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Samples of picture `index`, which is `rendered`; see `deep_channels`."""
        camera, options, model = self._camera(index), self._options, self._model
        assert isinstance(model, ModelArgument)  # `_render` refuses levels of detail
        bounds = layer_bounds(model.splats.means, *camera, options["near"])
        layers = (
            model.draw(*camera, **options | {"background": (0.0,) * 3, "near": a, "far": b})
            for a, b in pairwise(bounds)
        )
        return deep_channels(rendered, layers, options["background"])


def _stills(args: argparse.Namespace, names: Sequence[str]) -> tuple[list[Path], list[Path]]:
    """Files of the pictures and of their depth maps, if any.

    Raises:
        ConfigError: one file for several views.
    """
    is_file = args.output.suffix.lower() == ".png"
    if is_file and len(names) > 1:
        raise ConfigError(
            f"{args.output} is a single picture, but {count_text(len(names), 'view')} are "
            "selected; give a folder with -o, or one view with `--view`."
        )
    stems = [args.output.with_suffix("")] if is_file else []
    stems = stems or [args.output / name for name in still_names(names, depths=bool(args.depth))]
    pictures = [stem.with_name(f"{stem.name}.png") for stem in stems]
    ending = f"_depth.{_DEPTH_ENDINGS.get(args.depth)}"
    depths = [stem.with_name(f"{stem.name}{ending}") for stem in stems if args.depth]
    return pictures, depths


def _write_stills(
    args: argparse.Namespace, work: _Work, pictures: list[Path], depths: list[Path]
) -> dict[str, Any]:
    unit = 0.0
    for index, rendered in enumerate(work):
        pixels = to_rgba(rendered) if args.transparent else to_rgb(rendered)
        write_png(pictures[index], pixels, SIGNED)
        if args.depth and rendered.depth is not None:
            path = depths[index]
            unit = unit or float(rendered.depth.max()) / _DEPTH_STEPS
            if args.depth == "deep":
                write_deep(path, *work.samples(index, rendered))
            elif args.depth == "npy":
                write_depth_npy(path, rendered.depth)
            else:
                write_depth_png(path, rendered.depth, unit or 1.0)
    result: dict[str, Any] = {"files": [str(path) for path in pictures]}
    if args.depth:
        result["depth_files"] = [str(path) for path in depths]
        result["depth_unit"] = (unit or 1.0) if args.depth == "png" else 1.0
    return result


def _check_files(pictures: list[Path], depths: list[Path], *, overwrite: bool) -> None:
    """Raise ConfigError unless these files may be written; `depths` has one per picture or none."""
    files = list(pictures)
    for picture, depth in zip(pictures, depths, strict=bool(depths)):
        # These have no mark; they count as ours if their picture is.
        is_known = depth.suffix in (".npy", ".exr") and picture.is_file() and is_ours(picture)
        files += [] if is_known else [depth]
    check_replaced(files, overwrite=overwrite)


def _check_options(args: argparse.Namespace, *, is_video: bool) -> None:
    check_resolution(args.resolution)
    suffix = args.output.suffix.lower()
    if not _is_file(args.output) and _OTHER_FORMAT.fullmatch(suffix) and not args.output.is_dir():
        raise ConfigError(
            f"{args.output}: {suffix} is not supported; give a .png, an .mp4 or a folder, which "
            "must be there already if its name has such an ending."
        )
    if is_video and (args.transparent or args.depth):
        raise ConfigError("An MP4 has neither transparency nor depth; give a folder with -o.")
    views = args.view or args.all or args.test
    if args.frames is not None and not args.path and (views or not is_video):
        raise ConfigError("`--frames` needs `--path orbit` or `--path spline`.")
    if args.path and args.path not in PATHS and (args.frames is not None or args.cameras):
        raise ConfigError(
            f"`--path {args.path}` defines the camera of each picture: leave out `--frames` and "
            f"`--cameras`."
        )
    if args.fps is not None and not 0 < args.fps <= 1000:
        raise ConfigError(f"`--fps` must be above 0 and at most 1000, got {args.fps:g}.")
    if args.transparent and args.background is not None:
        raise ConfigError("Give either `--transparent` or `--background`.")
    if is_video:
        need_video()  # fail before the work instead of after it
    if args.depth == "deep":
        need_deep()


def _check_one_size(shots: Cameras) -> None:
    sizes = {(int(w), int(h)) for w, h in zip(shots.widths, shots.heights, strict=True)}
    if len(sizes) > 1:
        raise ConfigError(
            f"The views have {len(sizes)} sizes, but a video has one; give a width with -r, select "
            "views with `--view`, or use `--path`."
        )


def _color(text: str) -> tuple[float, float, float]:
    if text in _COLORS:
        return _COLORS[text]
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != 3 or not all(0 <= v <= 1 for v in values):
        raise argparse.ArgumentTypeError(f"{quoted(text)} is not black, white or r,g,b from 0 to 1")
    return values
