"""Preflight checks of cameras and splats before the first step."""

import math
from collections.abc import Iterator

import numpy as np

from ..datasets.poses import axis_warnings, position_warnings
from ..errors import DatasetError
from ..formats import is_antialiased
from ..metrics.photo_mismatch import photo_mismatch_warnings
from ..quoting import first_few
from ..text_format import count_text, number
from .trainer import Trainer

_FAR_FROM_ORIGIN = 1e4
_CHECKED = 64
"""About the most training views, evenly spaced, that are checked for splats."""

_FEW_IN_REGION = 100
"""Number of splats in a region below which it is probably the wrong box, so the user is warned."""
_COMPARED, _FACTOR = 8, 8
"""Training views that start splats are compared with, and the divisor of their sides."""


def check_training(trainer: Trainer) -> list[str]:
    """Return warnings about a training before its first or next step.

    Raises:
        DatasetError: no training view shows any splat.
    """
    scene = trainer.photos.scene
    poses = [*position_warnings(scene), *axis_warnings(scene)]
    return [*_splat_warnings(trainer), *poses, *_empty_views(trainer), *_other_scene(trainer)]


def _splat_warnings(trainer: Trainer) -> Iterator[str]:
    """Warnings about near plane, antialiasing, region, SH degree and origin."""
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
    count = trainer.models.trained_count
    if config.region and config.start_splats and not trainer.steps and count < _FEW_IN_REGION:
        yield (
            f"Only {count_text(count, 'splat')} of {config.start_splats} are in the region "
            f"{config.region}; gscore info prints the bounds of the splats."
        )
    if trainer.cut_degree > config.sh_degree:
        yield (
            f"The start splats have SH degree {trainer.cut_degree}, this run at most "
            f"{config.sh_degree}: the view dependence of higher degrees is lost."
        )
    offset = float(np.abs(frame.similarity.shift).max()) * frame.similarity.scale / frame.extent
    if offset > _FAR_FROM_ORIGIN:
        yield (
            f"The capture is {offset:.0f} times its own size from the origin, where the float32 "
            "numbers of a PLY are coarse. A new training writes splats about a local origin."
        )


def _other_scene(trainer: Trainer) -> list[str]:
    """Warnings if the start splats seem to belong to another scene."""
    if trainer.config.start_splats is None or trainer.steps:
        return []
    error = trainer.error(_COMPARED, _FACTOR)
    psnr = -20 * math.log10(max(error, 1e-6))
    return photo_mismatch_warnings(psnr, f"The splats of {trainer.config.start_splats}")


def _empty_views(trainer: Trainer) -> Iterator[str]:
    """A warning about views without splats at the start; DatasetError if all are empty."""
    if trainer.steps:
        return
    views = trainer.photos.train
    checked = views[:: -(-len(views) // _CHECKED)]
    empty = [index for index in checked if not trainer.renderer.shows_splats(index)]
    if len(empty) == len(checked) and not any(map(trainer.renderer.shows_splats, views)):
        raise DatasetError(
            f"None of the {number(len(views))} training views shows any of the "
            f"{count_text(trainer.splat_count, 'initial splat')}. Check that the cameras and the "
            "points, or the PLY of `--start-splats`, belong to one capture."
        )
    if empty:
        names = first_few([trainer.photos.scene.cameras.names[i] for i in empty])
        yield (
            f"{len(empty)} of {count_text(len(checked), 'checked training view')} show no splats "
            f"at the start and may stay empty: {names}."
        )
