"""Page views: cameras, photos and first view, from a run, a capture, or the splats alone."""

import argparse
from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np

from ...config import DataConfig
from ...datasets import Dataset
from ...errors import ConfigError, GsError
from ...io.cameras_json import read_cameras_json
from ...io.images.pixels import as_uint8
from ...io.metrics_file import read_metrics
from ...io.ply.comments import stated_up
from ...metrics.evaluate import target_picture
from ...page.page import PageCamera
from ...quoting import brief
from ...report.pictures import data_uri, shrink, size_within
from ...scene import Cameras
from ...upright import turn_cameras, up_of, upright_turns
from ..args.model_argument import ModelArgument
from ..terminal.status import Counted, Status
from .camera_path import focus_point, look_at

_PHOTO_SIDE = 560
"""Longer side of a photo in the page, px."""
_ALONE = (1280, 800, 1000.0)
"""Width, height and focal length of the first view without cameras, px."""

_X, _Y, _Z = np.eye(3)
_UP_AND_FORWARD = {"-Y": (-_Y, _Z), "Y": (_Y, -_Z), "Z": (_Z, _Y), "-Z": (-_Z, -_Y), "X": (_X, _Z)}
"""Up and the direction of the first view, each [3], by the axis of a file that points up."""


@dataclass(frozen=True, kw_only=True)
class PageViews:
    """Cameras and limits of the view on the page."""

    cameras: list[PageCamera]
    first: PageCamera
    focus: np.ndarray
    """[3] float64, world units."""
    up: np.ndarray
    """[3] float64, unit."""
    warnings: list[str] = field(default_factory=list)
    """Sentences for the user."""


def find_views(args: argparse.Namespace, model: ModelArgument, status: Status) -> PageViews:
    """The cameras of `--source` or of the run, with photos if the capture exists.

    Args:
        args: Arguments of the verb.
        model: The splats.
        status: Shows the progress of reading photos.

    Raises:
        GsError: `--source` cannot be read.
    """
    warnings: list[str] = []
    dataset = _dataset(args, model, status, warnings)
    if dataset is not None:
        cameras, held_out = dataset.scene.cameras, {dataset.names[i] for i in dataset.test}
    else:
        cameras, held_out = _listed(args, model)
    cameras = None if cameras is None else model.world_of(cameras)
    if cameras is None or not len(cameras):
        return _without_cameras(model, warnings)
    turns = upright_turns(cameras)
    cameras = turn_cameras(cameras, turns)
    focus, up = focus_point(cameras.viewmats), up_of(cameras)
    first = _first(cameras, focus)
    photos: dict[int, str] = {}
    if dataset is not None:
        chosen = _at_even_distances(args.photos, len(cameras), first)
        photos = _photos(dataset, chosen, turns, model.background, status)
    shown = [_camera(cameras, i, held_out, photos.get(i, "")) for i in range(len(cameras))]
    return PageViews(cameras=shown, first=shown[first], focus=focus, up=up, warnings=warnings)


def _dataset(
    args: argparse.Namespace, model: ModelArgument, status: Status, warnings: list[str]
) -> Dataset | None:
    """The capture; None if photos are not requested or do not exist."""
    source = args.source
    if source is not None and not source.is_dir():
        return None
    if source is None and (model.data is None or not args.photos):
        return None
    config = DataConfig(source=source) if source is not None else model.data
    if model.data is not None and source is not None:
        config = replace(model.data, source=source)
    assert config is not None
    from ...datasets import load_dataset

    status.show([f"Reading the capture {config.source}"])
    try:
        return load_dataset(config)
    except GsError as error:
        if source is not None:
            raise
        warnings.append(f"The page contains no photos: {error} Or give the capture with -s.")
        return None


def _listed(
    args: argparse.Namespace, model: ModelArgument
) -> tuple[Cameras | None, Collection[str]]:
    """Cameras of a cameras.json, and the names of the held-out ones."""
    beside = model.run or model.path.parent
    path = args.source or beside / "cameras.json"
    if args.source is None and not path.is_file():
        return None, ()
    held_out = read_metrics(beside).get("test_views")
    return read_cameras_json(path), held_out if isinstance(held_out, list) else ()


def _photos(
    dataset: Dataset,
    chosen: list[int],
    turns: np.ndarray,
    background: tuple[float, float, float],
    status: Status,
) -> dict[int, str]:
    """Photos of some views as small JPEGs, rotated by the quarter turns [C] of each view."""
    dataset.limit_cache()
    progress = Counted(status, len(chosen), "photo")
    found: dict[int, str] = {}
    for done, index in enumerate(chosen):
        picture, _ = target_picture(
            dataset.image(index), dataset.mask(index), dataset.mask_mode, background
        )
        small = np.ascontiguousarray(np.rot90(as_uint8(picture), turns[index]))
        size = size_within(small.shape[1], small.shape[0], _PHOTO_SIDE)
        found[index] = data_uri(shrink(small, size))
        progress(done + 1, dataset.names[index])
    return found


def _at_even_distances(most: int, count: int, first: int) -> list[int]:
    """At most the given number of `count` views, including the first view of the page."""
    most = min(most, count)
    return sorted((first + i * count // most) % count for i in range(most))


def _camera(cameras: Cameras, i: int, held_out: Collection[str], photo: str) -> PageCamera:
    name = cameras.names[i]
    return PageCamera(
        name=name,
        label=f"{i + 1}: {name}{' (held out)' if name in held_out else ''}",
        viewmat=cameras.viewmats[i],
        K=cameras.Ks[i],
        width=int(cameras.widths[i]),
        height=int(cameras.heights[i]),
        photo=photo,
    )


def _first(cameras: Cameras, focus: np.ndarray) -> int:
    """The camera that faces the middle best, at a typical distance."""
    offsets = focus - cameras.centers
    far = np.maximum(np.linalg.norm(offsets, axis=1), 1e-12)
    facing = np.einsum("ci,ci->c", cameras.viewmats[:, 2, :3], offsets) / far
    unusual = np.abs(np.log(far / np.median(far)))
    return int(np.argmax(facing - 0.3 * unusual))


def _without_cameras(model: ModelArgument, warnings: list[str]) -> PageViews:
    """A view of most splats from the front; splat files have y down unless they state another up
    axis."""
    if not len(model.splats):
        raise ConfigError(
            f"{brief(str(model.path))} contains no splats to show; give another model."
        )
    low, middle, high = np.percentile(model.splats.means.astype(np.float64), (10, 50, 90), axis=0)
    axis = stated_up(model.file.comments)
    up, forward = _UP_AND_FORWARD.get(axis, _UP_AND_FORWARD["-Y"])
    width, height, focal = _ALONE
    size = max(float(np.linalg.norm(high - low)), 1e-6)
    eye = middle + (0.25 * up - forward) * size
    first = PageCamera(
        name="",
        label="first view",
        viewmat=look_at(eye, middle, up),
        K=np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]),
        width=int(width),
        height=int(height),
    )
    note = "There are no cameras next to the splats; give a capture or a cameras.json with -s."
    return PageViews(cameras=[], first=first, focus=middle, up=up, warnings=[*warnings, note])
