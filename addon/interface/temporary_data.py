"""Temporary datablocks that exist only during an operation."""

import time
import uuid
from collections import Counter
from collections.abc import Iterable, Iterator

import bpy
from bpy.app.handlers import persistent

from ..process.incremental_tasks import BUDGET

_MARK = "gs_temporary"
_BATCH = 10
"""Objects removed per call. Each call takes longer the more objects the file has."""
Block = bpy.types.Mesh | bpy.types.PointCloud | bpy.types.Collection


class Temporary:
    """A temporary datablock without users; a collection includes its content. It is looked up at
    each use, because undo, redo and file loads remove it."""

    def __init__(self, block: Block) -> None:
        """Take ownership of a datablock."""
        self._mark = uuid.uuid4().hex
        self._kind, self._name = type(block), block.name
        block[_MARK] = self._mark

    def found(self) -> Block | None:
        """The datablock, if it exists."""
        block = _kinds()[self._kind].get(self._name)
        return block if block is not None and block.get(_MARK) == self._mark else None

    def mark(self, block: bpy.types.Collection | bpy.types.Object) -> None:
        """Mark a datablock that was put into it, which a file saved meanwhile contains too."""
        block[_MARK] = self._mark

    def take(self) -> Block | None:
        """The datablock, if it exists; ownership passes to the caller."""
        block = self.found()
        if block is not None:
            release(block)
            for one in _inside(block):
                release(one)
        return block

    def dropping(self) -> Iterator[None]:
        """Like `drop`, with some of a collection's objects per step."""
        until = time.perf_counter() + BUDGET
        while some := _objects(self.found())[:_BATCH]:
            _remove(some)
            if time.perf_counter() > until:
                yield
                until = time.perf_counter() + BUDGET
        self.drop()

    def drop(self) -> None:
        """Remove the datablock, unless ownership has passed on."""
        block = self.found()
        if block is not None:
            _remove([block, *_inside(block)])


def release(block: bpy.types.ID) -> None:
    """Pass ownership of a collection's content to the caller, who has unlinked it."""
    block.pop(_MARK, None)


def _kinds() -> dict[type, bpy.types.bpy_prop_collection]:
    return {
        bpy.types.Mesh: bpy.data.meshes,
        bpy.types.PointCloud: bpy.data.pointclouds,
        bpy.types.Collection: bpy.data.collections,
    }


def _inside(block: Block) -> list[bpy.types.ID]:
    groups = block.children_recursive if isinstance(block, bpy.types.Collection) else ()
    return [*groups, *_objects(block)]


def _objects(block: Block | None) -> list[bpy.types.Object]:
    return list(block.all_objects) if isinstance(block, bpy.types.Collection) else []


def _remove(blocks: Iterable[bpy.types.ID]) -> None:
    """Remove datablocks, and the data and actions that only these use."""
    doomed = set(blocks)
    data = {ob.data for ob in doomed if isinstance(ob, bpy.types.Object) and ob.data is not None}
    doomed |= {one for one in data if one.users == 1}
    moved = [one.animation_data for one in doomed if getattr(one, "animation_data", None)]
    uses = Counter(animation.action for animation in moved if animation.action is not None)
    doomed |= {action for action, count in uses.items() if action.users == count}
    if doomed:
        bpy.data.batch_remove(list(doomed))


def _marked() -> list[Block]:
    return [block for own in _kinds().values() for block in own if _MARK in block]


@persistent
def _undone(*_: object) -> None:
    """Remove temporary datablocks that undo and redo have restored from their steps."""
    for block in [b for b in _marked() if not b.users]:
        _remove([block, *_inside(block)])


@persistent
def _loaded(*_: object) -> None:
    """Remove temporary datablocks that were saved with the file."""
    _remove([*_marked(), *(ob for ob in bpy.data.objects if _MARK in ob)])


HANDLERS = {"undo_post": _undone, "redo_post": _undone, "load_post": _loaded}
