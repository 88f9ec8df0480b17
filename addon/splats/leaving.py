"""Takes splats out of Blender bit by bit, so that no single step is long."""

import math
import time
import uuid

import bpy
import numpy as np

from .. import attributes
from ..process.memory import Memory
from . import objects

BUDGET = 0.008
"""Seconds of a beat in which attributes are begun; the last one may take as long again."""
AHEAD = 1 << 21
"""Numbers, 8 MB, whose memory takes the main thread too long to get."""
_MARK = "gs_leaving"


class Leaving:
    """The splats of an object as they are when this is made, whatever is done to it meanwhile.

    They are read from a copy of its mesh, or point cloud, which shares the memory of all that is
    not changed. The copy is looked up anew at each step: undo, or another file, may take it.
    """

    def __init__(self, ob: bpy.types.Object, *, at_once: bool = False) -> None:
        """Take the copy.

        Args:
            ob: With splats of its own, in any mode.
            at_once: Nobody sees to other things meanwhile: the first step reads everything.

        Raises:
            ValueError: attributes are missing, or as `objects.catch_up`.
        """
        objects.catch_up(ob)
        self._columns: dict[str, np.ndarray] = {}
        self._mark = uuid.uuid4().hex
        self._is_cloud = ob.type == "POINTCLOUD"
        if ob.mode == "EDIT":
            ob.update_from_editmode()
        copy = ob.data.copy()
        copy[_MARK] = self._mark
        self._name, self._of, self._data = copy.name, ob.name, ob.data.name
        self._budget = math.inf if at_once else BUDGET
        try:  # of the copy: in Edit Mode attributes are out of reach
            self._wanted = attributes.names(copy, called=self._data)
            sizes = [attributes.floats(copy, name, called=self._data) for name in self._wanted]
        except ValueError:
            self.drop()
            raise
        self._memory = Memory(sizes) if sum(sizes) >= AHEAD and not at_once else None

    def step(self) -> dict[str, np.ndarray] | None:
        """Read some more; what `attributes.as_splats` takes once it is complete.

        Raises:
            ValueError: the copy is gone, or holds numbers that are not finite.
        """
        mesh = self._mesh()
        if mesh is None:
            raise ValueError(f"{self._of} was taken away before its splats were read.")
        until = time.perf_counter() + self._budget
        for name in self._wanted[len(self._columns) :]:
            if self._memory is not None and not self._memory.ready:
                break
            memory = None if self._memory is None else self._memory.take()
            self._columns[name] = attributes.column(mesh, name, called=self._data, memory=memory)
            if time.perf_counter() > until:
                break
        if len(self._columns) < len(self._wanted):
            return None
        self.drop()
        return self._columns

    def drop(self) -> None:
        """Remove the copy."""
        mesh = self._mesh()
        if mesh is not None:
            self._all.remove(mesh)

    @property
    def share(self) -> float:
        """How much of it is read, 0 to 1."""
        return len(self._columns) / len(self._wanted)

    @property
    def _all(self) -> bpy.types.bpy_prop_collection:
        return bpy.data.pointclouds if self._is_cloud else bpy.data.meshes

    def _mesh(self) -> bpy.types.Mesh | bpy.types.PointCloud | None:
        mesh = self._all.get(self._name)
        return mesh if mesh is not None and mesh.get(_MARK) == self._mark else None
