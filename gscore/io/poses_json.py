"""poses.json: camera poses after pose refinement."""

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
        names: Names of V photos.
        viewmats: [V, 4, 4] world to camera after the training, world units.
        degrees: [V] rotation of each camera by the refinement.
        distances: [V] translation of each camera by the refinement, world units.
        origin: [3], as `Cameras.origin`.

    Raises:
        GsError: the file cannot be written.
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
    """Rotation in degrees and translation in world units of each camera of a run, by name of its
    photo; empty without the file.

    Raises:
        FormatError: the file is damaged.
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
        raise FormatError(f"{path} is damaged ({error}). Train again to replace it.") from error
