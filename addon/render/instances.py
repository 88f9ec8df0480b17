"""Instances of a depsgraph: objects and their transforms, of instanced collections, and generated
by geometry nodes, particles, or instancing on vertices and faces.
"""

from collections.abc import Callable, Iterator
from typing import Any

import bpy
import numpy as np

from ..compat import HAS_GEOMETRY_SETS, evaluated_geometry, matrix_to_numpy
from ..splats.objects import is_splats
from ..triangles import WITH_FACES, Triangles, triangles_of, triangles_of_mesh

DEEPEST = 8
"""Deepest nesting of instanced collections that is followed."""


Path = tuple[int, ...]
"""Index of an object in an instanced collection at each level; () of the instancer itself. Blender
numbers instances in the same way, in the opposite order."""

_NO_ID = 0x7FFFFFFF
"""Filler of Blender's persistent ids after the last number."""


def instances(
    ob: bpy.types.Object,
    depsgraph: bpy.types.Depsgraph,
    accepts: Callable[[bpy.types.Object], bool],
    matrix: np.ndarray | None = None,
    path: Path = (),
) -> Iterator[tuple[bpy.types.Object, np.ndarray, Path]]:
    """An evaluated object and those of its instanced collection that are `accepts`, each with its
    matrix to the world, [4, 4] float64, and its path.

    Args:
        ob: The object.
        depsgraph: Its depsgraph.
        accepts: Predicate of an evaluated object.
        matrix: Matrix of `ob` to the world, if it is in a collection.
        path: Path to `ob`, if it is in a collection.
    """
    # Not through depsgraph.object_instances, which yields every ellipsoid of a display.
    collection = ob.instance_collection if ob.instance_type == "COLLECTION" else None
    taken = accepts(ob)
    if not taken and collection is None:
        return  # most objects: their matrices take long to copy
    matrix = matrix_to_numpy(ob.matrix_world) if matrix is None else matrix
    if taken:
        yield ob, matrix, path
    if collection is None or len(path) > DEEPEST:
        return
    for number, inner, place in inside(collection, depsgraph):
        yield from instances(inner, depsgraph, accepts, matrix @ place, (*path, number))


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


Part = tuple[Triangles, np.ndarray]
"""Faces, and the matrices of their instances, [K, 4, 4] float64."""


def may_hold_out(ob: bpy.types.Object) -> bool:
    """Whether an object has or may get faces and is not made by this add-on."""
    return ob.type in WITH_FACES and not is_splats(ob) and "gs_kind" not in ob


def may_grow(ob: bpy.types.Object) -> bool:
    """Whether an object may generate instances and is not made by this add-on."""
    ours = is_splats(ob) or "gs_kind" in ob
    return not ours and (_has_nodes(ob) or always_grows(ob))


def always_grows(ob: bpy.types.Object) -> bool:
    """Whether Blender treats an object as an instancer, even if it has no instances."""
    return ob.instance_type in {"VERTS", "FACES"} or len(ob.particle_systems) > 0


def needs_walk(ob: bpy.types.Object) -> bool:
    """Whether only `walked` finds the geometry of an evaluated object."""
    return always_grows(ob) or (_has_nodes(ob) and not HAS_GEOMETRY_SETS)


