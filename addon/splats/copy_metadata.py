"""Metadata of a mesh, copied to its replacement: custom properties, materials, action, drivers."""

from contextlib import suppress

import bmesh
import bpy

from . import vertex_groups

_OURS = "gs_"
"""Prefix of custom properties that describe the points."""


def check_movable(mesh: bpy.types.Mesh, called: str) -> None:
    """Raise ValueError if a mesh has shape keys, which store positions of its current points.

    Args:
        mesh: Mesh whose points are to be replaced.
        called: Name of its object.
    """
    if mesh.shape_keys is not None:  # Edit Mode would apply their positions to other splats
        raise ValueError(
            f"{called} has shape keys, which store positions of its splats: remove them first, "
            "under Object Data > Shape Keys."
        )


def check_only_points(mesh: bpy.types.Mesh, called: str) -> None:
    """Like `check_movable`, for a changed number of points: edges and faces are errors too."""
    check_movable(mesh, called)
    if mesh.edges or mesh.polygons:
        raise ValueError(
            f"{called} has edges or faces, which are not splats and would be lost: delete them "
            "first, in Edit Mode under Mesh > Delete > Only Edges & Faces."
        )


def check_replaceable(mesh: bpy.types.Mesh, called: str) -> None:
    """Like `check_only_points`, for replacement by a new mesh, to which `copy_user_data` copies all
    but NLA tracks."""
    check_only_points(mesh, called)
    if mesh.animation_data is not None and mesh.animation_data.nla_tracks:
        raise ValueError(
            f"The mesh of {called} has NLA tracks, which would be lost: delete them first, in the "
            "Nonlinear Animation editor."
        )


def empty(mesh: bpy.types.Mesh) -> None:
    """Remove all points of a mesh, with their attributes and vertex groups.

    `Mesh.clear_geometry` would also remove action, drivers and NLA tracks.
    """
    nothing = bmesh.new()
    try:
        nothing.to_mesh(mesh)
    finally:
        nothing.free()
    vertex_groups.clear(mesh)


def copy_user_data(old: bpy.types.Mesh, mesh: bpy.types.Mesh) -> None:
    """Copy materials, custom properties and animation of a mesh to a new one."""
    for material in old.materials:
        mesh.materials.append(material)
    for name, value in old.items():
        if not name.startswith(_OURS):
            mesh[name] = value
            with suppress(TypeError):  # a type without limits and descriptions
                mesh.id_properties_ui(name).update_from(old.id_properties_ui(name))
    _copy_animation(old, mesh)


def _copy_animation(old: bpy.types.Mesh, mesh: bpy.types.Mesh) -> None:
    own = old.animation_data
    if own is None:
        return
    made = mesh.animation_data_create()
    made.action = own.action
    if own.action is not None and hasattr(own, "action_slot"):  # since Blender 4.4
        made.action_slot = own.action_slot
    for name in ("action_blend_type", "action_extrapolation", "action_influence", "use_nla"):
        setattr(made, name, getattr(own, name))
    for driver in own.drivers:
        made.drivers.from_existing(src_driver=driver)
