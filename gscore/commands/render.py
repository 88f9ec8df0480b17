"""`gscore render`: pictures of a model from a capture's cameras, or a camera path as a video."""

import argparse
import math
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ..config import DataConfig
from ..datasets.resolution import check_resolution, scale_intrinsics, target_size
from ..errors import ConfigError, DatasetError
from ..io.cameras_json import read_cameras
from ..io.images import write_png
from ..io.metrics_file import read_metrics
from ..io.places import check_apart, check_place
from ..metrics.words import count_words
from ..raster.api import Rendered
from ..raster.api import render as render_view
from ..scene import Cameras
from .camera_path import orbit_path, spline_path
from .model import Model, add_model_argument, model_path, open_model
from .output import check_folder, others_in, print_json
from .stills import still_names, to_rgb, to_rgba, write_depth_npy, write_depth_png
from .video import need_video, write_video

_COLORS = {"black": (0.0, 0.0, 0.0), "white": (1.0, 1.0, 1.0)}
_OTHER_FORMATS = frozenset(
    {".avi", ".bmp", ".exr", ".gif", ".jpeg", ".jpg", ".mkv", ".mov", ".tif", ".tiff", ".webm"}
    | {".webp"}
)
"""Endings that show that a file was meant, not a folder."""
_DEPTH_STEPS = 60_000
"""16-bit values given to the depths of the first picture; the rest is for deeper ones."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    add_model_argument(parser)
    parser.add_argument(
        "-o", "--output", type=Path, required=True, help="folder, or one .png, or an .mp4"
    )
    group = parser.add_argument_group("cameras")
    group.add_argument(
        "-s",
        "--cameras",
        "--source",
        dest="cameras",
        type=Path,
        help="a capture's folder or a cameras.json; default: the run's",
    )
    which = group.add_mutually_exclusive_group()
    which.add_argument("--view", nargs="+", metavar="NAME", help="these views, by name or number")
    which.add_argument("--all", action="store_true", help="every view (the default)")
    which.add_argument("--test", action="store_true", help="the views the run held out")
    which.add_argument(
        "--path",
        choices=("orbit", "spline"),
        help="a moving camera: around the middle, or through all cameras in order",
    )
    group.add_argument("--frames", type=int, help="pictures along the path (240)")
    group.add_argument("--fps", type=float, default=30.0, help="pictures a second (30)")
    group.add_argument(
        "-r",
        "--resolution",
        type=float,
        default=-1,
        help="2, 4, 8: divide by it; larger: width; -1: as the cameras are, those of a run as it "
        "was trained (-1)",
    )
    group = parser.add_argument_group("picture")
    group.add_argument(
        "--background", type=_color, metavar="COLOR", help="black, white or r,g,b from 0 to 1"
    )
    group.add_argument("--transparent", action="store_true", help="PNG with alpha, no background")
    group.add_argument(
        "--depth", choices=("png", "npy"), help="depth maps too: 16-bit grey, or exact float32"
    )
    group.add_argument("--sh-degree", type=int, help="use only so many bands of the colour")
    group.add_argument("--near", type=float, help="near plane, world units")
    group.add_argument(
        "--antialias",
        action=argparse.BooleanOptionalAction,
        help="opacity compensation; default: as the model was trained",
    )
    parser.add_argument("--threads", type=int, default=0, help="0: all cores")
    parser.add_argument("--json", action="store_true", help="what was written as JSON on stdout")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(args: argparse.Namespace) -> int:
    """Render and write."""
    is_video = args.output.suffix.lower() == ".mp4"
    _check_options(args, is_video=is_video)
    is_file = is_video or args.output.suffix.lower() == ".png"
    check_folder(args.output.parent if is_file else args.output)
    model = open_model(model_path(args))
    for data in _captures(args, model):
        if is_file:
            check_apart(args.output.parent, data)
        else:
            check_place(args.output, data)
    for sentence in model.warnings:
        print(f"Warning: {sentence}", file=sys.stderr)
    shots = _shots(args, model, even=is_video)
    background = model.background if args.background is None else args.background
    options = {
        "background": (0.0, 0.0, 0.0) if args.transparent else background,
        "sh_degree": args.sh_degree,
        "near": model.near if args.near is None else args.near,
        "antialias": model.antialias if args.antialias is None else args.antialias,
        "depths": args.depth is not None,
        "threads": args.threads,
    }
    work = _Work(model, shots, options, quiet=args.quiet)
    if is_video:
        _check_one_size(shots)
        write_video(args.output, (to_rgb(r) for r in work), fps=args.fps)
        result: dict[str, Any] = {"files": [str(args.output)]}
    else:
        result = _write_stills(args, work)
    result |= {
        "pictures": len(shots.names),
        "width": int(shots.widths[0]),
        "height": int(shots.heights[0]),
        "splats": len(model.splats),
        "fps": work.fps,
    }
    if args.json:
        print_json(result)
    else:
        count = count_words(len(shots.names), "picture")
        print(f"Wrote {args.output}: {count}, rendered at {work.fps:.1f} fps.")
        if others := _older(args.output, result):
            print(f"Files that were there before stay: {others}")
    return 0


def _captures(args: argparse.Namespace, model: Model) -> list[DataConfig]:
    """The captures whose photos the pictures must not replace, which have the same names."""
    given = [] if args.cameras is None else [DataConfig(source=args.cameras)]
    return given + ([] if model.data is None else [model.data])


def _older(output: Path, result: dict[str, Any]) -> str:
    """What else lies in the folder of the stills, so that nobody takes it for what was written."""
    written = [*result["files"], *result.get("depth_files", [])]
    parts = {Path(path).relative_to(output).parts[0] for path in written if output.is_dir()}
    return others_in(output, parts)


class _Work:
    """Renders the shots one after the other, times it and shows progress."""

    def __init__(
        self, model: Model, shots: Cameras, options: dict[str, Any], *, quiet: bool
    ) -> None:
        self.shots = shots
        self._model, self._options, self._quiet = model, options, quiet
        self._seconds: list[float] = []

    @property
    def fps(self) -> float:
        """One over the median time of a picture; files and video are not in it."""
        return 1.0 / float(np.median(self._seconds)) if self._seconds else math.nan

    def __iter__(self) -> Iterator[Rendered]:
        shots = self.shots
        count = len(shots.names)
        for i in range(count):
            began = time.perf_counter()
            size = int(shots.widths[i]), int(shots.heights[i])
            rendered = render_view(
                self._model.splats, shots.Ks[i], shots.viewmats[i], *size, **self._options
            )
            self._seconds.append(time.perf_counter() - began)
            if not self._quiet and (sys.stderr.isatty() or (i + 1) % 10 == 0 or i + 1 == count):
                end = "\r" if sys.stderr.isatty() and i + 1 < count else "\n"
                name = PurePosixPath(shots.names[i]).with_suffix("") if shots.names[i] else "view"
                print(f"{i + 1}/{count} {name}", end=end, file=sys.stderr, flush=True)
            yield rendered


def _write_stills(args: argparse.Namespace, work: _Work) -> dict[str, Any]:
    is_file = args.output.suffix.lower() == ".png"
    if is_file and len(work.shots.names) > 1:
        raise ConfigError(
            f"{args.output} is one picture, but {len(work.shots.names)} views were chosen; give a "
            "folder with -o, or one view with --view."
        )
    stems = [args.output.with_suffix("")] if is_file else []
    stems = stems or [args.output / name for name in still_names(work.shots.names)]
    files, depth_files, unit = [], [], 0.0
    for stem, rendered in zip(stems, work, strict=True):
        picture = stem.with_name(stem.name + ".png")
        write_png(picture, to_rgba(rendered) if args.transparent else to_rgb(rendered))
        files.append(str(picture))
        if args.depth and rendered.depth is not None:
            path = stem.with_name(f"{stem.name}_depth.{args.depth}")
            unit = unit or float(rendered.depth.max()) / _DEPTH_STEPS
            if args.depth == "npy":
                write_depth_npy(path, rendered.depth)
            else:
                write_depth_png(path, rendered.depth, unit or 1.0)
            depth_files.append(str(path))
    result: dict[str, Any] = {"files": files}
    if args.depth:
        result["depth_files"] = depth_files
        result["depth_unit"] = (unit or 1.0) if args.depth == "png" else 1.0
    return result


def _check_options(args: argparse.Namespace, *, is_video: bool) -> None:
    check_resolution(args.resolution)
    suffix = args.output.suffix.lower()
    if suffix in _OTHER_FORMATS and not args.output.is_dir():
        raise ConfigError(
            f"{args.output}: {suffix} files are not written; give a .png, an .mp4 or a folder."
        )
    if is_video and (args.transparent or args.depth):
        raise ConfigError("An MP4 holds neither transparency nor depth; give a folder with -o.")
    if args.frames is not None and args.path is None:
        raise ConfigError("--frames belongs to --path orbit or --path spline.")
    if not 0 < args.fps <= 1000:
        raise ConfigError(f"--fps must be above 0 and at most 1000, got {args.fps:g}.")
    if args.transparent and args.background is not None:
        raise ConfigError("Give either --transparent or --background.")
    if is_video:
        need_video()  # say so before the work, not after it


def _shots(args: argparse.Namespace, model: Model, *, even: bool) -> Cameras:
    """The cameras to render from, at the size asked for."""
    captured = _captured(args, model)
    cameras = _scaled(captured.cameras, args.resolution, even=even)
    if args.path:
        return _along(cameras, args.path, 240 if args.frames is None else args.frames)
    if args.test:
        if not captured.test:
            raise DatasetError(
                "No view was held out, or the split is not known: give the folder of a run that "
                "was trained with --eval, or choose views with --view or --all."
            )
        return _subset(cameras, captured.test)
    if args.view:
        return _subset(cameras, [_index(view, cameras.names) for view in args.view])
    return cameras


@dataclass(frozen=True)
class _Captured:
    cameras: Cameras
    test: list[int]


def _captured(args: argparse.Namespace, model: Model) -> _Captured:
    """The cameras of the capture or run, and its test views where they are known."""
    source = args.cameras
    if source is None:
        beside = (model.run or model.ply.parent) / "cameras.json"
        if not beside.is_file():
            raise ConfigError(
                f"There is no cameras.json beside {model.ply}; say with -s where cameras are: the "
                "capture's folder or a cameras.json."
            )
        source = beside
    elif source.is_dir():
        from ..datasets import load_dataset

        config = DataConfig(source=source)
        if model.data is not None and model.data.source.resolve() == source.resolve():
            config = model.data
        dataset = load_dataset(config)
        return _Captured(dataset.scene.cameras, dataset.test)
    cameras = read_cameras(source)
    if not len(cameras):
        raise DatasetError(f"{source} holds no cameras.")
    return _Captured(cameras, _test_views(model, cameras.names))


def _test_views(model: Model, names: tuple[str, ...]) -> list[int]:
    """Indices of the views the run's metrics.json calls test views."""
    held_out = read_metrics(model.run or model.ply.parent).get("test_views")
    if not isinstance(held_out, list):
        return []
    return [i for i, name in enumerate(names) if name in held_out]


