"""Metadata of a mesh besides its points, copied to its replacement: custom properties, materials,
action, drivers and the asset mark.
"""

import bmesh
import bpy

from . import vertex_groups

_OURS = "gs_"
"""Prefix of custom properties that describe the points."""


def check_movable(mesh: bpy.types.Mesh, called: str) -> None:
    """Raise ValueError where a mesh has what would give other points the places of its own.

    Args:
        mesh: Whose points are to become others.
        called: The name of its object.
    """
    if mesh.shape_keys is not None:  # Edit Mode would give their places to other splats
        raise ValueError(
            f"{called} has shape keys, which know its splats as they are: remove them first, under "
            "Object Data > Shape Keys."
        )


def check_points_alone(mesh: bpy.types.Mesh, called: str) -> None:
    """The same where the number of points changes: ValueError where it has more than points."""
    check_movable(mesh, called)
    if mesh.edges or mesh.polygons:
        raise ValueError(
            f"{called} has edges or faces, which are no splats and would be lost: delete them "
            "first, in Edit Mode under Mesh > Delete > Only Edges & Faces."
        )


def check_replaceable(mesh: bpy.types.Mesh, called: str) -> None:
    """The same where another mesh, made from nothing, takes its place: `hand_over` gives that all
    but NLA tracks."""
    check_points_alone(mesh, called)
    if mesh.animation_data is not None and mesh.animation_data.nla_tracks:
        raise ValueError(
            f"The mesh of {called} has NLA tracks, which would be lost: delete them first, in the "
            "Nonlinear Animation editor."
        )


def empty(mesh: bpy.types.Mesh) -> None:
    """Take all points of a mesh away, with their attributes and vertex groups, and nothing else.

    `Mesh.clear_geometry` would take action, drivers and NLA tracks too.
    """
    nothing = bmesh.new()
    try:
        nothing.to_mesh(mesh)
    finally:
        nothing.free()
    vertex_groups.clear(mesh)


def hand_over(old: bpy.types.Mesh, mesh: bpy.types.Mesh) -> None:
    """Give a mesh that was made from nothing what another one has, but for its mark as an asset."""
    for material in old.materials:
        mesh.materials.append(material)
    for name, value in old.items():
        if not name.startswith(_OURS):
            _give_property(old, mesh, name, value)
    _animate_alike(old, mesh)


def copy_asset_mark(old: bpy.types.Mesh, mesh: bpy.types.Mesh) -> None:
    """Mark a mesh as the same asset as another, with catalog, tags and texts."""
    if old.asset_data is not None:
        mesh.asset_mark()
        mesh.asset_data = old.asset_data


def _give_property(old: bpy.types.Mesh, mesh: bpy.types.Mesh, name: str, value: object) -> None:
    mesh[name] = value
    try:
        mesh.id_properties_ui(name).update_from(old.id_properties_ui(name))
    except TypeError:  # of a kind without limits and descriptions
        return


def _animate_alike(old: bpy.types.Mesh, mesh: bpy.types.Mesh) -> None:
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
