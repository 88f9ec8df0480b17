"""Splat objects: splats as a mesh object; create, refresh, read, find, hide."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import bpy
import numpy as np
from mathutils import Matrix

from .. import attributes, stored_paths
from ..cameras.objects import points_of
from ..core import Splats, transform_splats
from ..interface import editable_check
from . import copy_metadata, lag, live_display, settings

KIND = "splats"
ANTIALIAS = "gs_antialias"
"""Custom property of a splat object trained with antialias (Mip-Splatting)."""
PROXY = "gs_proxy"
"""Custom property of an object: it is the proxy of its parent."""
CATCH_UP: list[Callable[[bpy.types.Object], None]] = []
"""Functions that update an object's mesh to its displayed splats; ValueError if that fails."""


def create(
    splats: Splats,
    name: str,
    *,
    collection: bpy.types.Collection | None = None,
    parent: bpy.types.Object | None = None,
) -> bpy.types.Object:
    """Create a mesh object with one vertex per splat and the attributes of `attributes`.

    Args:
        splats: Raw parameters, in COLMAP's world.
        name: Name of object and mesh.
        collection: Collection to link it to, if it accepts objects; None: the context's.
        parent: Usually the capture's empty, whose matrix maps COLMAP's world to Blender's.
    """
    mesh = bpy.data.meshes.new(name)
    _fill(mesh, splats)
    return around(mesh, attributes.typical_size(splats), collection=collection, parent=parent)


def around(
    mesh: bpy.types.Mesh,
    size: float,
    *,
    collection: bpy.types.Collection | None = None,
    parent: bpy.types.Object | None = None,
) -> bpy.types.Object:
    """Create a splat object from a mesh that has the attributes.

    Args:
        mesh: The mesh; the object gets its name.
        size: `attributes.typical_size` of its splats.
        collection: As `create`.
        parent: As `create`.
    """
    ob = bpy.data.objects.new(mesh.name, mesh)
    ob["gs_kind"] = KIND
    ob.parent = parent
    editable_check.taking([collection or bpy.context.collection])[0].objects.link(ob)
    if size:
        # With half the typical size points neither merge nor vanish.
        ob.gscore.point_size = 0.5 * size
    settings.attach(ob)
    lag.follow(mesh)
    if live_display.SESSION.works:
        ob.gscore.display = "SPLATS"
    return ob


def refresh(ob: bpy.types.Object, splats: Splats) -> None:
    """Replace all splats of an object; transform, display settings, parent and mesh metadata stay.

    Raises:
        ValueError: as `check_refreshable`.
    """
    check_refreshable(ob)
    # Vertices can be added to a mesh, but not removed, so start over if the number differs.
    sh_names = [one for one in ob.data.attributes if one.name.startswith(attributes.SH)]
    if len(ob.data.vertices) != len(splats) or len(sh_names) != splats.shN.shape[1]:
        copy_metadata.empty(ob.data)
    lag.forget(ob.data)
    _fill(ob.data, splats)


def check_refreshable(ob: bpy.types.Object) -> None:
    """Raise ValueError unless all splats of an object can be replaced without losing other data of
    its mesh."""
    check_writable(ob)
    copy_metadata.check_only_points(ob.data, ob.name)


def catch_up(ob: bpy.types.Object) -> None:
    """Update an object's mesh to its displayed splats, which it follows with a delay in a window.

    Call before reading or editing the splats of an object.

    Raises:
        ValueError: the update fails.
    """
    for bring in CATCH_UP:
        bring(ob.original)


def read(ob: bpy.types.Object, *, rest: bool = True) -> Splats:
    """Raw parameters in object space, from the object's own mesh (no modifiers).

    Args:
        ob: A splat object, or any mesh or point cloud with the attributes.
        rest: As `attributes.read`.

    Raises:
        ValueError: attributes are missing or not finite, or as `catch_up`.
    """
    if ob.type not in {"MESH", "POINTCLOUD"}:
        raise ValueError(f"{ob.name} is not a splat object: it is a {ob.type.lower()}.")
    catch_up(ob)
    with readable(ob) as data:
        return attributes.read(data, rest=rest)


def moved(splats: Splats, matrix: np.ndarray, name: str) -> Splats:
    """The splats of an object called `name` after a 4x4 similarity; no bpy.

    Raises:
        ValueError: the matrix is not a similarity.
    """
    if np.array_equal(matrix, np.eye(4)):
        return splats
    try:
        return transform_splats(splats, matrix)
    except ValueError as error:
        raise ValueError(f"{name} cannot be transformed. {error}") from error


def check_writable(ob: bpy.types.Object) -> None:
    """Raise ValueError unless the points of the object's mesh are writable now."""
    if ob.mode == "EDIT":
        raise ValueError(f"{ob.name} is in Edit Mode: leave it before changing its splats.")
    if ob.type != "MESH":
        raise ValueError(f"{ob.name} is not a splat object: it is a {ob.type.lower()}.")
    editable_check.check(ob.data)


