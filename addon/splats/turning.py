"""Shapes and colors of the splats of a mesh turned, mirrored and scaled, places as they are."""

from typing import Any, NamedTuple

import numpy as np

from .. import attributes
from ..core import Splats, transform_splats

Rows = slice | np.ndarray
_BLOCK = 1 << 12
"""Splats turned at once: their coefficients fit a cache."""


class _Linear(NamedTuple):
    """What a turn does, as matrices: on attributes as they lie, a third of the time of reading,
    transforming and writing splats. They are what becomes of unit splats."""

    quats: np.ndarray
    """[4, 4] float32"""
    factor: np.float32
    """Of scales."""
    harmonics: np.ndarray
    """[K, K] float32, of coefficients."""


def turn_along(mesh: Any, turns: np.ndarray, numbers: np.ndarray) -> None:
    """Turn quaternions, scales and SH coefficients; all else, and splats that no turn changes, stay
    to the bit.

    Args:
        mesh: Has the attributes of N splats.
        turns: [P, 3, 3], linear parts of similarities.
        numbers: [N] int, the turn of each splat; negative: none.

    Raises:
        ValueError: attributes are missing or not finite, or a turn stretches; nothing is changed.
    """
    attributes.check(mesh)
    count = attributes.sh_count(mesh)
    steps: list[tuple[np.ndarray, _Linear]] = []
    for number, turn in enumerate(turns):
        chosen = numbers == number
        if chosen.any() and not np.array_equal(turn, np.eye(3)):
            steps.append((np.flatnonzero(chosen), _linear(turn, count)))
    names = [attributes.ROTATION, attributes.SCALE, *(f"{attributes.SH}{k}" for k in range(count))]
    columns = [attributes.column(mesh, name) for name in names]
    for rows, linear in steps:
        at = _range(rows)
        columns[0][at] = columns[0][at] @ linear.quats.T
        columns[1][at] *= linear.factor
        _turn_harmonics(columns[2:], rows, linear.harmonics)
    for name, values in zip(names, columns, strict=True):
        attributes.fill(mesh, name, mesh.attributes[name].data_type, values.reshape(-1))
    mesh.update()


def _linear(turn: np.ndarray, count: int) -> _Linear:
    """Of a turn, for so many SH coefficients."""
    units = max(count, 4)
    matrix = np.eye(4)
    matrix[:3, :3] = turn
    quats = np.zeros((units, 4), np.float32)
    quats[:4] = np.eye(4)
    made = transform_splats(
        Splats(
            means=np.zeros((units, 3), np.float32),
            quats=quats,
            scales=np.zeros((units, 3), np.float32),
            opacities=np.zeros(units, np.float32),
            sh0=np.zeros((units, 1, 3), np.float32),
            shN=np.repeat(np.eye(units, count, dtype=np.float32)[..., None], 3, axis=2),
        ),
        matrix,
    )
    return _Linear(made.quats[:4].T, np.exp(made.scales[0, 0]), made.shN[:count, :, 0].T)


def _turn_harmonics(columns: list[np.ndarray], rows: np.ndarray, turn: np.ndarray) -> None:
    """Turn coefficients [N, 3] in place, band by band: those of one do not become another's."""
    band = 1
    while (end := (band + 1) ** 2 - 1) <= len(columns):
        own = slice(band * band - 1, end)
        for values in np.array_split(rows, max(len(rows) // _BLOCK, 1)):
            _turn_band(columns[own], _range(values), turn[own, own])
        band += 1


def _turn_band(columns: list[np.ndarray], rows: Rows, turn: np.ndarray) -> None:
    old = np.stack([values[rows].reshape(-1) for values in columns])
    for values, new in zip(columns, turn @ old, strict=True):
        values[rows] = new.reshape(-1, 3)


def _range(rows: np.ndarray) -> Rows:
    """The same rows as a slice where they follow each other: it copies nothing."""
    if len(rows) and rows[-1] - rows[0] == len(rows) - 1:
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows
