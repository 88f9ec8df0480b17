"""Splats added to a table: the filling of a hole, and copies of splats; no bpy."""

import numpy as np

from .. import attributes
from ..core import heal
from ..process.incremental_tasks import Check
from . import point_attributes
from .point_attributes import Column
from .rotation import moved

_KNOWN = 0.5
"""Least share of splats around a place with normal and captured light, for one there to have them
too."""


def healed(table: list[Column], region: np.ndarray, *, sphere: bool, check: Check) -> list[Column]:
    """Splats that fill a hole, from `heal`, marked as added; if splats can be relit, with
    normals and captured light interpolated from the border too.

    Args:
        table: All splats of an object.
        region: [4, 4] from the cube [-1, 1]^3 to the box that contains the hole, in their space.
        sphere: Fill only the ellipsoid in the box.
        check: Raises after cancellation.

    Raises:
        ValueError: values are not finite, there is no hole, or too few splats are around it.
    """
    columns = {name: values.copy() for name, values in point_attributes.of_splats(table).items()}
    lights = [one for one in table if one.name in (attributes.NORMAL, attributes.CAPTURED)]
    around = [one.values for one in lights]
    if lights:  # the share of splats that have them, in the last column
        known = np.any([values.any(axis=1) for values in around], axis=0)
        around.append(known[:, None])
    splats, found = heal(
        attributes.as_splats(columns),
        region,
        sphere=sphere,
        values=np.concatenate(around, axis=1).astype(np.float64) if lights else None,
        check=check,
    )
    made = [
        Column(name, kind, values.reshape(len(splats), -1))
        for name, kind, values in attributes.columns(splats)
    ]
    for number, light in enumerate(lights):
        values = found[:, 3 * number : 3 * number + 3]
        scale = found[:, -1:]
        if light.name == attributes.NORMAL:
            scale = np.linalg.norm(values, axis=1, keepdims=True)
        there = (found[:, -1:] > _KNOWN) & (scale > 0)
        values = np.divide(values, scale, out=np.zeros_like(values), where=there)
        made.append(Column(light.name, light.kind, values.astype(np.float32)))
    return [*made, _mark(len(splats))]


def cloned(
    table: list[Column],
    chosen: np.ndarray,
    matrix: np.ndarray,
    name: str,
    check: Check,
    *,
    opacity: float | np.ndarray = 1.0,
) -> list[Column]:
    """Copies of splats with all their attributes, transformed and marked as added.

    Args:
        table: All splats of an object.
        chosen: [N] bool.
        matrix: [4, 4], a similarity of their space.
        name: Name of the object in messages.
        check: Raises after cancellation.
        opacity: Opacity of the copies in that of their sources, of all or [K].

    Raises:
        ValueError: values are not finite.
    """
    rows = np.flatnonzero(chosen)
    named = (attributes.HEALED, attributes.SELECTION)
    copies = [one for one in point_attributes.picked(table, rows) if one.name not in named]
    moved(copies, matrix, name, check)
    point_attributes.of_splats(copies)[attributes.BASE][:, 3] *= opacity
    return [*copies, _mark(len(rows))]


def appended(table: list[Column], more: list[Column], *, selected: bool = True) -> list[Column]:
    """A table with more splats; with `selected` these alone are selected, else none of them."""
    if not selected:
        return point_attributes.joined([table, more])
    chosen = np.ones((len(more[0].values), 1), bool)
    selection = Column(attributes.SELECTION, "BOOLEAN", chosen)
    return point_attributes.joined([point_attributes.without_selection(table), [*more, selection]])


def _mark(count: int) -> Column:
    return Column(attributes.HEALED, "BOOLEAN", np.ones((count, 1), bool))
