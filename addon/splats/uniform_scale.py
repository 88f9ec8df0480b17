"""Uniform scale: detection and removal of uneven object scales, which splats cannot represent."""

import bpy
import numpy as np
from mathutils import Vector

from .. import attributes, compat
from ..core import transform_splats
from . import objects


def is_even(ob: bpy.types.Object) -> bool:
    """True if an object's matrix is a similarity, which splats can represent."""
    try:
        transform_splats(attributes.NO_SPLATS, compat.matrix_to_numpy(ob.matrix_world))
    except ValueError:
        return False
    return True


def make_even(context: bpy.types.Context, ob: bpy.types.Object) -> list[str]:
    """Make the scales of an object and its parents uniform.

    The volume stays, a volume of 0 becomes 1, and reflections stay.

    Returns:
        The names of the changed objects.

    Raises:
        ValueError: the object would still be uneven; nothing is changed then.
    """
    before = {one: _scales(one) for one in uneven(ob)}
    for one in before:
        one.scale, one.delta_scale = _even(one.scale), _even(one.delta_scale)
    context.view_layer.update()
    if not is_even(ob):
        for one, (scale, delta) in before.items():
            one.scale, one.delta_scale = scale, delta
        context.view_layer.update()
        raise ValueError(
            f"{ob.name} is not stretched by its scale or its parents' alone: clear its parent "
            "(Alt P, Clear Parent Inverse), its constraints or its drivers."
        )
    return [one.name for one in before]


def uneven(ob: bpy.types.Object) -> list[bpy.types.Object]:
    """The object and its parents whose scale is not uniform; empty if the object's matrix is a
    similarity."""
    if is_even(ob):
        return []
    chain = objects.chain(ob)
    return [one for one in chain if _scales(one) != (_even(one.scale), _even(one.delta_scale))]


def _scales(ob: bpy.types.Object) -> tuple[tuple[float, ...], tuple[float, ...]]:
    return ob.scale[:], ob.delta_scale[:]


def _even(scale: Vector) -> tuple[float, float, float]:
    sides = np.array(scale, np.float64)
    if np.ptp(np.abs(sides)) <= 1e-6 * np.abs(sides).max():
        return tuple(scale)
    side = np.cbrt(np.abs(sides).prod()) or 1.0
    return tuple(np.where(sides < 0, -side, side))
