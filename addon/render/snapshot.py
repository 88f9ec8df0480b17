"""Snapshot of the splats of a depsgraph, copied out of Blender incrementally."""

from dataclasses import replace
from functools import partial

import bpy
import numpy as np

from ..process.incremental_tasks import Check, Pieces, run_in_thread
from ..splats.read_chunked import ChunkedRead
from .mesh_copies import Frozen, FrozenMesh
from .scene import NO_SPLATS, NONE_IN_VIEW, Placed, place, sources


class Snapshot:
    """Splats at the time of construction, unaffected by later changes."""

    def __init__(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Take the snapshot.

        Raises:
            ValueError: there is nothing to draw, or attributes are missing.
        """
        self._placed: list[Placed] = []
        self._frozen: dict[int, Frozen] = {}
        self._reads: dict[int, tuple[str, ChunkedRead]] = {}
        try:
            for source in sources(depsgraph):
                self._placed.append(place(source, FrozenMesh(source.ob.name, 0)))
                if source.uid in self._frozen or source.uid in self._reads:
                    continue
                if source.moment is not None:
                    self._frozen[source.uid] = source.frozen()
                else:
                    taken = ChunkedRead(source.ob.original)
                    self._reads[source.uid] = (source.ob.name, taken)
        except ValueError:
            self.drop()
            raise
        if not self._placed:
            raise ValueError(NO_SPLATS if depsgraph.mode == "RENDER" else NONE_IN_VIEW)

    def read(self) -> Pieces[list[Placed]]:
        """Copy the splats; errors as `ChunkedRead.read`."""
        for uid, (name, taken) in self._reads.items():
            columns = yield from taken.read()
            self._frozen[uid] = yield from run_in_thread(
                partial(_frozen, name, columns), "Reading splats"
            )
        return [replace(one, frozen=self._frozen[one.uid]) for one in self._placed]

    def drop(self) -> None:
        """Remove the temporary copies of meshes."""
        for _, taken in self._reads.values():
            taken.drop()


def _frozen(name: str, columns: dict[str, np.ndarray], check: Check) -> FrozenMesh:
    return FrozenMesh.of(name, columns)
