"""Blender's cloth solver as one function: it drapes a mesh over colliders."""

import bpy
import numpy as np

from .blender import add_mesh, evaluated_vertices


def drape(vertices, faces, pinned, colliders, *, frames, mass, bending, growth=0.0, tension=15.0):
    """Simulate falling cloth.

    Args:
        vertices: [V, 3] start positions, also the rest shape; outside all colliders.
        faces: [F, 4].
        pinned: [V] weights in [0, 1]; 1 is fixed.
        colliders: objects that the cloth collides with.
        frames: number of steps of 1/24 s.
        mass: kilograms of one vertex.
        bending: stiffness; silk 0.05, wool 0.5, leather 15.
        growth: relative increase in length of the threads, which produces folds.
        tension: stiffness along the threads.

    Returns:
        [V, 3] float64 positions of the draped mesh.
    """
    scene = bpy.context.scene
    item = add_mesh("cloth", vertices, faces)
    group = item.vertex_groups.new(name="pin")
    for weight in np.unique(pinned[pinned > 0]):
        group.add(np.flatnonzero(pinned == weight).tolist(), float(weight), "REPLACE")
    added = []
    for collider in colliders:
        modifier = collider.modifiers.new("Collision", "COLLISION")
        collider.collision.thickness_outer = 0.004
        collider.collision.thickness_inner = 0.02
        collider.collision.cloth_friction = 12.0
        added.append((collider, modifier))
    modifier = item.modifiers.new("Cloth", "CLOTH")
    cloth, collision = modifier.settings, modifier.collision_settings
    cloth.quality = 7
    cloth.mass = mass
    cloth.air_damping = 1.0
    cloth.tension_stiffness = cloth.compression_stiffness = tension
    cloth.shear_stiffness = tension / 3
    cloth.bending_stiffness = bending
    cloth.vertex_group_mass = "pin"
    cloth.shrink_min = -growth
    collision.distance_min = 0.004
    collision.collision_quality = 3
    collision.use_self_collision = True
    collision.self_distance_min = 0.003
    scene.frame_start, scene.frame_end = 1, frames
    modifier.point_cache.frame_start, modifier.point_cache.frame_end = 1, frames
    for frame in range(1, frames + 1):
        scene.frame_set(frame)
    result = evaluated_vertices(item)
    scene.frame_set(1)
    bpy.data.objects.remove(item)
    for collider, modifier in added:
        collider.modifiers.remove(modifier)
    return result
