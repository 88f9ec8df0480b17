"""White level: the light in splats up to which the photos of their training show it; no bpy."""

from pathlib import Path

import numpy as np

from ..cameras.camera_math import project
from ..core import read_cameras, read_exposures
from ..srgb import decode

_CAMERAS = "cameras.json"


def white_level(run: Path, place: np.ndarray) -> float:
    """Linear light of splats that is white in the shortest exposure that shows a place; 1 where
    none shows it, and for runs without exposures.

    Args:
        run: Folder of the training.
        place: Position [3] in the space of its splats.

    Raises:
        GsError: a file of it is damaged.
    """
    exposures = read_exposures(run)
    if not exposures or not (run / _CAMERAS).is_file():
        return 1.0
    cameras = read_cameras(run / _CAMERAS)
    levels = []
    for name, K, viewmat, *size in zip(
        cameras.names, cameras.Ks, cameras.viewmats, cameras.widths, cameras.heights, strict=True
    ):
        if name not in exposures:
            continue
        with np.errstate(all="ignore"):  # behind the camera
            (pixel,), (depth,) = project(place[None], K, viewmat)
        if depth > 0 and (pixel >= 0).all() and (pixel < size).all():
            levels.append(float(decode(exposures[name].undo(np.ones(3))).min()))
    return max(levels, default=1.0)
