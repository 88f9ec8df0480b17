"""Compositing scene: the splat-only scene of a main scene, and the visibility by collections in it.

Collections hide objects, or make them holdouts, per view layer of one scene. The splat-only scene
has no collections of its own, so visibility comes from the first view layer of the main scene.
"""

from pathlib import Path

import bpy

from .. import stored_paths
from ..interface.editable_check import taking
from ..splats.error_maps import is_map
from ..splats.objects import is_splats

MAIN_SCENE = "gs_main_scene"
"""Custom property of a splat-only scene: its main scene."""
SPLAT_SCENE = "gs_splat_scene"
"""Custom property of a scene: the scene that renders its splats."""


def main_scene(scene: bpy.types.Scene) -> bpy.types.Scene | None:
    """The main scene of a splat-only scene; None for any other scene."""
    main = scene.original.get(MAIN_SCENE)
    return main if isinstance(main, bpy.types.Scene) else None


def helper(scene: bpy.types.Scene, key: str) -> bpy.types.Scene | None:
    """The helper scene of a main scene by the custom property `key`; None: it has none. A copy of a
    main scene refers to those of the original, which are not its own."""
    other = scene.get(key)
    return other if isinstance(other, bpy.types.Scene) and other.get(MAIN_SCENE) == scene else None


def splats_of_run(
    run: Path, uid: int
) -> tuple[bpy.types.Scene, bpy.types.Object] | tuple[None, None]:
    """The object with a session uid, else another with splats of a run, and its scene, which is no
    splat-only one; None twice: there is none."""
    scenes = [s for s in (bpy.context.scene, *bpy.data.scenes) if MAIN_SCENE not in s]
    found = ((s, ob) for s in scenes for ob in s.objects if is_splats(ob) and not is_map(ob))
    of_run = [one for one in found if stored_paths.read(one[1], stored_paths.RUN) == str(run)]
    of_run.sort(key=lambda one: one[1].session_uid != uid)
    return of_run[0] if of_run else (None, None)


def collections_in(ob: bpy.types.Object, scene: bpy.types.Scene) -> list[bpy.types.Collection]:
    """Collections of a scene that have an object and accept others, else that of the scene."""
    own = {scene.collection, *scene.collection.children_recursive}
    return taking((c for c in ob.users_collection if c in own), scene)


def missing_splats(main: bpy.types.Scene | None, splat_scene: bpy.types.Scene | None) -> str:
    """Names of rendered splat objects of a main scene that its splat-only scene does not have."""
    if main is None or splat_scene is None:
        return ""
    there = set(splat_scene.original.collection.objects)
    rendered = (ob for ob in main.objects if is_splats(ob) and not ob.hide_render)
    return ", ".join(ob.name for ob in rendered if ob not in there)


def is_camera_visible(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether collections leave an original object visible to the camera."""
    main = main_scene(depsgraph.scene)
    if main is None:
        return not ob.indirect_only_get(view_layer=depsgraph.view_layer)
    layer = main.view_layers[0]
    rendered = is_rendered(ob, layer.layer_collection)
    return rendered and not ob.indirect_only_get(view_layer=layer)


def is_held_out(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether an original object is a holdout, by itself or by its collections."""
    main = main_scene(depsgraph.scene)
    layer = depsgraph.view_layer if main is None else main.view_layers[0]
    return ob.holdout_get(view_layer=layer)


def is_rendered(ob: bpy.types.Object, found: bpy.types.LayerCollection) -> bool:
    """Whether a layer collection, or one inside it, shows an original object in renders."""
    if found.collection.hide_render:
        return False
    listed = not found.exclude and found.collection.objects.get(ob.name) == ob
    return listed or any(is_rendered(ob, child) for child in found.children)