def is_splats(ob: bpy.types.Object | None) -> bool:
    """True if an object is a splat object of this add-on."""
    return ob is not None and ob.type == "MESH" and ob.get("gs_kind") == KIND


def is_proxy(ob: bpy.types.Object) -> bool:
    """True if an object is the proxy of a splat object, see `render.proxy`."""
    return PROXY in ob and ob.type == "MESH" and ob.parent is not None and is_splats(ob.parent)


def proxy_of(splats: bpy.types.Object) -> bpy.types.Object | None:
    """The proxy of a splat object; None: it has none."""
    return next((ob for ob in splats.children if is_proxy(ob)), None)


def is_relit(ob: bpy.types.Object) -> bool:
    """True if the scene's light replaces the captured light of splats, see `render.relight`."""
    return ob.gscore.light > 0 and has_albedo(ob)


def has_albedo(ob: bpy.types.Object) -> bool:
    """True if the albedo of splats was estimated, see `render.estimate_light`."""
    return bool(attributes.light_names(ob.original.data))


def active_splats(context: bpy.types.Context) -> bpy.types.Object | None:
    """The active object, or the splat object that it crops, rather a visible one."""
    active = context.object
    if active is None or is_splats(active):
        return active
    obs = [ob for ob in context.scene.objects if is_splats(ob)]
    cropped = [ob for ob in obs if ob.gscore.crop_object == active]
    return next((ob for ob in cropped if not ob.hide_get()), next(iter(cropped), None))


def has_splats(context: bpy.types.Context) -> bool:
    """True if splats, or their crop object, are active."""
    return is_splats(active_splats(context))


def has_trained(context: bpy.types.Context) -> bool:
    """True if splats of a training are active."""
    return has_splats(context) and stored_paths.RUN in active_splats(context)


def in_question(context: bpy.types.Context) -> bpy.types.Object | None:
    """The splat object of the panels: the one that the user works on, else the scene's result, else
    the first in the scene."""
    if is_splats(ob := active_splats(context)):
        return ob
    result, objects = context.scene.gscore.result, context.scene.objects
    if is_splats(result) and objects.get(result.name) == result:  # else it was deleted
        return result
    return next(filter(is_splats, objects), None)


def chain(ob: bpy.types.Object | None) -> list[bpy.types.Object]:
    """An object and its ancestors."""
    obs = []
    while ob is not None:
        obs.append(ob)
        ob = ob.parent
    return obs


def can_export(ob: bpy.types.Object | None) -> bool:
    """True if an object has splats: ours, or native ones."""
    return is_splats(ob) or is_native(ob)


def is_native(ob: bpy.types.Object | None) -> bool:
    """True if an object is a point cloud with the attributes of native splats (5.3)."""
    cloud = ob is not None and ob.type == "POINTCLOUD" and "gs_kind" not in ob
    return cloud and attributes.BASE in ob.data.attributes


def hide(ob: bpy.types.Object, scene: bpy.types.Scene, *, hidden: bool = True) -> None:
    """Hide or show an object in all view layers of a scene that contain it."""
    for layer in scene.view_layers:
        if layer.objects.get(ob.name) == ob:
            ob.hide_set(hidden, view_layer=layer)


def hide_points(scene: bpy.types.Scene, root: bpy.types.Object, *, hidden: bool = True) -> None:
    """Hide the SfM points of a capture, which would cover its splats as black dots, unless they are
    being edited; the eye in the outliner shows them again."""
    points = points_of(root)
    if points is not None and points.mode != "EDIT":
        hide(points, scene, hidden=hidden)


def keep_children(ob: bpy.types.Object, change: Matrix) -> None:
    """Keep the children of an object, such as its crop box, in place after its matrix was
    multiplied by `change` from the right."""
    for child in ob.children:
        if child.parent_type == "OBJECT":
            child.matrix_parent_inverse = change.inverted() @ child.matrix_parent_inverse


@contextmanager
def readable(ob: bpy.types.Object) -> Iterator[bpy.types.ID]:
    """The object's data; in Edit Mode, where attributes are not accessible, a copy."""
    if ob.mode != "EDIT":
        yield ob.data
        return
    ob.update_from_editmode()
    copy = ob.data.copy()
    try:
        yield copy
    finally:
        bpy.data.meshes.remove(copy)


def _fill(mesh: bpy.types.Mesh, splats: Splats) -> None:
    missing = len(splats) - len(mesh.vertices)
    if missing:
        attributes.add_points(mesh, missing)
    attributes.write(mesh, splats)
    attributes.leave_points_unselected(mesh)
    mesh.update()
