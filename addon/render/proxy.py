"""Proxies: meshes of the splats' surface that cast and catch shadows, and reflect, in their place.

A proxy is a child of its splat object, invisible to cameras. In the scene of the meshes it casts
shadows and is reflected; its twin in the scene of shadows catches the shadows of the meshes.
"""

from collections.abc import Iterable

import bpy

from ..interface import editable_check
from ..interface.base_operator import Condition, Undoable
from ..process import poll_timer
from ..splats.objects import PROXY, active_splats, is_proxy, is_splats, proxy_of

MADE = "gs_made_proxy"
"""Custom property of a proxy: it was made from its splats, and is replaced and deleted with it."""
_OWN = "gs_own_proxy"
"""Custom property of splats: their proxy. Copies of the splats have it too."""
WALLS = "gs_walls"
"""Custom property of a world: the material of proxies as its light, see `dress`; of that material:
it is one."""
PROXIES = "gs_proxies"
"""Custom property of the collection of the proxies of a scene."""


def proxies_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The proxies in a scene."""
    return [ob for ob in scene.objects if is_proxy(ob)]


def left_over(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Objects in a scene that were proxies of splats that are no longer in it."""
    there = set(scene.objects)
    return [ob for ob in there if PROXY in ob and ob.parent not in there]


def _collection(scene: bpy.types.Scene) -> bpy.types.Collection:
    """The collection of a scene's proxies, made if missing: the scene of shadows leaves it out."""
    for child in scene.collection.children_recursive:
        if PROXIES in child:
            return child
    made = bpy.data.collections.new("Splat Proxies")
    made[PROXIES] = True
    scene.collection.children.link(made)
    return made


def attach(scene: bpy.types.Scene, splats: bpy.types.Object, mesh: bpy.types.Object) -> None:
    """Make a mesh object the proxy of splats, in place of one before, where it stands.

    It follows their transform and visibility.
    """
    if (before := proxy_of(splats)) is not None and before != mesh:
        detach(scene, before)
    _move(mesh, _collection(scene))
    place = mesh.matrix_world.copy()
    mesh.matrix_basis = splats.matrix_world.inverted() @ place
    _bind(scene, splats, mesh)


def _bind(scene: bpy.types.Scene, splats: bpy.types.Object, mesh: bpy.types.Object) -> None:
    """Make a mesh object in the space of splats their proxy."""
    mesh.parent = splats
    mesh.matrix_parent_inverse.identity()
    mesh[PROXY], splats[_OWN] = True, mesh
    mesh.visible_camera, mesh.display_type, mesh.hide_select = False, "WIRE", True
    mesh.hide_viewport = splats.hide_viewport
    mesh.driver_remove("hide_render")
    driver = mesh.driver_add("hide_render").driver
    driver.type = "AVERAGE"  # needs no permission for scripts
    variable = driver.variables.new()
    variable.targets[0].id, variable.targets[0].data_path = splats, "hide_render"
    mesh.select_set(False)
    dress(scene, mesh)


def dress(scene: bpy.types.Scene, proxy: bpy.types.Object) -> None:
    """Give a proxy the material that its scene's world has for proxies, else its own again.

    That material shines as the splats do, so that the walls of a room light what is inside.
    """
    worn = scene.world.get(WALLS) if scene.world is not None else None
    if worn is not None and not proxy.material_slots and editable_check.keeps(proxy.data):
        proxy.data.materials.append(None)
    if worn is None:
        _undress(proxy)
        return
    for slot in proxy.material_slots:
        if slot.link != "OBJECT" or slot.material != worn:
            slot.link = "OBJECT"  # first: the material is that of the link
            slot.material = worn


def _undress(proxy: bpy.types.Object) -> None:
    for slot in proxy.material_slots:
        if slot.link == "OBJECT" and slot.material is not None and WALLS in slot.material:
            slot.material = None
            slot.link = "DATA"


def _move(ob: bpy.types.Object, collection: bpy.types.Collection) -> None:
    for other in ob.users_collection:
        other.objects.unlink(ob)
    collection.objects.link(ob)


def detach(scene: bpy.types.Scene, proxy: bpy.types.Object) -> None:
    """Make a proxy an object of its own again, where it stands."""
    place = proxy.matrix_world.copy()
    _move(proxy, scene.collection)
    if proxy.parent is not None:
        proxy.parent.pop(_OWN, None)
    proxy.driver_remove("hide_render")
    proxy.parent = None
    proxy.matrix_world = place
    del proxy[PROXY]
    proxy.visible_camera, proxy.display_type, proxy.hide_select = True, "TEXTURED", False
    _undress(proxy)


