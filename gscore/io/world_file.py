"""World file: world.json with the up direction and local origin of a COLMAP model."""

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
"""Valid range of the largest component of a direction."""


def write_up(folder: Path, up: np.ndarray | None, origin: np.ndarray | None = None) -> None:
    """Write the up direction and the local origin of the model in `folder`.

    Args:
        folder: Folder of the model.
        up: [3], of any length; None: unknown.
        origin: [3], as `Cameras.origin`; None: none. Without both an existing file is removed.

    Raises:
        GsError: the file cannot be written.
    """
    facts = {} if up is None else {"up": checked_up(up).tolist()}
    facts |= {} if origin is None else {"origin": checked_origin(origin).tolist()}
    if facts:
        atomic_write(folder / WORLD_FILE, json.dumps(facts).encode())
    else:
        (folder / WORLD_FILE).unlink(missing_ok=True)


def read_up(folder: Path) -> np.ndarray | None:
    """[3] float64, unit: up direction in the world of the model in `folder`; None: unknown.

    Raises:
        FormatError: the file is damaged.
    """
    return _stated(folder)[0]


def read_origin(folder: Path) -> np.ndarray | None:
    """[3] float64: local origin of the model in `folder`; None: none.

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
        # A file with neither is damaged: reading `up` raises.
        up = checked_up(facts["up"]) if "up" in facts or origin is None else None
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(
            f"{path} states no up direction: expected up with three numbers, found {error}. "
            "Remove it to take the up direction from the cameras."
        ) from error
    return up, origin


def checked_up(values: object) -> np.ndarray:
    """Up direction as [3] float64 of length 1.

    Raises:
        ValueError: `values` are no three finite numbers, or have no length.
    """
    up = np.asarray(values)
    if up.shape != (3,) or up.dtype.kind not in "if":
        raise ValueError(f"up, {quoted(values)}")
    up = up.astype(np.float64)
    if not _LARGEST[0] < np.abs(up).max() < _LARGEST[1]:  # also refuses NaN
        raise ValueError(f"up, {quoted(values)}")
    return up / np.linalg.norm(up)
