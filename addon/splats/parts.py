"""Splat objects taken apart and put together, with all that their points carry."""

import bpy
import numpy as np

from .. import attributes, compat
from ..interface import writable
from . import lag, objects, settings


def separate(ob: bpy.types.Object, chosen: np.ndarray) -> bpy.types.Object:
    """Move splats into an object of their own, with the same place, display and filters.

    Args:
        ob: A splat object.
        chosen: [N] bool.

    Raises:
        ValueError: Edit Mode, a mesh that cannot be written, or none or all are chosen.
    """
    objects.check_writable(ob)
    if chosen.all() or not chosen.any():
        many = "all" if len(chosen) and chosen.all() else "none"
        raise ValueError(f"{ob.name}: select some splats to separate; {many} of them are.")
    other = ob.copy()
    other.data = ob.data.copy()
    other.name = other.data.name = f"{ob.name} part"
    writable.link_beside(other, ob)
    for one, keep in ((ob, ~chosen), (other, chosen)):
        attributes.keep(one.data, keep)
        one.data.update()
    settings.apply(other)
    return other


def check_joinable(ob: bpy.types.Object, others: list[bpy.types.Object]) -> None:
    """Raise ValueError where some splats cannot be joined: there are no others, Edit Mode, a mesh
    that cannot be written, anti-aliasing of some, or shapes that lag behind places."""
    if not others:
        raise ValueError("Select two or more splat objects; the active one receives the others.")
    parts = [ob, *others]
    for one in parts:
        objects.check_writable(one)
    if len({bool(one.get(objects.ANTIALIAS)) for one in parts}) > 1:
        raise ValueError("Some were trained with anti-aliasing and some without: they stay apart.")
    behind = ", ".join(one.name for one in parts if lag.is_behind(one.data))
    if behind:
        raise ValueError(
            f"Shapes and colors of {behind} lag behind the places: press Turn Shapes and Colors "
            "Along first, under Result."
        )


def join(ob: bpy.types.Object, others: list[bpy.types.Object]) -> None:
    """Take the splats of other objects into one, where and as they are seen; the others go.

    SH degrees are filled up. Attributes that are no splat's follow; where an object has none of
    that name, they are 0.

    Raises:
        ValueError: as `check_joinable`, or a matrix is no similarity; nothing is changed then.
    """
    check_joinable(ob, others)
    world = compat.matrix_to_numpy(ob.matrix_world)
    if not abs(np.linalg.det(world[:3, :3])) > 1e-30:
        raise ValueError(f"{ob.name} is scaled to nothing: set its scale to 1 first.")
    to_own = np.linalg.inv(world)
    matrices = [to_own @ compat.matrix_to_numpy(one.matrix_world) for one in others]
    attributes.check(ob.data)
    tables = [_moved(one, m) for one, m in zip(others, matrices, strict=True)]
    attributes.append(ob.data, tables)
    lag.forget(ob.data)
    ob.data.update()
    for one in others:
        data = one.data
        bpy.data.objects.remove(one)
        if not data.users:
            bpy.data.meshes.remove(data)


def _moved(ob: bpy.types.Object, matrix: np.ndarray) -> list[attributes.Column]:
    """All that the points of an object carry, after a 4x4 similarity; ValueError as `join`."""
    splats = objects.transformed(ob, matrix)
    rest = [c for c in attributes.table(ob.data) if not attributes.is_splats(c.name)]
    return [*attributes.as_table(splats), *rest]
