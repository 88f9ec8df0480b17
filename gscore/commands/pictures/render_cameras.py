"""Cameras of `gscore render`, of a capture, run or path, and the exposures of their pictures."""

import argparse
import math
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np

from ...config import DataConfig
from ...datasets.camera_path_json import read_camera_path
from ...datasets.resolution import LARGEST_FACTOR, scale_intrinsics, target_size
from ...errors import ConfigError, DatasetError
from ...io.cameras_json import read_cameras_json
from ...io.exposure_json import read_exposures
from ...io.metrics_file import read_metrics
from ...photo_exposure import NEUTRAL, PhotoExposure
from ...scene import Cameras
from ...upright import turn_cameras, upright_turns
from ..args.model_argument import LodArgument, ModelArgument, is_capture
from .camera_path import orbit_path, spline_path

PATHS = ("orbit", "spline")
"""Computed paths; any other is a file."""
FPS = 30.0
"""Default frame rate, pictures a second."""
_ORBIT_SECONDS = 8.0
"""Default length of an orbit."""
_SPLINE_SECONDS = 0.25
"""Default length of a spline per camera; at least the length of an orbit."""
_LONGEST_SPLINE = 60.0
"""Maximum default length of a spline, s; captures of hundreds of photos are passed faster."""


@dataclass(frozen=True, kw_only=True)
class Shots:
    """Cameras to render from."""

    cameras: Cameras
    path: str
    """orbit, spline or the file of a path; empty: views."""
    fps: float | None = None
    """Pictures per second, if the file of a path states them."""
    why: str = ""
    """A sentence for the user if the path was chosen by default."""


def find_shots(
    args: argparse.Namespace, model: ModelArgument | LodArgument, *, is_video: bool
) -> Shots:
    """The cameras to render from, at the requested size.

    A video of all views would jump from photo to photo, so its default is an orbit, or a spline if
    the cameras have no common middle.

    Args:
        args: Arguments of the verb.
        model: The splats.
        is_video: The pictures become a video, whose sizes must be even.

    Raises:
        ConfigError: An impossible path or view.
        DatasetError: No cameras, or no such view.
    """
    if args.path and args.path not in PATHS:
        return _of_file(args, model, even=is_video)
    captured = captured_cameras(args.cameras, model)
    cameras = _scaled(captured.cameras, args.resolution, even=is_video)
    if args.path:
        return _along(cameras, args.path, args)
    if args.test:
        if not captured.test:
            raise DatasetError(
                "No view was held out, or the split is unknown: give the folder of a run that was "
                "trained with `--eval`, or select views with `--view` or `--all`."
            )
        return Shots(cameras=cameras.subset(captured.test), path="")
    if args.view:
        chosen = [view_index(view, cameras.names) for view in args.view]
        return Shots(cameras=cameras.subset(chosen), path="")
    if is_video and not args.all and len(cameras) > 1:
        return _some_path(cameras, args)
    return Shots(cameras=cameras, path="")


def _of_file(args: argparse.Namespace, model: ModelArgument | LodArgument, *, even: bool) -> Shots:
    """The cameras of a file, one per picture."""
    if not Path(args.path).is_file():
        raise ConfigError(
            f"`--path {args.path}`: neither {' nor '.join(PATHS)}, nor an existing file."
        )
    found = read_camera_path(args.path)
    return Shots(
        cameras=model.world_of(_scaled(found.cameras, args.resolution, even=even)),
        path=args.path,
        why=" ".join(found.warnings),
        fps=found.fps,
    )


def _some_path(cameras: Cameras, args: argparse.Namespace) -> Shots:
    """The default path of a video."""
    try:
        shots = _along(cameras, "orbit", args)
        what = "an orbit around the focus of the cameras"
        second, last = shots.cameras.viewmats[[1, -1]]
        if len(shots.cameras) > 2 and np.allclose(second, last):  # the same way back
            what = "a swing about the focus of the cameras, which lack a side of it"
    except ConfigError:  # the cameras have no common middle
        shots = _along(cameras, "spline", args)
        what = "a path through the cameras in their order, as they have no common middle"
    seconds = len(shots.cameras) / (args.fps or FPS)
    why = f"Default path: {what}, {seconds:.1f} s. `--all` makes a video of the views instead."
    return replace(shots, why=why)


@dataclass(frozen=True)
class Captured:
    """Cameras of photos."""

    cameras: Cameras
    test: list[int]
    """Indices of the held-out views; empty if unknown."""


def captured_cameras(source: Path | None, model: ModelArgument | LodArgument) -> Captured:
    """The cameras of a capture or run in the world of the model's splats, and its test views if
    known.

    Args:
        source: The folder of a capture or of a run, or a cameras.json; None: the cameras.json next
            to the model.
        model: The splats.

    Raises:
        ConfigError: There are no cameras next to the model.
        DatasetError: No cameras, or an unreadable capture.
    """
    if source is not None and (source / "cameras.json").is_file() and not is_capture(source):
        source = source / "cameras.json"
    if source is None and model.cameras is not None:
        return Captured(model.cameras, _test_views(model, model.cameras.names))
    if source is None:
        beside = (model.run or model.path.parent) / "cameras.json"
        if not beside.is_file():
            raise ConfigError(
                f"There is no cameras.json next to {model.path}; give the folder of a capture or a "
                "cameras.json with -s."
            )
        source = beside
    elif source.is_dir():
        from ...datasets import load_dataset

        config = DataConfig(source=source)
        if model.data is not None and model.data.source.resolve() == source.resolve():
            config = model.data
        dataset = load_dataset(replace(config, mask_mode="none"))  # only the cameras are used
        return Captured(model.world_of(dataset.scene.cameras), dataset.test)
    cameras = read_cameras_json(source)
    if not len(cameras):
        raise DatasetError(f"{source} contains no cameras.")
    return Captured(model.world_of(cameras), _test_views(model, cameras.names))


