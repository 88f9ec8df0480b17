"""Sample of splats spread over a mesh, to recognise it later."""

import hashlib
from typing import Any, NamedTuple

import numpy as np

from .. import attributes

MOST = 48
"""Number of sampled splats; reading them takes 0.1 ms."""


class Spread(NamedTuple):
    """Sample of a range of a mesh's splats."""

    count: int
    """Number of splats in the range."""
    shapes: str
    """Hash of the sampled quaternions and scales."""
    places: np.ndarray
    """[K, 3] float64, sampled positions; K <= `MOST`."""


def has_splats(mesh: Any) -> bool:
    """True if a mesh has the sampled attributes and is not in Edit Mode, where they are not
    accessible."""
    own = mesh.attributes
    if mesh.is_editmode or not len(mesh.vertices) or attributes.BASE not in own:
        return False
    kinds = {attributes.ROTATION: "QUATERNION", attributes.SCALE: "FLOAT_VECTOR"}
    return all(
        name in own and (own[name].data_type, own[name].domain) == (kind, "POINT")
        for name, kind in kinds.items()
    )


def look(mesh: Any, begin: int = 0, count: int | None = None) -> Spread:
    """Sample a mesh for which `has_splats` is true.

    Args:
        mesh: The mesh.
        begin: First splat of the range.
        count: Number of splats; None: all that follow.
    """
    count = len(mesh.vertices) - begin if count is None else count
    rows = [begin + at for at in _numbers(count)]
    own = mesh.attributes
    quats, scales = own[attributes.ROTATION].data, own[attributes.SCALE].data
    shapes = [(*quats[row].value, *scales[row].vector) for row in rows]
    digest = hashlib.blake2b(np.array(shapes, np.float32).tobytes(), digest_size=16)
    vertices = mesh.vertices
    places = np.array([vertices[row].co[:] for row in rows], np.float64)
    return Spread(count, digest.hexdigest(), places.reshape(-1, 3))


def _numbers(count: int) -> list[int]:
    """Indices of the sampled splats; equal for equal counts."""
    if count <= MOST:
        return list(range(count))
    return [at * (count - 1) // (MOST - 1) for at in range(MOST)]
