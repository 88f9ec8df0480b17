"""Datablock references that survive undo and file loads, and datablock names."""

from collections.abc import Iterable, Sequence
from typing import TypeVar

import bpy

BlockT = TypeVar("BlockT", bound=bpy.types.ID)


def with_uid(blocks: Iterable[BlockT], uid: int | None) -> BlockT | None:
    """The datablock of that session number among some; None: it is gone, or none is asked for."""
    return next((block for block in blocks if block.session_uid == uid), None)


def first_few(names: Sequence[str], most: int = 3) -> str:
    """Some names for a sentence, and how many there are more."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")
