"""exposure.json: an affine colour transform per photo, in the format of 3DGS."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .files import atomic_write

EXPOSURE_FILE = "exposure.json"


def write_exposures(path: Path, gains: Mapping[str, np.ndarray]) -> None:
    """Write {name of the photo: [3][4]}, rows R, G, B: photo = matrix @ (r, g, b, 1).

    Args:
        path: The file.
        gains: [3] gains per channel by photo name.

    Raises:
        GsError: the file cannot be written.
    """
    maps = {
        name: np.column_stack([np.diag(gain.astype(np.float64)), np.zeros(3)]).tolist()
        for name, gain in gains.items()
    }
    atomic_write(path, json.dumps(maps, indent=2).encode())
