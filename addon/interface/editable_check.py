"""Editability checks: Blender drops changes of linked data, and keeps only some of overrides."""

from collections.abc import Iterable

import bpy

_LOCAL = "make it local: Object > Relations > Make Local > Selected Objects and Data"
_LINKED = f"{_LOCAL}, or All where its collection is linked too"
_FOLLOWS = "make it editable (in the Outliner, Library Override > Make > Selected), or local"


def problem(block: bpy.types.ID) -> str:
    """Why changes of a datablock would be lost, and what to do, a sentence; empty where they stay.

    Args:
        block: A mesh or point cloud is looked at for its points, of which an override keeps none;
            everything else for its properties.
    """
    name = f"{type(block).__name__} {block.name}"
    if block.library is not None or not block.is_editable:
        source = "another file" if block.library is None else block.library.name
        return f"{name} is linked from {source}; {_LINKED}."
    override = block.override_library
    if override is None:
        return ""
    if isinstance(block, bpy.types.Mesh | bpy.types.PointCloud):
        return f"{name} is a library override, which keeps no points; {_LOCAL}."
    if override.is_system_override:
        return f"{name} is an override that follows its library; {_FOLLOWS}."
    return ""


def keeps(block: bpy.types.ID) -> bool:
    """True if Blender keeps changes of a datablock."""
    return not problem(block)


def check(*blocks: bpy.types.ID) -> None:
    """Raise ValueError with the first problem of some datablocks."""
    found = next(filter(None, map(problem, blocks)), "")
    if found:
        raise ValueError(found)


def taking(
    wanted: Iterable[bpy.types.Collection | None], scene: bpy.types.Scene | None = None
) -> list[bpy.types.Collection]:
    """Those of some collections that take objects, else that of the scene, or of the one that is
    shown: linked and overridden ones take none, and a context may have none."""
    found = [c for c in wanted if c is not None and c.is_editable and c.override_library is None]
    return found or [(scene or bpy.context.scene).collection]


def link_like(made: bpy.types.Object, ob: bpy.types.Object) -> None:
    """Put a new object into the collections of another, or where `taking` says."""
    for collection in taking(ob.users_collection):
        collection.objects.link(made)
