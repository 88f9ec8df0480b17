"""Floor, rug, backdrop and lights."""

import bpy
import numpy as np
from mathutils import Vector

from . import textures
from .blender import add_image, add_mesh, material

RADIUS = 4.4
"""Radius of the round backdrop, metres."""


def build(rng):
    """Add the stage to the scene."""
    s = RADIUS + 0.1
    plane = np.array([(-s, -s, 0), (s, -s, 0), (s, s, 0), (-s, s, 0)])
    uv = (plane[None, :, :2] + s) / (2 * s)
    wood = add_image("parquet", textures.parquet(3072, 2 * s, rng))
    add_mesh(
        "floor",
        plane,
        [[0, 1, 2, 3]],
        material("floor", image=wood, in_mask=False, roughness=0.5),
        uv=uv,
    )
    add_rug(rng)
    add_backdrop(rng)
    add_lights()


def add_rug(rng, half=1.05, height=0.012):
    """Add a slightly uneven rug."""
    n = 96
    x, y = np.meshgrid(np.linspace(-half, half, n), np.linspace(-half, half, n), indexing="ij")
    edge = np.minimum(half - np.abs(x), half - np.abs(y))
    swell = textures.fractal((n, n), rng, 1.8) * 0.0015
    z = np.where(edge <= 0, 0.0, height + np.clip(edge * 2, 0, 1) * swell)
    i, j = np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij")
    faces = np.stack([i * n + j, (i + 1) * n + j, (i + 1) * n + j + 1, i * n + j + 1], -1).reshape(
        -1, 4
    )
    vertices = np.stack([x, y, z], -1).reshape(-1, 3)
    image = add_image("rug", textures.rug(2048, rng))
    wool = material("rug", image=image, in_mask=False, roughness=0.95, sheen_weight=0.2)
    item = add_mesh("rug", vertices, faces, wool, uv=(vertices[faces][..., :2] / half + 1) / 2)
    item.rotation_euler = (0, 0, 0.3)


def add_backdrop(rng, height=5.4, n=128):
    """Add a round wall of painted canvas."""
    turn = np.linspace(0, 2 * np.pi, n + 1)[:-1]
    ring = np.stack([RADIUS * np.cos(turn), RADIUS * np.sin(turn), 0 * turn], -1)
    vertices = np.concatenate([ring, ring + np.array([0, 0, height])])
    i = np.arange(n)
    j = (i + 1) % n
    faces = np.stack([j, i, i + n, j + n], -1)
    u = np.stack([i + 1, i, i, i + 1], -1) / n
    uv = np.stack([u, np.tile([0.0, 0, 1, 1], (n, 1))], -1)
    image = add_image("canvas", textures.canvas(512, 3072, rng))
    add_mesh(
        "backdrop",
        vertices,
        faces,
        material("backdrop", image=image, in_mask=False, roughness=0.9),
        uv=uv,
    )


def add_lights():
    """Add the world and four area lights."""
    world = bpy.data.worlds.new("world")
    bpy.context.scene.world = world
    if bpy.app.version < (5, 0):
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs[0].default_value = (0.35, 0.36, 0.38, 1)
    add_light("key", (-2.3, -2.6, 3.6), 1.6, 215, (1.0, 0.95, 0.88))
    add_light("fill", (2.9, -1.4, 3.2), 2.2, 90, (0.90, 0.95, 1.0))
    add_light("rim", (1.2, 3.0, 3.6), 1.4, 145, (1.0, 0.97, 0.93))
    add_light("top", (-0.8, 0.6, 4.4), 2.5, 105, (1.0, 1.0, 1.0))


def add_light(name, place, size, watts, color):
    """Add a square area light towards the figure, invisible to the camera."""
    data = bpy.data.lights.new(name, "AREA")
    data.energy, data.size, data.color = watts, size, color
    item = bpy.data.objects.new(name, data)
    item.visible_camera = False
    item.location = place
    aim = np.array([0, 0, 1.0]) - place
    item.rotation_mode = "QUATERNION"
    item.rotation_quaternion = Vector(aim).to_track_quat("-Z", "Y")
    bpy.context.scene.collection.objects.link(item)
