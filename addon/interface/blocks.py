"""Datablock references that survive undo and file loads, and datablock names."""

from collections.abc import Iterable, Sequence
from typing import TypeVar

import bpy

BlockT = TypeVar("BlockT", bound=bpy.types.ID)


def with_uid(blocks: Iterable[BlockT], uid: int | None) -> BlockT | None:
    """The datablock with a session uid; None if it was removed or `uid` is None."""
    return next((block for block in blocks if block.session_uid == uid), None)


def block_of(blocks: Iterable[BlockT], uid: int, gone: str) -> BlockT:
    """The datablock with a session uid; ValueError with the sentence `gone` if it was removed."""
    block = with_uid(blocks, uid)
    if block is None:
        raise ValueError(gone)
    return block


def first_few(names: Sequence[str], most: int = 3) -> str:
    """The first names, joined for a sentence, and the number of further ones."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")
