"""Instances of a depsgraph: objects and their transforms, including instanced collections."""

from collections.abc import Callable, Iterator

import bpy
import numpy as np

from ..compat import matrix_to_numpy

DEEPEST = 8
"""Deepest nesting of instanced collections that is followed."""


Path = tuple[int, ...]
"""Index of an object in an instanced collection at each level; () of the instancer itself. Blender
numbers instances in the same way: see `path_of`."""

_NO_ID = 0x7FFFFFFF
"""Filler of Blender's persistent ids after the last number."""


def instances(
    ob: bpy.types.Object,
    depsgraph: bpy.types.Depsgraph,
    wanted: Callable[[bpy.types.Object], bool],
) -> Iterator[tuple[bpy.types.Object, np.ndarray]]:
    """An evaluated object and those of its instanced collection that are `wanted`, each with its
    matrix to the world, [4, 4] float64."""
    for found, matrix, _ in instances_with_paths(ob, depsgraph, wanted):
        yield found, matrix


def instances_with_paths(
    ob: bpy.types.Object,
    depsgraph: bpy.types.Depsgraph,
    wanted: Callable[[bpy.types.Object], bool],
) -> Iterator[tuple[bpy.types.Object, np.ndarray, Path]]:
    """The same, each with its path."""
    # Not through depsgraph.object_instances, which yields every ellipsoid of a display.
    return _instances(ob, depsgraph, wanted, matrix_to_numpy(ob.matrix_world), ())


def path_of(instance: bpy.types.DepsgraphObjectInstance) -> Path:
    """The path to an instance from its outermost instancer."""
    numbers = [number for number in instance.persistent_id if number != _NO_ID]
    return tuple(reversed(numbers))


def _instances(
    ob: bpy.types.Object,
    depsgraph: bpy.types.Depsgraph,
    wanted: Callable[[bpy.types.Object], bool],
    matrix: np.ndarray,
    path: Path,
) -> Iterator[tuple[bpy.types.Object, np.ndarray, Path]]:
    if wanted(ob):
        yield ob, matrix, path
    collection = ob.instance_collection if ob.instance_type == "COLLECTION" else None
    if collection is None or len(path) > DEEPEST:
        return
    for number, inner, place in inside(collection, depsgraph):
        yield from _instances(inner, depsgraph, wanted, matrix @ place, (*path, number))


def inside(
    collection: bpy.types.Collection, depsgraph: bpy.types.Depsgraph
) -> Iterator[tuple[int, bpy.types.Object, np.ndarray]]:
    """Visible evaluated objects of a collection, each with its index in the collection and its
    matrix to the space of the instancer."""
    offset = np.eye(4)
    offset[:3, 3] = -np.array(collection.instance_offset)
    for number, inner in enumerate(collection.all_objects):
        if not (inner.hide_render if depsgraph.mode == "RENDER" else inner.hide_viewport):
            inner = inner.evaluated_get(depsgraph)
            yield number, inner, offset @ matrix_to_numpy(inner.matrix_world)
