"""Shadow scene: renders the shadows of meshes on the proxies of splats, by Cycles.

It contains twins of the proxies as shadow catchers, and the main scene's lights and objects, which
its camera does not see. Its pass Shadow Catcher is the light of the proxies with these objects,
divided by that without them; 1 where there is no proxy. Shadows of proxies on each other are in
both and cancel, as the photos show them already.
"""

from typing import Any

import bpy

from ..splats.objects import PROXY, is_native, is_proxy, is_splats
from .compositing_scene import helper
from .proxy import PROXIES, dress, proxies_of

SHADOW_SCENE = "gs_shadow_scene"
"""Custom property of a scene: the scene that renders the shadows on its splats."""
PASS = "Shadow Catcher"
_TWIN, _CASTERS = "gs_catcher", "gs_casters"
"""Custom properties: of the twin of a proxy, the proxy; of a scene, its collection of objects that
cast shadows."""
_SHARED = "samples", "use_denoising", "device", "seed", "use_adaptive_sampling"
_SAMPLES = 64
"""Samples if the meshes are not rendered by Cycles."""


def synchronise(scene: bpy.types.Scene, other: bpy.types.Scene) -> None:
    """Copy world, settings and objects of the main scene to its shadow scene.

    Collections are linked as a whole, so that what is added to them later casts shadows too.
    Objects cannot be linked by handlers of Blender, which crashes then.
    """
    layer = other.view_layers[0]
    other.render.engine, other.render.film_transparent = "CYCLES", True
    layer.cycles.use_pass_shadow_catcher = True
    if not isinstance(other.get(_CASTERS), bpy.types.Collection):
        other[_CASTERS] = bpy.data.collections.new(f"{other.name} Casters")
    casters = other[_CASTERS]
    if casters not in other.collection.children.values():
        other.collection.children.link(casters)
    _keep_only(casters.objects, own_casters(scene))
    inside = [child for child in scene.collection.children if PROXIES not in child]
    _keep_only(casters.children, inside)
    _keep_only(other.collection.objects, _twins(scene, other))
    layer.update()  # layer collections of what was linked
    own = layer.layer_collection.children[casters.name]
    own.indirect_only = True
    _exclude(own, scene.view_layers[0].layer_collection)
    follow(scene, other)


def _exclude(own: bpy.types.LayerCollection, main: bpy.types.LayerCollection) -> None:
    """Exclude the collections that a main scene's layer excludes, and those of proxies."""
    pairs = {child.collection: child for child in main.children}
    for child in own.children:
        other = pairs.get(child.collection)
        if other is not None:
            child.exclude = other.exclude or PROXIES in child.collection
            _exclude(child, other)


def follow(scene: bpy.types.Scene, other: bpy.types.Scene) -> None:
    """Copy world and settings of the main scene; writes only differences."""
    if other.world != scene.world:
        other.world = scene.world
    for twin in other.collection.objects:
        if _TWIN in twin:
            dress(scene, twin)
    settings = {name: getattr(scene.cycles, name) for name in _SHARED}
    if scene.render.engine != "CYCLES":
        settings["samples"] = _SAMPLES
    for name, value in settings.items():
        if getattr(other.cycles, name) != value:
            setattr(other.cycles, name, value)


def missing(scene: bpy.types.Scene) -> str:
    """Names of what the shadow scene does not follow until it is synchronised: objects that were
    added to no collection but the scene's own one, proxies that are new or have another mesh, and
    twins of former proxies."""
    other, proxies = helper(scene, SHADOW_SCENE), proxies_of(scene)
    if other is None:
        return ", ".join(ob.name for ob in proxies)
    twins = [ob for ob in other.collection.objects if _TWIN in ob]
    there = {twin[_TWIN] for twin in twins if twin[_TWIN] and twin.data == twin[_TWIN].data}
    there.intersection_update(proxies)
    if isinstance(casters := other.get(_CASTERS), bpy.types.Collection):
        there.update(casters.objects)
    found = [ob for ob in (*own_casters(scene), *proxies) if ob not in there]
    found += [twin for twin in twins if twin[_TWIN] not in proxies]
    return ", ".join(ob.name for ob in found)


def drop(scene: bpy.types.Scene) -> None:
    """Remove what only a main scene's shadow scene uses, before the scene itself."""
    other = helper(scene, SHADOW_SCENE)
    if other is None:
        return
    for ob in [ob for ob in other.collection.objects if _TWIN in ob]:
        bpy.data.objects.remove(ob)
    if isinstance(casters := other.get(_CASTERS), bpy.types.Collection):
        bpy.data.collections.remove(casters)


def own_casters(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Lights and objects in the scene's own collection, without splats."""
    return [
        ob
        for ob in scene.collection.objects
        if ob.type != "CAMERA" and not (is_splats(ob) or is_native(ob) or is_proxy(ob))
    ]


def _twins(scene: bpy.types.Scene, other: bpy.types.Scene) -> list[bpy.types.Object]:
    """A visible shadow catcher with the mesh of each proxy."""
    before = [ob for ob in other.collection.objects if _TWIN in ob]
    known = {twin[_TWIN]: twin for twin in before}
    found = []
    for proxy in proxies_of(scene):
        twin = known.get(proxy)
        if twin is None:
            twin = proxy.copy()
            twin.name = f"{proxy.name} Catcher"
            twin[_TWIN] = proxy
            del twin[PROXY]
            twin.visible_camera, twin.is_shadow_catcher = True, True
        if twin.data != proxy.data:
            twin.data = proxy.data
        twin.matrix_parent_inverse = proxy.matrix_parent_inverse
        twin.matrix_basis = proxy.matrix_basis
        dress(scene, twin)
        found.append(twin)
    for twin in before:
        if twin not in found:
            bpy.data.objects.remove(twin)
    return found


def _keep_only(links: Any, kept: list[Any]) -> None:
    """Link objects or collections to a collection, and unlink others."""
    there = set(links)  # names of linked ones are not unique
    for one in there - set(kept):
        links.unlink(one)
    for one in kept:
        if one not in there:
            links.link(one)
