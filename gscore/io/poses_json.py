"""poses.json: the camera poses after pose refinement."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError
from ..json_text import parse_json
from .files import atomic_write, read_bytes

POSES_FILE = "poses.json"


def write_poses(
    path: Path,
    names: list[str],
    viewmats: np.ndarray,
    degrees: np.ndarray,
    distances: np.ndarray,
    *,
    origin: np.ndarray | None = None,
) -> None:
    """Write {name of the photo: {"degrees", "distance", "viewmat"}}, with a local "origin".

    Args:
        path: The file.
        names: Of V photos.
        viewmats: [V, 4, 4] world to camera, world units: where cameras stand after the training.
        degrees: [V] how far they turned.
        distances: [V] how far they moved, world units.
        origin: [3], as `Cameras.origin`.

    Raises:
        GsError: it cannot be written.
    """
    about = {} if origin is None else {"origin": origin.tolist()}
    facts = {
        name: {
            "degrees": float(degrees[i]),
            "distance": float(distances[i]),
            "viewmat": viewmats[i].tolist(),
            **about,
        }
        for i, name in enumerate(names)
    }
    atomic_write(path, json.dumps(facts, indent=1).encode())


def read_moves(path: Path) -> dict[str, tuple[float, float]]:
    """Degrees and distance, world units, that each camera of a run moved, by name of its photo;
    nothing where there is no such file.

    Raises:
        FormatError: it is damaged.
    """
    if not path.is_file():
        return {}
    try:
        facts: Any = parse_json(read_bytes(path))
        return {
            str(name): (float(one["degrees"]), float(one["distance"]))
            for name, one in facts.items()
        }
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise FormatError(f"{path} is damaged ({error}). Train again to write it anew.") from error
