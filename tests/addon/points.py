"""Deletion of mesh points as in Edit Mode and other add-ons, for tests."""

import bpy
import numpy as np

from addon import attributes
from addon.splats import point_attributes


def keep(mesh: bpy.types.Mesh, mask: np.ndarray) -> None:
    """Delete the points that are not in `mask` [N] bool; attributes follow."""
    kinds, rows = point_attributes.kinds(mesh), np.flatnonzero(mask)
    tells, kept = attributes.has_selection(mesh), {}
    for name, kind in kinds.items():
        values = point_attributes.empty_values(kind, len(mesh.vertices))
        point_attributes.copy_values(mesh, name, values)
        kept[name] = values[rows]
    mesh.clear_geometry()
    attributes.add_points(mesh, len(rows))
    for name, kind in kinds.items():
        attributes.declare(mesh, name, kind)
    for name, kind in kinds.items():
        attributes.fill(mesh, name, kind, kept[name].reshape(-1))
    if tells:
        attributes.leave_points_unselected(mesh)
