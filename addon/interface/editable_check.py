"""Editability checks: Blender drops changes of linked data, and some changes of overrides."""

from collections.abc import Iterable

import bpy

_LOCAL = "make it local: Object > Relations > Make Local > Selected Objects and Data"
_LINKED = f"{_LOCAL}, or All if its collection is linked too"
_FOLLOWS = "make it editable (in the Outliner, Library Override > Make > Selected), or local"


def problem(block: bpy.types.ID) -> str:
    """Sentence why changes of a datablock would be lost, and what to do; empty if they are kept.

    Args:
        block: A mesh or point cloud is checked for its points, which overrides do not keep; any
            other datablock for its properties.
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
    first = next(filter(None, map(problem, blocks)), "")
    if first:
        raise ValueError(first)


def taking(
    collections: Iterable[bpy.types.Collection | None], scene: bpy.types.Scene | None = None
) -> list[bpy.types.Collection]:
    """Those of some collections that accept objects, else the collection of the scene or the
    context's scene: linked and overridden collections accept none."""
    usable = [
        c for c in collections if c is not None and c.is_editable and c.override_library is None
    ]
    return usable or [(scene or bpy.context.scene).collection]


def link_like(made: bpy.types.Object, ob: bpy.types.Object) -> None:
    """Link a new object to the collections of another, or the fallback of `taking`."""
    for collection in taking(ob.users_collection):
        collection.objects.link(made)
