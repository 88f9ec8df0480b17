"""Chunked writing of splats to Blender in short steps, for any number of splats.

A new mesh without users is filled attribute by attribute over several steps, and then replaces the
old one in one change.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any, Generic

import bpy

from .. import attributes
from ..interface.temporary_data import Temporary
from ..process.incremental_tasks import BUDGET, Steps
from . import copy_metadata, objects, vertex_groups
from .mesh_buffers import ReadyT
from .point_attributes import GROUP, TEXT


class ChunkedWrite(Generic[ReadyT]):
    """A mesh being filled. If undo or a file load removes it, filling starts again."""

    def __init__(
        self,
        loaded: ReadyT,
        # Quoted: see mesh_buffers.py.
        make: "Callable[[], bpy.types.Mesh]" = lambda: bpy.data.meshes.new("splats"),
    ) -> None:
        """Start.

        Args:
            loaded: Source of the attributes.
            make: Creates the mesh; missing points are added.
        """
        self.loaded = loaded
        self._make = make
        self._temporary: Temporary | None = None
        self._next = 0

    def step(self) -> bpy.types.Mesh | None:
        """Fill one step; the mesh once it is complete, owned by the caller."""
        return self.take() if self.fill() else None

    @property
    def share(self) -> float:
        """Filled fraction, 0 to 1."""
        return self._next / max(len(self.loaded.columns), 1)

    def fill(self) -> bool:
        """Fill one step; True if the mesh is complete."""
        mesh = self._mesh()
        until = time.perf_counter() + BUDGET
        while self._next < len(self.loaded.columns):
            name, kind, values = self.loaded.columns[self._next]
            if kind == GROUP:
                vertex_groups.write(mesh, name, values)
            else:
                if name not in mesh.attributes:
                    attributes.declare(mesh, name, kind)
                    if time.perf_counter() > until:
                        return False
                if kind == TEXT:
                    data = mesh.attributes[name].data
                    for row, text in values.tolist():
                        data[row].value = text
                else:
                    attributes.fill(mesh, name, kind, values)
            self._next += 1
            if time.perf_counter() > until:
                return False
        return True

    def take(self) -> bpy.types.Mesh:
        """The complete mesh; ownership passes to the caller."""
        mesh = self._mesh()
        self._temporary.take()
        mesh.update()
        return mesh

    def drop(self) -> None:
        """Remove the partial mesh; no effect once the caller owns it."""
        if self._temporary is not None:
            self._temporary.drop()

    def _mesh(self) -> bpy.types.Mesh:
        mesh = None if self._temporary is None else self._temporary.found()
        if mesh is None:
            mesh = self._make()
            if missing := self.loaded.count - len(mesh.vertices):
                attributes.add_points(mesh, missing)
            self._temporary, self._next = Temporary(mesh), 0
        return mesh


# Quoted: see mesh_buffers.py.
def filled(
    fillings: "Sequence[ChunkedWrite[Any]]", check: Callable[[], object] = lambda: None
) -> Steps[list[bpy.types.Mesh]]:
    """Filled meshes, owned by the caller; none is left after an error.

    Args:
        fillings: The writes, all complete right before this returns.
        check: Called at that moment; may raise.
    """
    count = sum(filling.loaded.count for filling in fillings)
    try:
        while not all(filling.fill() for filling in fillings):
            share = sum(filling.share for filling in fillings) / len(fillings)
            yield f"Writing {count:,} splats to Blender: {share:.0%}"
        check()
        return [filling.take() for filling in fillings]
    finally:
        for filling in fillings:
            filling.drop()


def replace(ob: bpy.types.Object, mesh: bpy.types.Mesh) -> None:
    """Replace an object's mesh by a new one for all objects that share it; its metadata stays.

    Raises:
        ValueError: the object's mesh is being edited, is linked, or has data that would be lost.
    """
    check_replaceable(ob)
    copy_metadata.copy_user_data(ob.data, mesh)
    swap(ob, mesh)


def check_replaceable(ob: bpy.types.Object) -> None:
    """Raise ValueError unless an object's mesh can be replaced now without losing other data than
    its points."""
    objects.check_writable(ob)
    copy_metadata.check_replaceable(ob.data, ob.name)


def swap(ob: bpy.types.Object, mesh: bpy.types.Mesh) -> None:
    """Replace an object's mesh for all objects that share it, and remove the old one.

    Name, asset mark, active attributes, and active and locked vertex groups stay.
    """
    old = ob.data
    name = old.name
    if old.asset_data is not None:  # the same asset, with catalog, tags and texts
        mesh.asset_mark()
        mesh.asset_data = old.asset_data
    mesh.use_fake_user = old.use_fake_user
    attributes.copy_active(mesh, old)
    with vertex_groups.settings_kept(ob):
        old.user_remap(mesh)
    bpy.data.meshes.remove(old)
    mesh.name = name
