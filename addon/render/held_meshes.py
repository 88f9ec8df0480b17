"""Meshes that are held out, as a depsgraph shows them: they hide the splats behind them."""

from dataclasses import dataclass

import bpy
import numpy as np

from ..splats.objects import is_splats
from ..triangles import WITH_FACES, Triangles, triangles_of
from . import apart
from .instances import instances


@dataclass(frozen=True, kw_only=True)
class HeldMesh:
    """A mesh copied out of Blender."""

    triangles: Triangles
    """In the object's own axes."""
    matrix: np.ndarray
    """[4, 4] float64 to the world."""


def same_meshes(some: tuple[HeldMesh, ...], others: tuple[HeldMesh, ...]) -> bool:
    """Whether they hide the same."""
    return len(some) == len(others) and all(
        np.array_equal(a.matrix, b.matrix) and _same(a.triangles, b.triangles)
        for a, b in zip(some, others, strict=True)
    )


def _same(one: Triangles, other: Triangles) -> bool:
    return one is other or (
        np.array_equal(one.vertices, other.vertices)
        and np.array_equal(one.triangles, other.triangles)
    )


def may_be_held(ob: bpy.types.Object) -> bool:
    """Whether an object has faces, or may get some, and is none of ours."""
    return ob.type in WITH_FACES and not is_splats(ob) and "gs_kind" not in ob


def is_held_by(layer: bpy.types.ViewLayer, ob: bpy.types.Object) -> bool:
    """Whether an object is held out in a view layer, by itself or by its collection."""
    return ob.is_holdout or ob.original.holdout_get(view_layer=layer)


def held_by(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Objects that a scene holds out: with faces, or with instances that may have some."""
    layer = scene.view_layers[0]
    return [
        ob
        for ob in filter(None, layer.objects)  # 4.2 keeps places of removed objects
        if (may_be_held(ob) or ob.instance_type == "COLLECTION") and is_held_by(layer, ob)
    ]


def not_taken_over(main: bpy.types.Scene | None, apart: bpy.types.Scene | None) -> str:
    """Names of what a scene holds out and the scene that renders its splats apart does not have."""
    if main is None or apart is None:
        return ""
    there = set(apart.original.collection.objects)
    return ", ".join(ob.name for ob in held_by(main) if ob not in there)


class HeldMeshes:
    """Copies of the meshes of depsgraphs that are alike, made where they change."""

    def __init__(self) -> None:
        self._known: dict[int, Triangles] = {}

    def clear(self) -> None:
        """Let go of everything."""
        self._known.clear()

    def forget_changed(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Copy again what a depsgraph update says has changed."""
        for update in depsgraph.updates:
            if update.is_updated_geometry and isinstance(update.id, bpy.types.Object):
                self._known.pop(update.id.original.session_uid, None)

    def of(self, depsgraph: bpy.types.Depsgraph) -> tuple[HeldMesh, ...]:
        """All that a depsgraph holds out; those in collection instances too."""
        found, uids = [], set()
        for shown_by in depsgraph.objects:
            for ob, matrix in instances(shown_by, depsgraph, may_be_held):
                if not _is_held(ob, shown_by, depsgraph):
                    continue
                uid = ob.original.session_uid
                uids.add(uid)
                if uid not in self._known:
                    self._known[uid] = triangles_of(ob)
                if len(self._known[uid].triangles):
                    found.append(HeldMesh(triangles=self._known[uid], matrix=matrix))
        for uid in self._known.keys() - uids:
            del self._known[uid]
        return tuple(found)


def _is_held(
    ob: bpy.types.Object, shown_by: bpy.types.Object, depsgraph: bpy.types.Depsgraph
) -> bool:
    held = ob.is_holdout or shown_by.is_holdout
    if not (held or apart.is_held_out(shown_by.original, depsgraph)):
        return False
    if depsgraph.mode != "RENDER":
        return True
    return ob.visible_camera and apart.is_seen(shown_by.original, depsgraph)


SHARED = HeldMeshes()
"""Those of the viewports of this Blender session."""
