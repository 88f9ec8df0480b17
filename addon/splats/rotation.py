"""Rotation, mirroring and scaling of the shapes and SH of splats, without their means; no bpy."""

from typing import NamedTuple

import numpy as np

from .. import attributes
from ..core import Splats, transform_splats
from ..process.incremental_tasks import Check
from . import point_attributes
from .point_attributes import Column

Rows = slice | np.ndarray
_BLOCK = 1 << 12
"""Splats per block: their coefficients fit the cache."""


class _Linear(NamedTuple):
    """A rotation as matrices for the attributes, computed by transforming unit splats; three times
    faster than reading, transforming and writing `Splats`."""

    quats: np.ndarray
    """[4, 4] float32."""
    factor: np.float32
    """Factor of the scales."""
    harmonics: np.ndarray
    """[K, K] float32, matrix of SH coefficients."""
    normals: np.ndarray
    """[3, 3] float32, of unit vectors."""


def turned(table: list[Column], turns: np.ndarray, numbers: np.ndarray) -> list[Column]:
    """Transform quaternions, scales, SH coefficients and normals in place; other attributes and
    splats stay bit-identical.

    Args:
        table: Attributes of N points, including those of splats.
        turns: [P, 3, 3], linear parts of similarities.
        numbers: [N] int, index in `turns` for each splat; negative: none.

    Returns:
        The changed columns.

    Raises:
        ValueError: a matrix is not a similarity; nothing is changed.
    """
    by_name = point_attributes.of_splats(table)
    names = [n for n in by_name if n not in (attributes.BASE, attributes.POSITION)]
    names.sort(key=lambda name: name != attributes.ROTATION)  # then scales, then coefficients
    columns = [by_name[name] for name in names]
    normals = [one.values for one in table if one.name == attributes.NORMAL]
    steps: list[tuple[np.ndarray, _Linear]] = []
    for number, turn in enumerate(turns):
        chosen = numbers == number
        if chosen.any() and not np.array_equal(turn, np.eye(3)):
            steps.append((np.flatnonzero(chosen), _linear(turn, len(names) - 2)))
    for rows, linear in steps:
        at = _range(rows)
        columns[0][at] = columns[0][at] @ linear.quats.T
        columns[1][at] *= linear.factor
        _turn_harmonics(columns[2:], rows, linear.harmonics)
        for values in normals:
            values[at] = values[at] @ linear.normals.T
    return [column for column in table if column.name in {*names, attributes.NORMAL}]


def moved(table: list[Column], matrix: np.ndarray, name: str, check: Check) -> list[Column]:
    """Transform the splats of a table in place; returns the changed columns.

    Args:
        table: As `turned`.
        matrix: [4, 4], a similarity.
        name: Name of the splats in messages.
        check: Raises after cancellation.

    Raises:
        ValueError: values are not finite.
    """
    columns = point_attributes.of_splats(table)
    for one, values in columns.items():
        attributes.check_finite(values, one, name)
    check()
    changed = turned(table, matrix[None, :3, :3], np.zeros(len(columns[attributes.BASE]), np.int32))
    for column in table:
        if column.name == attributes.POSITION:
            places = column.values.astype(np.float64)
            column.values[:] = places @ matrix[:3, :3].T + matrix[:3, 3]
            changed.append(column)
    return changed


def _linear(turn: np.ndarray, count: int) -> _Linear:
    """Matrices of a rotation, for a number of SH coefficients."""
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
    factor = np.exp(made.scales[0, 0])
    normals = (turn / factor).astype(np.float32)
    return _Linear(made.quats[:4].T, factor, made.shN[:count, :, 0].T, normals)


def _turn_harmonics(columns: list[np.ndarray], rows: np.ndarray, turn: np.ndarray) -> None:
    """Rotate coefficients [N, 3] in place, band by band, because bands do not mix."""
    band = 1
    while (end := (band + 1) ** 2 - 1) <= len(columns):
        own = slice(band * band - 1, end)
        for values in np.array_split(rows, max(len(rows) // _BLOCK, 1)):
            at = _range(values)
            old = np.stack([column[at].reshape(-1) for column in columns[own]])
            for column, new in zip(columns[own], turn[own, own] @ old, strict=True):
                column[at] = new.reshape(-1, 3)
        band += 1


def _range(rows: np.ndarray) -> Rows:
    """The same rows as a slice if they are contiguous, which avoids a copy."""
    if len(rows) and rows[-1] - rows[0] == len(rows) - 1:
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows
