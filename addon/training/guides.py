"""Guide meshes of a training: collected from the scene, and written for the trainer.

They are the objects of a collection that are visible in the viewport, evaluated with modifiers,
with child collections and instances, in Blender's world. The capture's empty gives the transform
to the world of the photos.
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
"""What a mesh is for, and the setting that names its collection."""


def arguments(scene: bpy.types.Scene, output: Path) -> list[str]:
    """Write the guide meshes of a scene into `output`; return the trainer's options for them.

    Files are named by what they hold, so that those of an earlier run stay as they are.

    Raises:
        ValueError: the capture is not in the scene, or a collection shows no mesh.
        GsError: a file cannot be written.
    """
    line: list[str] = []
    for role, collection in chosen(scene):
        found = gathered(scene, collection)
        path = output / GUIDES / f"{role}-{digest(found)}.ply"
        if not path.is_file():
            write_mesh(path, found.vertices, found.triangles)
        line += [f"--guide-{role}", str(path)]
    return line


def digest(found: Triangles) -> str:
    """Eight-letter hash of a mesh."""
    return hashlib.sha256(found.vertices.tobytes() + found.triangles.tobytes()).hexdigest()[:8]


def left_out(scene: bpy.types.Scene) -> list[str]:
    """Sentences on objects in the guide collections that are not used."""
    lines = []
    for _, collection in chosen(scene):
        hidden = [ob.name for ob in collection.all_objects if not ob.visible_get()]
        others = [
            ob.name for ob in collection.all_objects if ob.visible_get() and not may_guide(ob)
        ]
        if hidden:
            lines.append(
                f"Hidden in {collection.name}, so no guides: {first_few(hidden, _MOST_LISTED)}."
            )
        if others:
            lines.append(
                f"No meshes, so no guides: {first_few(others, _MOST_LISTED)} in {collection.name}."
            )
    return lines


def gathered(
    scene: bpy.types.Scene,
    collection: bpy.types.Collection,
    root: bpy.types.Object | None = None,
) -> Triangles:
    """All meshes that a collection shows, as one, in the coordinates of a capture's own files.

    Args:
        scene: What shows.
        collection: Of the meshes.
        root: The capture's empty; None: that of the scene's capture.

    Raises:
        ValueError: the capture is not in the scene, the collection shows no mesh, or a corner of
            one is no place.
    """
    root = root or panel_root(scene)
    if root is None:
        raise ValueError(
            f"The meshes of {collection.name} guide a training by where they stand among the "
            "photos: press Import Cameras first."
        )
    to_capture = np.linalg.inv(source_matrix(root))
    parts = []
    for name, matrix, part in _shown(collection):
        places = moved(part.vertices, to_capture @ matrix)
        if not np.isfinite(places).all():
            raise ValueError(
                f"Corners of {name} are no places in space; mend it with Mesh > Clean Up."
            )
        parts.append(Triangles(places, part.triangles))
    if not parts:
        raise ValueError(
            f"{collection.name} shows no faces that could guide a training: put meshes there, show "
            "them in the viewport, or clear the field."
        )
    found = joined(parts)
    return found._replace(vertices=found.vertices + offset_between(origin_of(root), None))


def add_to_guides(
    scene: bpy.types.Scene, role: str, obs: list[bpy.types.Object]
) -> bpy.types.Collection:
    """Link objects to the collection of a role, which is made where there is none yet."""
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
    """Whether an object is a mesh that could guide, becomes one, or shows others."""
    if ob.instance_type == "COLLECTION":
        return True
    return ob.type in WITH_FACES and not is_splats(ob)


def _shown(collection: bpy.types.Collection) -> Iterator[tuple[str, np.ndarray, Triangles]]:
    """Name, matrix to Blender's world and faces of each mesh that shows, instances too."""
    wanted = {ob.session_uid for ob in collection.all_objects if ob.visible_get()}
    graph = bpy.context.evaluated_depsgraph_get()
    known: dict[int, Triangles] = {}
    given: set[tuple[int, str, bytes, bytes]] = set()
    for instance in graph.object_instances:
        ob = instance.object
        owner = instance.parent if instance.is_instance else ob
        if owner.original.session_uid not in wanted or not instance.show_self:
            continue
        if ob.type not in WITH_FACES or is_splats(ob.original):
            continue
        if ob.type != "MESH":  # Blender shows other instances under the same address
            found = triangles_of(ob)
        elif (found := known.get(ob.data.as_pointer())) is None:
            found = known[ob.data.as_pointer()] = triangles_of(ob)
        matrix = matrix_to_numpy(instance.matrix_world)
        # A text in an instanced collection comes twice: as itself, and as the mesh that it becomes.
        of = owner.original.session_uid
        one = of, ob.name, matrix.tobytes(), found.vertices.tobytes()
        if len(found.triangles) and one not in given:
            given.add(one)
            yield ob.name, matrix, found
