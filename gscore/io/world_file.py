"""world.json beside a COLMAP model: what is known of its world that its own files cannot say."""

import json
from pathlib import Path

import numpy as np

from ..errors import FormatError
from ..json_text import parse_json
from ..shown import quoted
from .files import atomic_write, read_bytes

WORLD_FILE = "world.json"
_LARGEST = (1e-6, 1e6)
"""Of a direction's numbers, where the file is not damaged."""


def write_up(folder: Path, up: np.ndarray | None) -> None:
    """State what is up in the world of the model in `folder`.

    Args:
        folder: Of the model's three files.
        up: [3], of any length; None: nothing is known, and an older file goes.

    Raises:
        GsError: it cannot be written.
    """
    if up is None:
        (folder / WORLD_FILE).unlink(missing_ok=True)
    else:
        atomic_write(folder / WORLD_FILE, json.dumps({"up": checked_up(up).tolist()}).encode())


def read_up(folder: Path) -> np.ndarray | None:
    """[3] float64, unit: up in the world of the model in `folder`; None where nobody has stated it.

    Raises:
        FormatError: the file is damaged.
    """
    path = folder / WORLD_FILE
    if not path.exists():
        return None
    try:
        facts = parse_json(read_bytes(path))
        return checked_up(facts["up"])
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(
            f"{path} does not state what is up: expected up with three numbers, found {error}. "
            "Remove it, and up is taken from the cameras."
        ) from error


def checked_up(values: object) -> np.ndarray:
    """[3] float64 of length 1.

    Raises:
        ValueError: these are no three finite numbers, or have no length.
    """
    up = np.asarray(values)
    if up.shape != (3,) or up.dtype.kind not in "if":
        raise ValueError(f"up, {quoted(values)}")
    up = up.astype(np.float64)
    if not _LARGEST[0] < np.abs(up).max() < _LARGEST[1]:  # not for NaN either
        raise ValueError(f"up, {quoted(values)}")
    return up / np.linalg.norm(up)
