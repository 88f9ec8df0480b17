"""World file: world.json with facts of a COLMAP model's world that its files cannot store."""

import json
from pathlib import Path

import numpy as np

from ..errors import FormatError
from ..json_text import parse_json
from ..quoting import quoted
from ..scene import checked_origin
from .files import atomic_write, read_bytes

WORLD_FILE = "world.json"
_LARGEST = (1e-6, 1e6)
"""Of a direction's numbers, where the file is not damaged."""


def write_up(folder: Path, up: np.ndarray | None, origin: np.ndarray | None = None) -> None:
    """State what is up in the world of the model in `folder`, and which local origin it is about.

    Args:
        folder: Of the model's three files.
        up: [3], of any length; None: it is not known.
        origin: [3], as `Cameras.origin`. Where neither is known, an older file goes.

    Raises:
        GsError: it cannot be written.
    """
    facts = {} if up is None else {"up": checked_up(up).tolist()}
    facts |= {} if origin is None else {"origin": checked_origin(origin).tolist()}
    if facts:
        atomic_write(folder / WORLD_FILE, json.dumps(facts).encode())
    else:
        (folder / WORLD_FILE).unlink(missing_ok=True)


def read_up(folder: Path) -> np.ndarray | None:
    """[3] float64, unit: up in the world of the model in `folder`; None where nobody has stated it.

    Raises:
        FormatError: the file is damaged.
    """
    return _stated(folder)[0]


def read_origin(folder: Path) -> np.ndarray | None:
    """[3] float64: the local origin that the model in `folder` is about; None: it has none.

    Raises:
        FormatError: the file is damaged.
    """
    return _stated(folder)[1]


def _stated(folder: Path) -> tuple[np.ndarray | None, np.ndarray | None]:
    path = folder / WORLD_FILE
    if not path.exists():
        return None, None
    try:
        facts = parse_json(read_bytes(path))
        origin = checked_origin(facts["origin"]) if "origin" in facts else None
        # A file with neither is damaged, so that up is asked for.
        up = checked_up(facts["up"]) if "up" in facts or origin is None else None
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(
            f"{path} does not state what is up: expected up with three numbers, found {error}. "
            "Remove it, and up is taken from the cameras."
        ) from error
    return up, origin


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