def generated_instances(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> list[Part]:
    """Geometry that the nodes of an evaluated object add to its own mesh, in object space."""
    return list(_of_object(ob, np.eye(4)[None], depsgraph, 0, itself=False))


InstancerKey = tuple[int, Path]
"""Uid of an object that a depsgraph shows, and the path from it to the instancer."""


def walked(
    depsgraph: bpy.types.Depsgraph, instancers: set[InstancerKey], elsewhere: set[InstancerKey]
) -> dict[InstancerKey, list[Part]]:
    """All instances that some objects generate, in world space.

    Args:
        depsgraph: Its visible instances.
        instancers: The objects.
        elsewhere: Instances to leave out, because they are found otherwise.
    """
    # The iterator must run to its end, and its items are valid for one step only.
    known: dict[tuple[int, bool], Triangles] = {}
    places: dict[tuple[InstancerKey, tuple[int, bool]], list[np.ndarray]] = {}
    owners = {uid for uid, _ in instancers}
    for instance in depsgraph.object_instances:
        if not (instance.is_instance and instance.show_self) or instance.parent is None:
            continue
        owner = instance.parent.original.session_uid
        if owner not in owners:
            continue
        path = tuple(number for number in instance.persistent_id if number != _NO_ID)[::-1]
        before = ((owner, path[:length]) for length in reversed(range(len(path))))
        walker = next((one for one in before if one in instancers), None)
        ob = instance.object
        if walker is None or (owner, path) in elsewhere or not _counts(ob, depsgraph):
            continue
        # Blender yields instances of texts and the like at one address, one after the other.
        is_mesh = ob.type == "MESH"
        key = (ob.data.as_pointer() if is_mesh else ob.original.session_uid), is_mesh
        if key not in known:
            known[key] = triangles_of(ob)
        places.setdefault((walker, key), []).append(matrix_to_numpy(instance.matrix_world))
    found: dict[InstancerKey, list[Part]] = {walker: [] for walker in instancers}
    for (walker, key), matrices in places.items():
        if len(known[key].triangles):
            found[walker].append((known[key], np.array(matrices)))
    return found


def _has_nodes(ob: bpy.types.Object) -> bool:
    return any(modifier.type == "NODES" for modifier in ob.modifiers)


def _counts(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    return may_hold_out(ob) and (depsgraph.mode != "RENDER" or ob.visible_camera)


def _of_object(
    ob: bpy.types.Object,
    matrices: np.ndarray,
    depsgraph: bpy.types.Depsgraph,
    depth: int,
    *,
    itself: bool = True,
) -> Iterator[Part]:
    """An evaluated object at all matrices, with its instances."""
    counts = _counts(ob, depsgraph)
    if counts and itself:
        yield from _filled(triangles_of(ob), matrices)
    if depth > DEEPEST or is_splats(ob):
        return
    if _has_nodes(ob):
        geometry = evaluated_geometry(ob)
        if geometry is not None:
            # Curves and points have no faces of their own; nodes may have given them some.
            faces = ob.type not in WITH_FACES
            yield from _of_geometry(geometry, matrices, depsgraph, depth, faces=faces)
    if itself and ob.instance_type == "COLLECTION" and ob.instance_collection is not None:
        yield from _of_collection(ob.instance_collection, matrices, depsgraph, depth)


def _of_collection(
    collection: bpy.types.Collection,
    matrices: np.ndarray,
    depsgraph: bpy.types.Depsgraph,
    depth: int,
) -> Iterator[Part]:
    for _, inner, matrix in inside(collection, depsgraph):
        yield from _of_object(inner, matrices @ matrix, depsgraph, depth + 1)


def _of_geometry(
    geometry: Any,
    matrices: np.ndarray,
    depsgraph: bpy.types.Depsgraph,
    depth: int,
    *,
    faces: bool = True,
) -> Iterator[Part]:
    """A geometry at all matrices: its faces, if `faces`, and its instances."""
    if faces and geometry.mesh is not None:
        yield from _filled(triangles_of_mesh(geometry.mesh), matrices)
    points = geometry.instances_pointcloud()
    if points is None or depth > DEEPEST:
        return
    count = len(points.points)
    own, which = np.empty((count, 4, 4), np.float32), np.empty(count, np.int32)
    points.attributes["instance_transform"].data.foreach_get("value", own.ravel())
    points.attributes[".reference_index"].data.foreach_get("value", which)
    own = own.transpose(0, 2, 1).astype(np.float64)  # Blender stores them column-major
    for number, shown in enumerate(geometry.instance_references()):
        there = own[which == number]
        if not len(there):
            continue
        places = (matrices[:, None] @ there[None]).reshape(-1, 4, 4)
        if isinstance(shown, bpy.types.Object):
            yield from _of_object(shown, places, depsgraph, depth + 1)
        elif isinstance(shown, bpy.types.Collection):
            yield from _of_collection(shown, places, depsgraph, depth + 1)
        elif shown is not None:
            yield from _of_geometry(shown, places, depsgraph, depth + 1)


def _filled(triangles: Triangles, matrices: np.ndarray) -> Iterator[Part]:
    if len(triangles.triangles):
        yield triangles, matrices
