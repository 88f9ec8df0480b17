"""Points of meshes deleted, as Edit Mode and other add-ons do it, for tests."""

import bpy
import numpy as np

from addon import attributes
from addon.splats import carried


def keep(mesh: bpy.types.Mesh, mask: np.ndarray) -> None:
    """Delete the points that are not in `mask` [N] bool; attributes follow."""
    kinds, rows = carried.kinds(mesh), np.flatnonzero(mask)
    tells, kept = attributes.tells_selection(mesh), {}
    for name, kind in kinds.items():
        values = carried.empty_values(kind, len(mesh.vertices))
        carried.copy_values(mesh, name, values)
        kept[name] = values[rows]
    mesh.clear_geometry()
    attributes.add_points(mesh, len(rows))
    for name, kind in kinds.items():
        attributes.declare(mesh, name, kind)
    for name, kind in kinds.items():
        attributes.fill(mesh, name, kind, kept[name].reshape(-1))
    if tells:
        attributes.leave_points_unselected(mesh)
