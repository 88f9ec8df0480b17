"""Vertex groups of splats: their names and their weights by splat, in short steps.

Blender returns weights vertex by vertex, and sets them only through an object.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy
import numpy as np

BLOCK = 1 << 12
"""Splats per block, a few milliseconds each."""


def made(names: list[str], count: int) -> np.ndarray:
    """[G, N] float32 weights of groups, without members."""
    return np.full((len(names), count), np.nan, np.float32)


def read(mesh: bpy.types.Mesh, begin: int, weights: np.ndarray) -> None:
    """Read those of `BLOCK` vertices from one on into what `made` made; the mesh is not in Edit
    Mode.

    A mesh that shares its weights with another gets its own with the first vertex, in one call: of
    a million 0.05 to 0.12 s. `VertexGroup.weight` does without, but where a vertex is in no group
    it fails, which Blender 4.2 prints.
    """
    vertices = mesh.vertices
    found: list[float] = []
    # One by one: as many Python objects at once as a slice has would start garbage collection.
    for row in range(begin, min(begin + BLOCK, len(vertices))):
        for entry in vertices[row].groups:
            found += entry.group, row, entry.weight
    groups, rows, values = np.array(found, np.float64).reshape(-1, 3).T
    known = groups < len(weights)  # else Blender has forgotten that it was removed
    weights[groups[known].astype(int), rows[known].astype(int)] = values[known]


def write(mesh: bpy.types.Mesh, name: str, entries: np.ndarray) -> None:
    """Put splats, given as `carried.blocks` gives them, into a group, which is made where it is
    missing."""
    with _groups(mesh) as groups:
        if (group := groups.get(name)) is None:
            group = groups.new(name=name)
            group.name = name  # which Blender takes though an attribute is called so too
        ends = np.flatnonzero(np.diff(entries["weight"], append=np.nan)) + 1
        rows, weights, begin = entries["row"].tolist(), entries["weight"].tolist(), 0
        for end in ends.tolist():
            group.add(rows[begin:end], weights[begin], "REPLACE")
            begin = end


def clear(mesh: bpy.types.Mesh) -> None:
    """Remove all groups of a mesh."""
    with _groups(mesh) as groups:
        groups.clear()


@contextmanager
def settings_kept(ob: bpy.types.Object) -> Iterator[None]:
    """Have the active group and locks of an object outlast another mesh, with the same groups and
    others."""
    locked = {group.name for group in ob.vertex_groups if group.lock_weight}
    active = ob.vertex_groups.active_index
    yield
    for group in ob.vertex_groups:
        group.lock_weight = group.name in locked
    if ob.vertex_groups:
        ob.vertex_groups.active_index = max(active, 0)


@contextmanager
def _groups(mesh: bpy.types.Mesh) -> Iterator[bpy.types.VertexGroups]:
    """The groups of a mesh, through a temporary object."""
    ob = bpy.data.objects.new(mesh.name, mesh)
    try:
        yield ob.vertex_groups
    finally:
        bpy.data.objects.remove(ob)
