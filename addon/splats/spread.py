"""Some splats of a mesh, spread over it, by which it is known again."""

import hashlib
from typing import Any, NamedTuple

import numpy as np

from .. import attributes

MOST = 48
"""Splats that are looked at: reading them takes a tenth of a millisecond."""


class Spread(NamedTuple):
    """A look at a range of the splats of a mesh."""

    count: int
    """Splats of the range."""
    shapes: str
    """Tells their quaternions and scales apart to the bit."""
    places: np.ndarray
    """[K, 3] float64, their places; K <= `MOST`."""


def has_splats(mesh: Any) -> bool:
    """Whether a mesh has the attributes that are looked at, and they are in reach: they are not in
    Edit Mode."""
    found = mesh.attributes
    if mesh.is_editmode or not len(mesh.vertices) or attributes.BASE not in found:
        return False
    kinds = {attributes.ROTATION: "QUATERNION", attributes.SCALE: "FLOAT_VECTOR"}
    return all(
        name in found and (found[name].data_type, found[name].domain) == (kind, "POINT")
        for name, kind in kinds.items()
    )


def look(mesh: Any, begin: int = 0, count: int | None = None) -> Spread:
    """Look at a mesh of which `has_splats` says yes.

    Args:
        mesh: It.
        begin: The first splat of a range.
        count: Its splats; None: all that follow.
    """
    count = len(mesh.vertices) - begin if count is None else count
    rows = [begin + at for at in _numbers(count)]
    found = mesh.attributes
    quats, scales = found[attributes.ROTATION].data, found[attributes.SCALE].data
    shapes = [(*quats[row].value, *scales[row].vector) for row in rows]
    digest = hashlib.blake2b(np.array(shapes, np.float32).tobytes(), digest_size=16)
    vertices = mesh.vertices
    places = np.array([vertices[row].co[:] for row in rows], np.float64)
    return Spread(count, digest.hexdigest(), places.reshape(-1, 3))


def _numbers(count: int) -> list[int]:
    """Which of so many splats; the same for each mesh of as many."""
    if count <= MOST:
        return list(range(count))
    return [at * (count - 1) // (MOST - 1) for at in range(MOST)]
