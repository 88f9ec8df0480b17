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
    """In its own axes."""
    matrices: np.ndarray
    """[K, 4, 4] float64 to the world, of each place where it stands."""


def same_meshes(some: tuple[HoldoutMesh, ...], others: tuple[HoldoutMesh, ...]) -> bool:
    """Whether they hide the same."""
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
    """Whether an object may hide splats: by its faces, or by those of instances."""
    return may_hold_out(ob) or generated_instances.may_grow(ob) or ob.instance_type == "COLLECTION"


def is_holdout(layer: bpy.types.ViewLayer, ob: bpy.types.Object) -> bool:
    """Whether an object is held out in a view layer, by itself or by its collection."""
    return ob.is_holdout or ob.original.holdout_get(view_layer=layer)


def holdouts_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Objects that a scene holds out, and what it takes for their instances to be made."""
    layer = scene.view_layers[0]
    there = [ob for ob in layer.objects if ob is not None]  # 4.2 keeps places of removed objects
    found = [ob for ob in there if may_hide(ob) and is_holdout(layer, ob)]
    on_corners = {ob for ob in found if ob.instance_type in {"VERTS", "FACES"}}
    shown = (ob for ob in there if ob.parent in on_corners and "gs_kind" not in ob)
    return list(dict.fromkeys([*found, *shown]))


def not_taken_over(main: bpy.types.Scene | None, apart: bpy.types.Scene | None) -> str:
    """Names of what a scene holds out and the scene that renders its splats apart does not have."""
    if main is None or apart is None:
        return ""
    there = set(apart.original.collection.objects)
    return ", ".join(ob.name for ob in holdouts_of(main) if ob not in there)


class HoldoutMeshes:
    """Copies of the meshes of depsgraphs that are alike, made where they change."""

    def __init__(self) -> None:
        self._known: dict[int, Triangles] = {}
        self._grown: dict[int, list[generated_instances.Part]] = {}
        """In the axes of the objects that make them."""
        self._walked: dict[generated_instances.Walker, list[generated_instances.Part]] = {}
        """In the world."""

    def clear(self) -> None:
        """Let go of everything."""
        for kept in (self._known, self._grown, self._walked):
            kept.clear()

    def forget_changed(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Copy again what a depsgraph update says has changed."""
        for update in depsgraph.updates:
            # Instances may be of anything.
            self._grown.clear()
            self._walked.clear()
            if update.is_updated_geometry and isinstance(update.id, bpy.types.Object):
                self._known.pop(update.id.original.session_uid, None)

    def of(
        self,
        depsgraph: bpy.types.Depsgraph,
        wanted: Callable[[bpy.types.Object, bpy.types.Object], bool] = lambda ob, shown_by: True,
    ) -> tuple[HoldoutMesh, ...]:
        """All that a depsgraph holds out, with the instances that it makes.

        Args:
            depsgraph: What shows.
            wanted: Whether an evaluated object that another one shows, or itself, counts.
        """
        found, uids = [], set()
        walkers: set[generated_instances.Walker] = set()
        paths: set[generated_instances.Walker] = set()
        for shown_by, is_shown in _owners(depsgraph):
            for ob, matrix, path in instances_with_paths(shown_by, depsgraph, may_hide):
                if not (_is_held(ob, shown_by, depsgraph) and wanted(ob, shown_by)):
                    continue
                uid = ob.original.session_uid
                uids.add(uid)
                walker = shown_by.original.session_uid, path
                paths.add(walker)
                parts = []
                if generated_instances.has_to_be_walked(ob):
                    walkers.add(walker)
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
        if walkers - self._walked.keys():
            self._walked = generated_instances.walked(depsgraph, walkers, paths)
        for walker in walkers:
            found += [HoldoutMesh(triangles=t, matrices=m) for t, m in self._walked[walker]]
        for uid in self._known.keys() - uids:
            del self._known[uid]
        return tuple(found)

    def _own(self, ob: bpy.types.Object) -> generated_instances.Part:
        """The faces of an evaluated object by itself."""
        uid = ob.original.session_uid
        if uid not in self._known:
            self._known[uid] = triangles_of(ob)
        return self._known[uid], np.eye(4)[None]


def _owners(depsgraph: bpy.types.Depsgraph) -> Iterator[tuple[bpy.types.Object, bool]]:
    """The evaluated objects that a depsgraph shows, or whose instances it does; whether it shows
    them."""
    seen = set()
    for ob in depsgraph.objects:
        seen.add(ob.original.session_uid)
        yield ob, True
    # What has instances and no Show Instancer is not among them.
    for layer in _layers(depsgraph):
        for ob in layer.objects:
            if ob is None or ob.original.session_uid in seen or not may_hide(ob):
                continue
            if not _shows_instancer(ob, depsgraph) and _is_on(ob.original, layer, depsgraph):
                yield ob.evaluated_get(depsgraph), False


def _layers(depsgraph: bpy.types.Depsgraph) -> Iterator[bpy.types.ViewLayer]:
    """The view layer of a depsgraph, and those of its scene's background sets, as Blender takes
    them."""
    yield depsgraph.view_layer
    scene = depsgraph.scene.original.background_set
    while scene is not None:
        yield next((layer for layer in scene.view_layers if layer.use), scene.view_layers[0])
        scene = scene.background_set


def _is_on(
    ob: bpy.types.Object, layer: bpy.types.ViewLayer, depsgraph: bpy.types.Depsgraph
) -> bool:
    """Whether nothing hides an original object of a view layer."""
    if depsgraph.mode != "RENDER":
        return ob.visible_get(view_layer=layer)
    return not ob.hide_render and compositing_scene.is_rendered(ob, layer.layer_collection)


def _shows_instancer(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    render = depsgraph.mode == "RENDER"
    return ob.show_instancer_for_render if render else ob.show_instancer_for_viewport


def _hides_itself(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph, grows: bool) -> bool:
    """Whether an evaluated object leaves its own faces out for those of its instances."""
    return not _shows_instancer(ob, depsgraph) and (grows or generated_instances.always_grows(ob))


def _is_held(
    ob: bpy.types.Object, shown_by: bpy.types.Object, depsgraph: bpy.types.Depsgraph
) -> bool:
    held = ob.is_holdout or shown_by.is_holdout
    if not (held or compositing_scene.is_held_out(shown_by.original, depsgraph)):
        return False
    if depsgraph.mode != "RENDER":
        return True
    seen = ob.visible_camera and shown_by.visible_camera
    return seen and compositing_scene.is_seen(shown_by.original, depsgraph)


SHARED = HoldoutMeshes()
"""Those of the viewports of this Blender session."""
