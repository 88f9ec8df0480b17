"""Takes splats out of Blender bit by bit, so that no single step is long."""

import time
import uuid

import bpy
import numpy as np

from .. import attributes
from . import objects

BUDGET = 0.008
"""Seconds of a beat in which attributes are begun; the last one may take as long again."""
_MARK = "gs_leaving"


class Leaving:
    """The splats of an object as they are when this is made, whatever is done to it meanwhile.

    They are read from a copy of its mesh, or point cloud, which shares the memory of all that is
    not changed. The copy is looked up anew at each step: undo, or another file, may take it.
    """

    def __init__(self, ob: bpy.types.Object) -> None:
        """Take the copy.

        Raises:
            ValueError: attributes are missing, or as `objects.catch_up`.
        """
        objects.catch_up(ob)
        self._wanted = attributes.names(ob.data)
        self._columns: dict[str, np.ndarray] = {}
        self._mark = uuid.uuid4().hex
        self._is_cloud = ob.type == "POINTCLOUD"
        copy = ob.data.copy()
        copy[_MARK] = self._mark
        self._name, self._of = copy.name, ob.name

    def step(self) -> dict[str, np.ndarray] | None:
        """Read some more; what `attributes.as_splats` takes once it is complete.

        Raises:
            ValueError: the copy is gone, or holds numbers that are not finite.
        """
        mesh = self._mesh()
        if mesh is None:
            raise ValueError(f"{self._of} was taken away before its splats were read.")
        until = time.perf_counter() + BUDGET
        for name in self._wanted[len(self._columns) :]:
            self._columns[name] = attributes.column(mesh, name)
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
    def _all(self) -> bpy.types.bpy_prop_collection:
        return bpy.data.pointclouds if self._is_cloud else bpy.data.meshes

    def _mesh(self) -> bpy.types.Mesh | bpy.types.PointCloud | None:
        mesh = self._all.get(self._name)
        return mesh if mesh is not None and mesh.get(_MARK) == self._mark else None
