"""Snapshot of the splats of a depsgraph, copied out of Blender incrementally."""

from dataclasses import replace
from functools import partial

import bpy
import numpy as np

from ..process.incremental_tasks import Check, Pieces, run_in_thread
from ..splats.read_chunked import ChunkedRead
from .mesh_copies import Frozen, FrozenMesh
from .scene import NO_SPLATS, NONE_IN_VIEW, Placed, place, sources


def snapshot(depsgraph: bpy.types.Depsgraph) -> Pieces[list[Placed]]:
    """The splats of a depsgraph at the first step, unaffected by later changes.

    Raises:
        ValueError: there is nothing to draw, attributes are missing or not finite, or a copy was
            removed.
    """
    placed: list[Placed] = []
    frozen: dict[int, Frozen] = {}
    reads: dict[int, tuple[str, ChunkedRead]] = {}
    try:
        for source in sources(depsgraph):
            placed.append(place(source, FrozenMesh(source.ob.name, {}, {})))
            if source.moment is not None:
                frozen[source.uid] = source.frozen()
            elif source.uid not in reads:
                reads[source.uid] = source.ob.name, ChunkedRead(source.ob.original)
        if not placed:
            raise ValueError(NO_SPLATS if depsgraph.mode == "RENDER" else NONE_IN_VIEW)
        yield "Reading splats"
        for uid, (name, taken) in reads.items():
            columns = yield from taken.read()
            frozen[uid] = yield from run_in_thread(
                partial(_frozen, name, columns), "Reading splats"
            )
        return [replace(one, frozen=frozen[one.uid]) for one in placed]
    finally:
        for _, taken in reads.values():
            taken.drop()


def _frozen(name: str, columns: dict[str, np.ndarray], check: Check) -> FrozenMesh:
    return FrozenMesh.of(name, columns)
