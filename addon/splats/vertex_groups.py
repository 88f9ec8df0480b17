"""Vertex groups of splats: names and weights by splat, in short steps.

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
    """Read weights of `BLOCK` vertices from an index on into an array of `made`; not in Edit Mode.

    Access to the first vertex copies shared weights in one call: 0.05 to 0.12 s for a million.
    `VertexGroup.weight` avoids that, but raises for vertices outside the group, which Blender 4.2
    prints.
    """
    vertices = mesh.vertices
    entries: list[float] = []
    # One by one, because the Python objects of a slice would trigger garbage collection.
    for row in range(begin, min(begin + BLOCK, len(vertices))):
        for entry in vertices[row].groups:
            entries += entry.group, row, entry.weight
    groups, rows, values = np.array(entries, np.float64).reshape(-1, 3).T
    known = groups < len(weights)  # Blender may keep indices of removed groups
    weights[groups[known].astype(int), rows[known].astype(int)] = values[known]


def write(mesh: bpy.types.Mesh, name: str, entries: np.ndarray) -> None:
    """Add splats to a group, created if missing, from entries of `point_attributes.blocks`."""
    with _groups(mesh) as groups:
        if (group := groups.get(name)) is None:
            group = groups.new(name=name)
            group.name = name  # accepted even if an attribute has this name
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
    """Keep the active group and the locks of an object when its mesh is replaced within."""
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
