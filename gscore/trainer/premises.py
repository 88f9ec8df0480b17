"""What is looked over before the first step: whether cameras and splats can be trained at all."""

from collections.abc import Iterator

import numpy as np

from ..datasets.capture import listing
from ..errors import DatasetError
from ..io.ply import is_antialiased
from ..scene import distances
from ..words import count_words, number
from .trainer import Trainer

_FAR_FROM_ORIGIN = 1e4
_STRAY = 100.0
"""Distance from the middle of the cameras, as a multiple of the median, that is told."""
_OFF_AXIS = 10.0
"""Distance of the principal point from the middle, in sizes of the picture, that is told."""
_LOOKED_AT = 64
"""Training views, spread evenly, of which is told that they show nothing."""


def look_over(trainer: Trainer) -> list[str]:
    """Sentences for the user about a training that is about to begin or go on.

    Raises:
        DatasetError: no training view shows any splat, so that nothing could be learnt.
    """
    return [*_world(trainer), *_stray(trainer), *_off_axis(trainer), *_unseen(trainer)]


def _world(trainer: Trainer) -> Iterator[str]:
    frame, config = trainer.frame, trainer.config
    near = frame.near / frame.similarity.scale
    if near < 0.999 * config.near:
        yield (
            f"The capture is small in its own units, so the near plane was lowered from "
            f"{config.near:g} to {near:.3g}; use the same when rendering (--near {near:.3g})."
        )
    if config.start_splats and is_antialiased(config.start_splats) != config.antialias:
        yield (
            f"{config.start_splats} was trained {'without' if config.antialias else 'with'} "
            "antialiasing, unlike this run; small splats change their opacity at first."
        )
    offset = float(np.abs(frame.similarity.shift).max()) * frame.similarity.scale / frame.extent
    if offset > _FAR_FROM_ORIGIN:
        yield (
            f"The capture lies {offset:.0f} times its own size from the origin; the float32 "
            "numbers of a PLY are coarse there. Move its origin near the cameras before exporting."
        )


def _stray(trainer: Trainer) -> Iterator[str]:
    """Cameras and points far outside all others, by which the whole is measured."""
    scene = trainer.photos.scene
    centers = scene.cameras.centers
    middle = np.median(centers, axis=0)
    far, times = _far(centers, middle)
    if len(far):
        names = listing([scene.cameras.names[i] for i in far])
        yield (
            f"{names}: {times:.0f} times farther from the other cameras than these from each "
            "other. Sizes and learning rates follow the farthest camera; leave such views out."
        )
    far, times = _far(scene.points.points, middle)
    if len(far) > 0.001 * len(scene.points):
        yield (
            f"{number(len(far))} of {count_words(len(scene.points), 'point')} lie more than "
            f"{_STRAY:.0f} times farther from the cameras than half of the points do."
        )


def _far(places: np.ndarray, middle: np.ndarray) -> tuple[np.ndarray, float]:
    """Indices of places beyond _STRAY median distances, and how many the farthest lies away."""
    distance = distances(places, middle)
    median = float(np.median(distance)) if len(distance) else 0.0
    if len(distance) < 4 or not median > 0:
        return np.zeros(0, np.intp), 0.0
    return np.flatnonzero(distance > _STRAY * median), float(distance.max()) / median


def _off_axis(trainer: Trainer) -> Iterator[str]:
    """Cameras whose axis passes far outside their picture: shifted lenses never are so much."""
    cameras = trainer.photos.scene.cameras
    sizes = np.stack([cameras.widths, cameras.heights], axis=1)
    off = np.abs(cameras.Ks[:, :2, 2] / sizes - 0.5).max(axis=1)
    wrong = np.flatnonzero(off > _OFF_AXIS)
    if len(wrong):
        names = listing([cameras.names[i] for i in wrong])
        yield (
            f"{names}: the principal point lies {off.max():.0f} times the picture's size from its "
            "middle; no lens does that. Check the intrinsics."
        )


def _unseen(trainer: Trainer) -> Iterator[str]:
    """Views that show no splat at the start; DatasetError if none shows any."""
    if trainer.steps:
        return
    views = trainer.photos.train
    looked_at = views[:: -(-len(views) // _LOOKED_AT)]
    empty = [index for index in looked_at if not trainer.shows_splats(index)]
    if len(empty) == len(looked_at) and not any(map(trainer.shows_splats, views)):
        raise DatasetError(
            f"None of the {number(len(views))} training views shows any of the "
            f"{count_words(len(trainer.model), 'splat')} "
            "to start with, so nothing can be learnt. Do the cameras and the points, or the PLY of "
            "--start-splats, belong to one capture?"
        )
    if empty:
        names = listing([trainer.photos.scene.cameras.names[i] for i in empty])
        yield (
            f"{len(empty)} of {count_words(len(looked_at), 'training view')} looked at show no "
            f"splat at the start and may stay empty: {names}."
        )