def _test_views(model: ModelArgument | LodArgument, names: tuple[str, ...]) -> list[int]:
    """Indices of the test views in the run's metrics.json."""
    held_out = read_metrics(model.run or model.path.parent).get("test_views")
    if not isinstance(held_out, list):
        return []
    return [i for i, name in enumerate(names) if name in held_out]


def _scaled(cameras: Cameras, resolution: float, *, even: bool) -> Cameras:
    """The cameras at other picture sizes; `even`: even sizes, as H.264 requires."""
    sizes, Ks = [], []
    for K, width, height in zip(cameras.Ks, cameras.widths, cameras.heights, strict=True):
        old = int(width), int(height)
        new = _size(old, resolution)
        if even:
            new = max(2, new[0] // 2 * 2), max(2, new[1] // 2 * 2)
        sizes.append(new)
        Ks.append(scale_intrinsics(K, old, new))
    widths, heights = np.array(sizes, np.int64).T.copy()
    return replace(cameras, Ks=np.stack(Ks), widths=widths, heights=heights)


def _size(photo: tuple[int, int], resolution: float) -> tuple[int, int]:
    """The size of a picture, px, as of training photos, but a given width may exceed the photo."""
    width, height = photo
    if resolution > LARGEST_FACTOR:
        return round(resolution), max(1, round(height * resolution / width))
    return target_size(width, height, resolution, max_width=width)


def _frames(args: argparse.Namespace, kind: str, cameras: int) -> int:
    """Number of pictures of a path."""
    if args.frames is not None:
        return args.frames
    seconds = _ORBIT_SECONDS
    if kind == "spline":
        seconds = min(max(seconds, _SPLINE_SECONDS * cameras), _LONGEST_SPLINE)
    return max(2, round(seconds * (args.fps or FPS)))


def _along(cameras: Cameras, kind: str, args: argparse.Namespace) -> Shots:
    """A camera path with upright pictures of the most frequent size."""
    cameras = turn_cameras(cameras, upright_turns(cameras))
    frames = _frames(args, kind, len(cameras))
    sizes = np.stack([cameras.widths, cameras.heights], axis=1)
    different, counts = np.unique(sizes, axis=0, return_counts=True)
    width, height = (int(n) for n in different[np.argmax(counts)])
    Ks = np.stack(
        [
            _fitted(K, (int(w), int(h)), (width, height))
            for K, (w, h) in zip(cameras.Ks, sizes, strict=True)
        ]
    )
    if kind == "spline":
        viewmats, Ks = spline_path(cameras.viewmats, Ks, frames)
    else:
        viewmats = orbit_path(cameras.viewmats, frames, up=cameras.up)
        K = np.median(Ks, axis=0)
        K[0, 2], K[1, 2] = width / 2, height / 2  # the focus is in the middle
        Ks = np.tile(K, (frames, 1, 1))
    path = Cameras(
        viewmats=viewmats,
        Ks=Ks,
        widths=np.full(frames, width, np.int64),
        heights=np.full(frames, height, np.int64),
        names=tuple(f"frame_{i:05d}" for i in range(frames)),
    )
    return Shots(cameras=path, path=kind)


def _fitted(K: np.ndarray, old: tuple[int, int], new: tuple[int, int]) -> np.ndarray:
    """K for another picture size; between portrait and landscape the diagonal field of view is
    kept, so that nothing is stretched."""
    if (old[0] > old[1]) == (new[0] > new[1]):
        return scale_intrinsics(K, old, new)
    scale = math.hypot(*new) / math.hypot(*old)
    K = K.copy()
    K[:2, 2] = np.array(new) / 2 + scale * (K[:2, 2] - np.array(old) / 2)
    K[[0, 1], [0, 1]] *= scale
    return K


def view_index(view: str, names: tuple[str, ...]) -> int:
    """Index of a view given by name, with or without folder and ending, or by number from 0."""
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
        f"There is no view {view}; give one of {len(names)} names such as {names[0]}, or a number "
        f"from 0 to {len(names) - 1}."
    )


EVEN, PHOTO = "even", "photo"
"""Choices besides the name of a photo."""


def find_exposures(
    choice: str | None, shots: Shots, model: ModelArgument | LodArgument, source: Path | None
) -> list[PhotoExposure]:
    """Return the exposure of each picture.

    Args:
        choice: `EVEN`, `PHOTO` (on a path that of the nearest camera), or the name or number of a
            photo; None: `PHOTO` for views and `EVEN` on a path.
        shots: Cameras of the pictures.
        model: The splats; exposures are those of its run.
        source: Cameras given for the pictures, as `captured_cameras` takes them.

    Raises:
        ConfigError: the run has no exposures.
        DatasetError: there is no such photo.
    """
    even = [NEUTRAL] * len(shots.cameras)
    if choice == EVEN or (choice is None and shots.path):
        return even
    exposures = read_exposures(model.run)
    if not exposures:
        if choice is None:
            return even
        raise ConfigError(
            f"`--exposure {choice}` needs exposure.json in the folder of the run: photos of this "
            "model were not trained with exposures (`gscore train --exposure on`)."
        )
    if choice not in (None, PHOTO):
        names = tuple(exposures)
        return [exposures[names[view_index(choice, names)]]] * len(even)
    names = shots.cameras.names
    if shots.path:
        photos = captured_cameras(source, model).cameras
        to_photos = photos.centers - shots.cameras.centers[:, None]
        nearest = np.linalg.norm(to_photos, axis=2).argmin(axis=1)
        names = [photos.names[i] for i in nearest]
    return [exposures.get(name, NEUTRAL) for name in names]
