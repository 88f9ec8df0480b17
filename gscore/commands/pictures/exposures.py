"""Exposures of rendered pictures: even, that of their photo, or that of one photo for all."""

from pathlib import Path

import numpy as np

from ...errors import ConfigError
from ...io.exposure_json import read_gains
from ..args.lod_argument import LodArgument
from ..args.model_argument import ModelArgument
from .render_cameras import Shots, captured_cameras, view_index

EVEN, PHOTO = "even", "photo"
"""Choices besides the name of a photo."""


def exposure_gains(
    choice: str | None, shots: Shots, model: ModelArgument | LodArgument, source: Path | None
) -> np.ndarray:
    """Return the gain of each picture, [P, 3] float64, 1 for the mean exposure.

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
    even = np.ones((len(shots.cameras), 3))
    if choice == EVEN or (choice is None and shots.path):
        return even
    gains = read_gains(model.run)
    if not gains:
        if choice is None:
            return even
        raise ConfigError(
            f"`--exposure {choice}` needs exposure.json in the folder of the run: photos of this "
            "model were not trained with exposures (`gscore train --exposure on`)."
        )
    if choice not in (None, PHOTO):
        return even * gains[tuple(gains)[view_index(choice, tuple(gains))]]
    names = shots.cameras.names
    if shots.path:
        photos = captured_cameras(source, model).cameras
        to_photos = photos.centers - shots.cameras.centers[:, None]
        nearest = np.linalg.norm(to_photos, axis=2).argmin(axis=1)
        names = [photos.names[i] for i in nearest]
    return np.stack([gains.get(name, np.ones(3)) for name in names])
