"""Objects as a depsgraph places them: themselves, and those of collections that it instances."""

from collections.abc import Callable, Iterator

import bpy
import numpy as np

from ..compat import matrix_to_numpy

DEEPEST = 8
"""Collections in collections that are followed."""


def instances(
    ob: bpy.types.Object,
    depsgraph: bpy.types.Depsgraph,
    wanted: Callable[[bpy.types.Object], bool],
) -> Iterator[tuple[bpy.types.Object, np.ndarray]]:
    """An evaluated object itself, or those in the collection that it instances, if they are wanted;
    each with its matrix to the world, [4, 4] float64."""
    # Not through depsgraph.object_instances: that walks over every ellipsoid of a display.
    return _instances(ob, depsgraph, wanted, matrix_to_numpy(ob.matrix_world), 0)


def _instances(
    ob: bpy.types.Object,
    depsgraph: bpy.types.Depsgraph,
    wanted: Callable[[bpy.types.Object], bool],
    matrix: np.ndarray,
    depth: int,
) -> Iterator[tuple[bpy.types.Object, np.ndarray]]:
    if wanted(ob):
        yield ob, matrix
    collection = ob.instance_collection if ob.instance_type == "COLLECTION" else None
    if collection is None or depth > DEEPEST:
        return
    for inner, place in inside(collection, depsgraph):
        yield from _instances(inner, depsgraph, wanted, matrix @ place, depth + 1)


def inside(
    collection: bpy.types.Collection, depsgraph: bpy.types.Depsgraph
) -> Iterator[tuple[bpy.types.Object, np.ndarray]]:
    """The evaluated objects that a collection shows, each with its matrix to where the collection
    is instanced."""
    offset = np.eye(4)
    offset[:3, 3] = -np.array(collection.instance_offset)
    for inner in collection.all_objects:
        if not (inner.hide_render if depsgraph.mode == "RENDER" else inner.hide_viewport):
            inner = inner.evaluated_get(depsgraph)
            yield inner, offset @ matrix_to_numpy(inner.matrix_world)
