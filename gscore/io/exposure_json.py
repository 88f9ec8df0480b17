"""exposure.json: an affine colour transform per photo, in the format of 3DGS."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError
from ..json_text import parse_json
from ..photo_exposure import PhotoExposure
from .files import atomic_write, read_bytes

EXPOSURE_FILE = "exposure.json"


def write_exposures(path: Path, exposures: Mapping[str, PhotoExposure]) -> None:
    """Write {name of the photo: [3][4]}, rows R, G, B: photo = matrix @ (r, g, b, 1).

    Args:
        path: The file.
        exposures: By photo name.

    Raises:
        GsError: the file cannot be written.
    """
    maps = {
        name: np.column_stack([np.diag(exposure.gain), exposure.offset]).tolist()
        for name, exposure in exposures.items()
    }
    atomic_write(path, json.dumps(maps, indent=2).encode())


def read_exposures(run: Path | None) -> dict[str, PhotoExposure]:
    """Return the exposures of the photos of a run by name: diagonals and last columns of its file.

    Empty without a run, or for one without exposures.

    Raises:
        FormatError: the file is damaged.
    """
    path = None if run is None else run / EXPOSURE_FILE
    if path is None or not path.is_file():
        return {}
    try:
        maps: Any = parse_json(read_bytes(path))
        found = {str(name): np.array(rows, np.float64) for name, rows in maps.items()}
        if any(
            rows.shape != (3, 4) or not np.isfinite(rows).all() or (rows.diagonal() <= 0).any()
            for rows in found.values()
        ):
            raise ValueError("expected finite matrices [3][4] with positive diagonals")
    except (ValueError, TypeError, AttributeError) as error:
        raise FormatError(f"{path} is damaged ({error}). Train again to replace it.") from error
    return {name: PhotoExposure(rows.diagonal(), rows[:, 3]) for name, rows in found.items()}
