"""Meshes and point clouds that are only there while something goes on."""

import uuid

import bpy
from bpy.app.handlers import persistent

_MARK = "gs_temporary"


class Temporary:
    """One of them, without users. It is looked up anew each time: undo, redo and other files take
    it."""

    def __init__(self, block: bpy.types.Mesh | bpy.types.PointCloud) -> None:
        """Take it over."""
        self._mark = uuid.uuid4().hex
        self._is_cloud, self._name = isinstance(block, bpy.types.PointCloud), block.name
        block[_MARK] = self._mark

    def found(self) -> bpy.types.Mesh | bpy.types.PointCloud | None:
        """It, if it is there."""
        block = self._all.get(self._name)
        return block if block is not None and block.get(_MARK) == self._mark else None

    def take(self) -> bpy.types.Mesh | bpy.types.PointCloud | None:
        """It, if it is there, which from now on is the caller's."""
        block = self.found()
        if block is not None:
            del block[_MARK]
        return block

    def drop(self) -> None:
        """Remove it; nothing happens once it is another's."""
        block = self.found()
        if block is not None:
            self._all.remove(block)

    @property
    def _all(self) -> bpy.types.bpy_prop_collection:
        return bpy.data.pointclouds if self._is_cloud else bpy.data.meshes


@persistent
def _undone(*_: object) -> None:
    """Remove what undo and redo have brought back: their steps hold what was there meanwhile, as it
    was then."""
    for own in (bpy.data.meshes, bpy.data.pointclouds):
        for block in [b for b in own if not b.users and _MARK in b]:
            own.remove(block)


def on_register() -> None:
    """Follow undo and redo."""
    for handlers in (bpy.app.handlers.undo_post, bpy.app.handlers.redo_post):
        handlers.append(_undone)


def on_unregister() -> None:
    """Follow no more."""
    for handlers in (bpy.app.handlers.undo_post, bpy.app.handlers.redo_post):
        handlers.remove(_undone)
