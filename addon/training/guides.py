"""Guide meshes of a training: collected from the scene, and written for the trainer.

They are the visible objects of a collection, evaluated with modifiers, with child collections and
instances, in Blender's world. The capture's empty has the transform to the world of the photos.
"""

import hashlib
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np

from ..cameras.capture_transform import origin_of
from ..cameras.lookup import panel_root
from ..compat import matrix_to_numpy
from ..core import GUIDES, offset_between, write_mesh
from ..interface.blocks import first_few
from ..splats.objects import is_splats
from ..splats.splat_files import source_matrix
from ..triangles import WITH_FACES, Triangles, joined, moved, triangles_of

ROLES = {"surface": "guide_surface", "free": "guide_free"}
"""Role of a mesh, and the setting with its collection."""


def arguments(scene: bpy.types.Scene, output: Path) -> list[str]:
    """Write the guide meshes of a scene into `output`; return the trainer's options for them.

    File names have a hash of the content, so that files of an earlier run stay unchanged.

    Raises:
        ValueError: the capture is not in the scene, or a collection has no visible mesh.
        GsError: a file cannot be written.
    """
    line: list[str] = []
    for role, collection in chosen(scene):
        mesh = merged_mesh(scene, collection)
        path = output / GUIDES / f"{role}-{digest(mesh)}.ply"
        if not path.is_file():
            write_mesh(path, *mesh)
        line += [f"--guide-{role}", str(path)]
    return line


def digest(mesh: Triangles) -> str:
    """Eight-letter hash of a mesh."""
    return hashlib.sha256(mesh.vertices.tobytes() + mesh.triangles.tobytes()).hexdigest()[:8]


def unused_objects(scene: bpy.types.Scene) -> list[str]:
    """Sentences on unused objects in the guide collections."""
    lines = []
    for _, collection in chosen(scene):
        hidden = [ob.name for ob in collection.all_objects if not ob.visible_get()]
        others = [
            ob.name for ob in collection.all_objects if ob.visible_get() and not may_guide(ob)
        ]
        if hidden:
            lines.append(
                f"Hidden in {collection.name}, so not used: {first_few(hidden, _MOST_LISTED)}."
            )
        if others:
            lines.append(
                f"No meshes in {collection.name}, so not used: {first_few(others, _MOST_LISTED)}."
            )
    return lines


def merged_mesh(
    scene: bpy.types.Scene,
    collection: bpy.types.Collection,
    root: bpy.types.Object | None = None,
) -> Triangles:
    """All visible meshes of a collection as one, in the coordinates of a capture's own files.

    Args:
        scene: The scene.
        collection: Collection of the meshes.
        root: The capture's empty; None: that of the scene's capture.

    Raises:
        ValueError: the capture is not in the scene, the collection has no visible mesh, or a vertex
            is not finite.
    """
    root = root or panel_root(scene)
    if root is None:
        raise ValueError(
            f"The meshes of {collection.name} guide a training by their position among the photos: "
            "press Import Cameras first."
        )
    to_capture = np.linalg.inv(source_matrix(root))
    parts = []
    for name, matrix, part in _shown(collection):
        places = moved(part.vertices, to_capture @ matrix)
        if not np.isfinite(places).all():
            raise ValueError(
                f"{name} has vertices that are not finite; repair it with Mesh > Clean Up."
            )
        parts.append(Triangles(places, part.triangles))
    if not parts:
        raise ValueError(
            f"{collection.name} has no visible faces to guide a training: add meshes to it, show "
            "them in the viewport, or clear the field."
        )
    mesh = joined(parts)
    return mesh._replace(vertices=mesh.vertices + offset_between(origin_of(root), None))


def add_to_guides(
    scene: bpy.types.Scene, role: str, obs: list[bpy.types.Object]
) -> bpy.types.Collection:
    """Link objects to the collection of a role, created if missing."""
    collection = getattr(scene.gscore, ROLES[role])
    if collection is None:
        collection = bpy.data.collections.new(_NAMES[role])
        scene.collection.children.link(collection)
        setattr(scene.gscore, ROLES[role], collection)
    for ob in obs:
        if ob.name not in collection.objects:
            collection.objects.link(ob)
    return collection


_NAMES = {"surface": "Guide Surfaces", "free": "Guide Free Space"}
_MOST_LISTED = 5


def chosen(scene: bpy.types.Scene) -> Iterator[tuple[str, bpy.types.Collection]]:
    """The chosen collections by role."""
    for role, setting in ROLES.items():
        collection = getattr(scene.gscore, setting)
        if collection is not None:
            yield role, collection


def may_guide(ob: bpy.types.Object) -> bool:
    """True if an object is a mesh, evaluates to one, or instances a collection."""
    if ob.instance_type == "COLLECTION":
        return True
    return ob.type in WITH_FACES and not is_splats(ob)


def _shown(collection: bpy.types.Collection) -> Iterator[tuple[str, np.ndarray, Triangles]]:
    """Name, matrix to Blender's world and faces of each visible mesh, with instances."""
    visible = {ob.session_uid for ob in collection.all_objects if ob.visible_get()}
    graph = bpy.context.evaluated_depsgraph_get()
    known: dict[int, Triangles] = {}
    done: set[tuple[int, str, bytes, bytes]] = set()
    for instance in graph.object_instances:
        ob = instance.object
        owner = instance.parent if instance.is_instance else ob
        if owner.original.session_uid not in visible or not instance.show_self:
            continue
        if ob.type not in WITH_FACES or is_splats(ob.original):
            continue
        if ob.type != "MESH":  # Blender reuses their address for other instances
            mesh = triangles_of(ob)
        elif (mesh := known.get(ob.data.as_pointer())) is None:
            mesh = known[ob.data.as_pointer()] = triangles_of(ob)
        matrix = matrix_to_numpy(instance.matrix_world)
        # A text in an instanced collection is listed twice: as itself and as its evaluated mesh.
        key = owner.original.session_uid, ob.name, matrix.tobytes(), mesh.vertices.tobytes()
        if len(mesh.triangles) and key not in done:
            done.add(key)
            yield ob.name, matrix, mesh
