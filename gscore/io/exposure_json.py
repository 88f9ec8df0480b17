"""exposure.json: an affine colour transform per photo, in the format of 3DGS."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError
from ..json_text import parse_json
from .files import atomic_write, read_bytes

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


def read_gains(run: Path | None) -> dict[str, np.ndarray]:
    """Return the gains of the photos of a run, [3] float64 by name: the diagonals of its file.

    Empty without a run, or for one without exposures.

    Raises:
        FormatError: the file is damaged.
    """
    path = None if run is None else run / EXPOSURE_FILE
    if path is None or not path.is_file():
        return {}
    try:
        maps: Any = parse_json(read_bytes(path))
        gains = {str(name): np.diagonal(np.array(rows, np.float64)) for name, rows in maps.items()}
        if any(gain.shape != (3,) or not (gain > 0).all() for gain in gains.values()):
            raise ValueError("expected matrices [3][4] with positive diagonals")
    except (ValueError, TypeError, AttributeError) as error:
        raise FormatError(f"{path} is damaged ({error}). Train again to replace it.") from error
    return gains
