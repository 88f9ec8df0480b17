"""Holdout meshes of a depsgraph: meshes that hide the splats behind them.

A holdout object hides splats with all instances that it makes, whatever their type. In an
instanced collection, a holdout object hides splats by itself too.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import bpy
import numpy as np

from ..triangles import Triangles, triangles_of
from . import compositing_scene, generated_instances
from .generated_instances import may_hold_out
from .instances import instances_with_paths


@dataclass(frozen=True, kw_only=True)
class HoldoutMesh:
    """A mesh copied out of Blender."""

    triangles: Triangles
    """Triangles in object space."""
    matrices: np.ndarray
    """[K, 4, 4] float64, object to world, one per instance."""


def same_meshes(some: tuple[HoldoutMesh, ...], others: tuple[HoldoutMesh, ...]) -> bool:
    """Whether two sets of meshes hide the same."""
    return len(some) == len(others) and all(
        np.array_equal(a.matrices, b.matrices) and _same(a.triangles, b.triangles)
        for a, b in zip(some, others, strict=True)
    )


def _same(one: Triangles, other: Triangles) -> bool:
    return one is other or (
        np.array_equal(one.vertices, other.vertices)
        and np.array_equal(one.triangles, other.triangles)
    )


def may_hide(ob: bpy.types.Object) -> bool:
    """Whether an object may hide splats by its faces or by those of its instances."""
    return may_hold_out(ob) or generated_instances.may_grow(ob) or ob.instance_type == "COLLECTION"


def is_holdout(layer: bpy.types.ViewLayer, ob: bpy.types.Object) -> bool:
    """Whether an object is a holdout in a view layer, by itself or by its collection."""
    return ob.is_holdout or ob.original.holdout_get(view_layer=layer)


def holdouts_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Holdout objects of a scene, and the objects that their instances need."""
    layer = scene.view_layers[0]
    there = [ob for ob in layer.objects if ob is not None]  # 4.2 has None for removed objects
    found = [ob for ob in there if may_hide(ob) and is_holdout(layer, ob)]
    on_corners = {ob for ob in found if ob.instance_type in {"VERTS", "FACES"}}
    shown = (ob for ob in there if ob.parent in on_corners and "gs_kind" not in ob)
    return list(dict.fromkeys([*found, *shown]))


def missing_holdouts(main: bpy.types.Scene | None, apart: bpy.types.Scene | None) -> str:
    """Names of holdout objects of a main scene that its splat-only scene does not have."""
    if main is None or apart is None:
        return ""
    there = set(apart.original.collection.objects)
    return ", ".join(ob.name for ob in holdouts_of(main) if ob not in there)