def _meshes_to_use(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Selected meshes that are neither splats nor proxies."""
    return [
        ob
        for ob in context.selected_objects
        if ob.type == "MESH" and not is_splats(ob) and not is_proxy(ob)
    ]


class UseAsProxy(Undoable, bpy.types.Operator):
    """Let the selected mesh cast and catch shadows, and be reflected, in place of the active
    splats: it follows them, and cameras do not see it"""

    bl_idname = "gscore.use_as_proxy"
    bl_label = "Use Mesh as Proxy"
    needs = Condition(
        lambda context: active_splats(context) is not None and len(_meshes_to_use(context)) == 1,
        "Select a mesh of the surface, then the splats (Shift-click)",
    )

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The mesh, the splats' former proxy and the scene."""
        splats = active_splats(context)
        return [*_meshes_to_use(context), *filter(None, (proxy_of(splats),)), context.scene]

    def run(self, context: bpy.types.Context) -> str:
        """Attach the mesh."""
        splats, mesh = active_splats(context), _meshes_to_use(context)[0]
        attach(context.scene, splats, mesh)
        return f"{mesh.name} is the proxy of {splats.name}."


def _removable(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The proxy of the active splats, and those of removed splats."""
    splats = active_splats(context)
    proxy = None if splats is None else proxy_of(splats)
    return [*filter(None, (proxy,)), *left_over(context.scene)]


class RemoveProxy(Undoable, bpy.types.Operator):
    """Make the proxy of the active splats, and those of removed splats, visible meshes of their own
    again"""

    bl_idname = "gscore.remove_proxy"
    bl_label = "Remove Proxy"
    needs = Condition(
        lambda context: bool(_removable(context)),
        "The active splats have no proxy",
    )

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The proxies and the scene."""
        return *_removable(context), context.scene

    def run(self, context: bpy.types.Context) -> str:
        """Detach the proxies."""
        proxies = _removable(context)
        for proxy in proxies:
            detach(context.scene, proxy)
        names = ", ".join(proxy.name for proxy in proxies)
        return f"{names}: no proxy any more, but a mesh that cameras see."


def _copies(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Splats that are copies of others with a proxy, and lack their own."""
    return [
        ob
        for ob in scene.objects
        if (own := ob.get(_OWN)) is not None and own.parent != ob and is_proxy(own)
    ]


def _made_for_none(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Made proxies whose splats are no longer in the scene."""
    return [ob for ob in left_over(scene) if MADE in ob]


def tend(scene: bpy.types.Scene) -> bool:
    """Give copies of splats a copy of the proxy, with the same mesh, and remove made proxies with
    their splats; True if something changed."""
    if not editable_check.keeps(scene):
        return False
    copies, old = [ob for ob in _copies(scene) if editable_check.keeps(ob)], _made_for_none(scene)
    for splats in copies:
        copy = splats[_OWN].copy()
        _collection(scene).objects.link(copy)
        _bind(scene, splats, copy)
    for ob in filter(editable_check.keeps, old):
        bpy.data.objects.remove(ob)
    return bool(copies or old)


def _collect() -> bool:
    """`tend` the scenes in which objects were added or removed, while nothing renders."""
    if bpy.app.is_job_running("RENDER"):
        return False
    names, changed = set(_changed), False
    _changed.clear()
    for name in names & set(bpy.data.scenes.keys()):
        changed |= tend(bpy.data.scenes[name])
    return changed


_changed: set[str] = set()
"""Names of scenes in which objects were added or removed."""
APPENDED = ((poll_timer.POLLERS, poll_timer.Poller(_collect, lambda: bool(_changed))),)


@bpy.app.handlers.persistent
def _after_update(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Hide proxies in the viewport with their splats (a driver cannot, as Blender does not evaluate
    hidden splats), and give them the material of the scene's world."""
    for ob in (ob for one in scene.collection.children if PROXIES in one for ob in one.objects):
        if is_proxy(ob) and editable_check.keeps(ob):
            if ob.hide_viewport != ob.parent.hide_viewport:
                ob.hide_viewport = ob.parent.hide_viewport
            dress(scene, ob)
    # Objects cannot be made or removed here: Blender crashes then.
    changed = depsgraph is not None and depsgraph.id_type_updated("COLLECTION")
    if changed and any(PROXIES in one for one in scene.collection.children):
        _changed.add(scene.name)
        poll_timer.ensure()


HANDLERS = {"depsgraph_update_post": _after_update}
