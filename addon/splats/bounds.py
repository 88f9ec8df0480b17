"""Bounds of the bulk of an object's splats, estimated from a sample."""

import bpy
import numpy as np

from .. import attributes, compat
from . import objects

_MOST = 200_000
"""Largest sample of splats; its quantiles agree with those of all to 0.001."""


def in_world(ob: bpy.types.Object) -> np.ndarray:
    """[M, 3] float64: means in Blender's world; an even sample of many splats.

    M is 0 without splats, or in Edit Mode, where attributes are not accessible.

    Raises:
        ValueError: as `objects.catch_up`, or positions are missing or not finite.
    """
    objects.catch_up(ob)
    if not len(ob.data.vertices):
        return np.zeros((0, 3))
    x, y, z = _some(ob, attributes.POSITION).T.astype(np.float64)
    matrix = compat.matrix_to_numpy(ob.matrix_world)
    # Spelled out, because starting the threads of a matrix product takes longer than the product.
    return np.stack([a * x + b * y + c * z + d for a, b, c, d in matrix[:3]]).T


def opacities(ob: bpy.types.Object) -> np.ndarray:
    """[M] float64 opacities in [0, 1] of the splats of `in_world`.

    Raises:
        ValueError: as `in_world`.
    """
    return _some(ob, attributes.BASE)[:, 3].astype(np.float64)


def _some(ob: bpy.types.Object, name: str) -> np.ndarray:
    """An even sample of the rows of an attribute."""
    values = attributes.column(ob.data, name)
    return values[:: -(-len(values) // _MOST) or 1]