class HoldoutMeshes:
    """Copies of holdout meshes of similar depsgraphs, renewed when they change."""

    def __init__(self) -> None:
        self._known: dict[int, Triangles] = {}
        self._grown: dict[int, list[generated_instances.Part]] = {}
        """Parts by object, in the space of their instancers."""
        self._walked: dict[generated_instances.InstancerKey, list[generated_instances.Part]] = {}
        """Generated parts by instancer, in world space."""

    def clear(self) -> None:
        """Drop all copies."""
        for kept in (self._known, self._grown, self._walked):
            kept.clear()

    def forget_changed(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Drop copies of data that a depsgraph update reports as changed."""
        for update in depsgraph.updates:
            # Any object may have been an instance.
            self._grown.clear()
            self._walked.clear()
            if update.is_updated_geometry and isinstance(update.id, bpy.types.Object):
                self._known.pop(update.id.original.session_uid, None)

    def of(
        self,
        depsgraph: bpy.types.Depsgraph,
        wanted: Callable[[bpy.types.Object, bpy.types.Object], bool] = lambda ob, shown_by: True,
    ) -> tuple[HoldoutMesh, ...]:
        """All holdout meshes of a depsgraph, with their instances.

        Args:
            depsgraph: Its visible objects.
            wanted: Predicate of an evaluated object and the object that shows it, possibly itself.
        """
        found, uids = [], set()
        instancers: set[generated_instances.InstancerKey] = set()
        paths: set[generated_instances.InstancerKey] = set()
        for shown_by, is_shown in _owners(depsgraph):
            for ob, matrix, path in instances_with_paths(shown_by, depsgraph, may_hide):
                if not (_cuts(ob, shown_by, depsgraph) and wanted(ob, shown_by)):
                    continue
                uid = ob.original.session_uid
                uids.add(uid)
                walker = shown_by.original.session_uid, path
                paths.add(walker)
                parts = []
                if generated_instances.needs_walk(ob):
                    instancers.add(walker)
                elif generated_instances.may_grow(ob):
                    if uid not in self._grown:
                        self._grown[uid] = generated_instances.generated_instances(ob, depsgraph)
                    parts = self._grown[uid]
                itself = is_shown or ob != shown_by
                if itself and may_hold_out(ob) and not _hides_itself(ob, depsgraph, bool(parts)):
                    parts = [self._own(ob), *parts]
                for triangles, places in parts:
                    if len(triangles.triangles):
                        found.append(HoldoutMesh(triangles=triangles, matrices=matrix @ places))
        if instancers - self._walked.keys():
            self._walked = generated_instances.walked(depsgraph, instancers, paths)
        for walker in instancers:
            found += [HoldoutMesh(triangles=t, matrices=m) for t, m in self._walked[walker]]
        for uid in self._known.keys() - uids:
            del self._known[uid]
        return tuple(found)

    def _own(self, ob: bpy.types.Object) -> generated_instances.Part:
        """The faces of an evaluated object without instances."""
        uid = ob.original.session_uid
        if uid not in self._known:
            self._known[uid] = triangles_of(ob)
        return self._known[uid], np.eye(4)[None]


def _owners(depsgraph: bpy.types.Depsgraph) -> Iterator[tuple[bpy.types.Object, bool]]:
    """Evaluated objects that a depsgraph shows itself or by instances, and whether itself."""
    known = set()
    for ob in depsgraph.objects:
        known.add(ob.original.session_uid)
        yield ob, True
    # They do not include instancers with Show Instancer off.
    for layer in _layers(depsgraph):
        for ob in layer.objects:
            if ob is None or ob.original.session_uid in known or not may_hide(ob):
                continue
            if not _shows_instancer(ob, depsgraph) and _is_on(ob.original, layer, depsgraph):
                yield ob.evaluated_get(depsgraph), False


def _layers(depsgraph: bpy.types.Depsgraph) -> Iterator[bpy.types.ViewLayer]:
    """The view layer of a depsgraph, and those that Blender uses of its background sets."""
    yield depsgraph.view_layer
    scene = depsgraph.scene.original.background_set
    while scene is not None:
        yield next((layer for layer in scene.view_layers if layer.use), scene.view_layers[0])
        scene = scene.background_set


def _is_on(
    ob: bpy.types.Object, layer: bpy.types.ViewLayer, depsgraph: bpy.types.Depsgraph
) -> bool:
    """Whether an original object of a view layer is visible."""
    if depsgraph.mode != "RENDER":
        return ob.visible_get(view_layer=layer)
    return not ob.hide_render and compositing_scene.is_rendered(ob, layer.layer_collection)


def _shows_instancer(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    render = depsgraph.mode == "RENDER"
    return ob.show_instancer_for_render if render else ob.show_instancer_for_viewport


def _hides_itself(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph, grows: bool) -> bool:
    """Whether an evaluated object hides its own faces in favor of its instances."""
    return not _shows_instancer(ob, depsgraph) and (grows or generated_instances.always_grows(ob))


def _cuts(ob: bpy.types.Object, shown_by: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    holdout = ob.is_holdout or shown_by.is_holdout
    if not (holdout or compositing_scene.is_held_out(shown_by.original, depsgraph)):
        return False
    if depsgraph.mode != "RENDER":
        return True
    visible = ob.visible_camera and shown_by.visible_camera
    return visible and compositing_scene.is_camera_visible(shown_by.original, depsgraph)


SHARED = HoldoutMeshes()
"""Copies for the viewports of this Blender session."""
