"""Preflight checks before the first step: whether cameras and splats can be trained."""

import math
from collections.abc import Iterator

import numpy as np

from ..datasets.capture import listing
from ..datasets.pose_warnings import axis_warnings, position_warnings
from ..errors import DatasetError
from ..formats import is_antialiased
from ..metrics.photo_mismatch import photo_mismatch_warnings
from ..text_format import count_words, number
from .trainer import Trainer

_FAR_FROM_ORIGIN = 1e4
_LOOKED_AT = 64
"""Training views, spread evenly, that are checked for splats."""

_FEW_IN_REGION = 100
"""Fewer splats than this in a region cause a warning: it is probably the wrong box."""
_GLANCED_AT, _GLANCE = 8, 8
"""Training views that given splats are compared with, and the divisor of their sides."""


def check_training(trainer: Trainer) -> list[str]:
    """Warnings for the user about a training before its first or next step.

    Raises:
        DatasetError: no training view shows any splat, so nothing can be learnt.
    """
    scene = trainer.photos.scene
    placed = [*position_warnings(scene), *axis_warnings(scene)]
    return [*_world(trainer), *placed, *_unseen(trainer), *_strange(trainer)]


def _world(trainer: Trainer) -> Iterator[str]:
    frame, config = trainer.frame, trainer.config
    near = frame.world_near
    if near < 0.999 * config.near:
        yield (
            f"The capture is small in its own units, so the near plane was lowered from "
            f"{config.near:g} to {near:.3g}, which the PLY states; "
            "other programs may need the same."
        )
    if config.start_splats and is_antialiased(config.start_splats) != config.antialias:
        yield (
            f"{config.start_splats} was trained {'without' if config.antialias else 'with'} "
            "antialiasing, unlike this run; small splats change their opacity at first."
        )
    count = trainer.trained_count
    if config.region and config.start_splats and not trainer.steps and count < _FEW_IN_REGION:
        yield (
            f"Only {count_words(count, 'splat')} of {config.start_splats} lie in the region "
            f"{config.region}; gscore info says where splats are."
        )
    if trainer.cut_degree > config.sh_degree:
        yield (
            f"The splats to start from have SH degree {trainer.cut_degree}, this run "
            f"{config.sh_degree} at most: what depends on the direction beyond it is lost."
        )
    offset = float(np.abs(frame.similarity.shift).max()) * frame.similarity.scale / frame.extent
    if offset > _FAR_FROM_ORIGIN:
        yield (
            f"The capture lies {offset:.0f} times its own size from the origin; the float32 "
            "numbers of a PLY are coarse there. A training that starts anew writes splats about a "
            "local origin."
        )


def _strange(trainer: Trainer) -> list[str]:
    """Warnings where the start splats seem to belong to another scene."""
    if trainer.config.start_splats is None or trainer.steps:
        return []
    views = trainer.photos.train
    error = trainer.renderer.error(views[:: -(-len(views) // _GLANCED_AT)], _GLANCE)
    psnr = -20 * math.log10(max(error, 1e-6))
    return photo_mismatch_warnings(psnr, f"The splats of {trainer.config.start_splats}")


def _unseen(trainer: Trainer) -> Iterator[str]:
    """A warning on views without a splat at the start; DatasetError if all are empty."""
    if trainer.steps:
        return
    views = trainer.photos.train
    looked_at = views[:: -(-len(views) // _LOOKED_AT)]
    empty = [index for index in looked_at if not trainer.renderer.shows_splats(index)]
    if len(empty) == len(looked_at) and not any(map(trainer.renderer.shows_splats, views)):
        raise DatasetError(
            f"None of the {number(len(views))} training views shows any of the "
            f"{count_words(trainer.splat_count, 'splat')} "
            "to start with, so nothing can be learnt. Do the cameras and the points, or the PLY of "
            "--start-splats, belong to one capture?"
        )
    if empty:
        names = listing([trainer.photos.scene.cameras.names[i] for i in empty])
        yield (
            f"{len(empty)} of {count_words(len(looked_at), 'training view')} looked at show no "
            f"splat at the start and may stay empty: {names}."
        )