def _scaled(cameras: Cameras, resolution: float, *, even: bool) -> Cameras:
    """The cameras with other picture sizes; `even`: sizes that H.264 can store."""
    sizes, Ks = [], []
    for K, width, height in zip(cameras.Ks, cameras.widths, cameras.heights, strict=True):
        old = int(width), int(height)
        new = target_size(*old, resolution, max_width=old[0])
        if even:
            new = max(2, new[0] // 2 * 2), max(2, new[1] // 2 * 2)
        sizes.append(new)
        Ks.append(scale_intrinsics(K, old, new))
    widths, heights = np.array(sizes, np.int64).T.copy()
    return Cameras(
        viewmats=cameras.viewmats,
        Ks=np.stack(Ks),
        widths=widths,
        heights=heights,
        names=cameras.names,
    )


def _along(cameras: Cameras, kind: str, frames: int) -> Cameras:
    """A camera path, with pictures of the size most cameras have."""
    sizes = np.stack([cameras.widths, cameras.heights], axis=1)
    different, counts = np.unique(sizes, axis=0, return_counts=True)
    width, height = (int(n) for n in different[np.argmax(counts)])
    Ks = np.stack(
        [
            scale_intrinsics(K, (int(w), int(h)), (width, height))
            for K, (w, h) in zip(cameras.Ks, sizes, strict=True)
        ]
    )
    if kind == "spline":
        viewmats, Ks = spline_path(cameras.viewmats, Ks, frames)
    else:
        viewmats = orbit_path(cameras.viewmats, frames)
        K = np.median(Ks, axis=0)
        K[0, 2], K[1, 2] = width / 2, height / 2  # what the orbit looks at is in the middle
        Ks = np.tile(K, (frames, 1, 1))
    return Cameras(
        viewmats=viewmats,
        Ks=Ks,
        widths=np.full(frames, width, np.int64),
        heights=np.full(frames, height, np.int64),
        names=tuple(f"frame_{i:05d}" for i in range(frames)),
    )


def _subset(cameras: Cameras, indices: list[int]) -> Cameras:
    return Cameras(
        viewmats=cameras.viewmats[indices],
        Ks=cameras.Ks[indices],
        widths=cameras.widths[indices],
        heights=cameras.heights[indices],
        names=tuple(cameras.names[i] for i in indices),
    )


def _index(view: str, names: tuple[str, ...]) -> int:
    """The view called so, with or without folder and ending, or the number of a view from 0."""
    for form in (str, lambda n: PurePosixPath(n).name, lambda n: PurePosixPath(n).stem):
        found = [i for i, name in enumerate(names) if form(name) == view]
        if len(found) == 1:
            return found[0]
        if found:
            raise DatasetError(
                f"{len(found)} views are called {view}: {', '.join(names[i] for i in found[:3])}; "
                "give the whole name."
            )
    if view.isdigit() and int(view) < len(names):
        return int(view)
    raise DatasetError(
        f"There is no view {view}; there are {len(names)}, named like {names[0]}, or by number "
        f"from 0 to {len(names) - 1}."
    )


def _check_one_size(shots: Cameras) -> None:
    sizes = {(int(w), int(h)) for w, h in zip(shots.widths, shots.heights, strict=True)}
    if len(sizes) > 1:
        raise ConfigError(
            f"The views have {len(sizes)} sizes, a video has one; give a width with -r, choose "
            "views with --view, or use --path."
        )


def _color(text: str) -> tuple[float, float, float]:
    if text in _COLORS:
        return _COLORS[text]
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != 3 or not all(0 <= v <= 1 for v in values):
        raise argparse.ArgumentTypeError(f"{text!r} is not black, white or r,g,b from 0 to 1")
    return values
