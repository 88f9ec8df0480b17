"""Region file: an oriented box, the part of a capture to train."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError
from ..json_text import parse_json
from ..quoting import brief
from .files import atomic_write, read_bytes

_LAYOUT = (
    '{"box": ...} with the 4 x 4 matrix that maps the cube from -1 to 1 to the box in the '
    'capture\'s world, or {"low": [x, y, z], "high": [x, y, z]}'
)


def read_region(path: str | Path) -> np.ndarray:
    """Read the box of a region: [4, 4] float64, maps the cube [-1, 1]^3 to it in the capture's
    world.

    Raises:
        DatasetError: there is no such file, or it cannot be read.
        FormatError: it has no box, or the box has no volume.
    """
    try:
        content: Any = parse_json(read_bytes(path))
        matrix = _matrix(content)
    except (ValueError, TypeError, KeyError, OverflowError) as error:
        raise FormatError(
            f"{brief(path)} is not a region ({error}); expected {_LAYOUT}."
        ) from error
    return matrix


def write_region(path: str | Path, box: np.ndarray) -> None:
    """Write a box, [4, 4] as `read_region` returns it, completely or not at all.

    Raises:
        GsError: the file cannot be written.
        ValueError: the box has no volume.
    """
    rows = _checked(np.asarray(box, np.float64)).tolist()
    atomic_write(path, (json.dumps({"box": rows}, indent=1) + "\n").encode())


def _matrix(content: Any) -> np.ndarray:
    if not isinstance(content, dict) or not {"box", "low", "high"} & set(content):
        raise ValueError("it has no box")
    if "box" not in content and not {"low", "high"} <= set(content):
        raise ValueError("it has one corner of two")
    if "box" in content:
        return _checked(np.array(content["box"], np.float64))
    low, high = (np.array(content[key], np.float64) for key in ("low", "high"))
    if low.shape != (3,) or high.shape != (3,):
        raise ValueError("a corner has three numbers")
    if not (low < high).all():
        raise ValueError("its low corner is not below its high one")
    return _checked(box_of_corners(low, high))


def box_of_corners(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """[4, 4] float64 that maps the cube [-1, 1]^3 to the box from `low` [3] to `high` [3]."""
    matrix = np.diag([*(high - low) / 2, 1.0])
    matrix[:3, 3] = (low + high) / 2
    return matrix


def _checked(matrix: np.ndarray) -> np.ndarray:
    """Return `matrix` if its box has a volume; else raise ValueError."""
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError("its box is no 4 x 4 matrix of numbers")
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise ValueError("the last row of its matrix is not 0 0 0 1")
    sides = np.linalg.norm(matrix[:3, :3], axis=0)
    if not (sides > 0).all() or abs(np.linalg.det(matrix[:3, :3] / sides)) < _FLAT:
        raise ValueError("its box has no volume")
    return matrix


_FLAT = 1e-6
"""Least volume of a box after scaling its sides to length 1."""
