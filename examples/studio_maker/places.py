"""Four places: a yard with trees and sky, a room with windows and lamps, a village from above, a
showroom of things that shine."""

from dataclasses import dataclass

import bpy
import numpy as np

from . import textures
from .blender import add_image, add_mesh, material
from .cameras import look_at


@dataclass(frozen=True)
class Place:
    """Cameras of a place; its objects are in the scene."""

    viewmats: np.ndarray
    """[C, 4, 4] float64, world to camera, OpenCV axes, metres; in the order of the walk."""
    focal: float
    """Focal length, as a share of the width of the picture."""


def yard(views, light, rng):
    """A house among trees and hedges, photographed by somebody who walks around it."""
    _ground(24, _mottled(1024, rng, ((0.16, 0.25, 0.08), (0.35, 0.42, 0.16), (0.45, 0.38, 0.26))))
    _house((0, 0), (5, 3.6, 3.2), rng)
    for turn in np.linspace(0, 2 * np.pi, 10)[:-1]:
        r = rng.uniform(11, 17)
        _tree((r * np.cos(turn), r * np.sin(turn)), rng.uniform(4, 7), rng)
    for at in ((-4.5, -3.4), (3.6, 3.6), (4.6, -2.6)):
        _tree(at, rng.uniform(2.2, 3.2), rng)
    _leaves("hedge", rng.uniform((-4, -4.6, 0), (1.5, -4.0, 1.1), (5000, 3)), 0.09, rng)
    _sky(light, sun={"a": (0.9, 0.5), "b": (0.35, 3.4)}[light])
    turn = np.linspace(0, 2 * np.pi, views, endpoint=False)
    r = 8.2 + 0.5 * np.sin(3 * turn)
    eyes = np.stack([r * np.cos(turn), r * np.sin(turn), 1.6 + rng.normal(0, 0.05, views)], -1)
    aims = np.stack([0.8 * np.cos(turn + 1), 0.8 * np.sin(turn + 1), np.full(views, 1.7)], -1)
    return Place(_looks(eyes, aims, rng), 0.8)


def room(views, light, rng):
    """A room with white walls, two windows and two lamps, photographed from the inside."""
    x, y, z = 2.8, 2.2, 2.6
    white = material("wall", color=(0.82, 0.81, 0.79), in_mask=False, roughness=0.9)
    _box("ceiling", (0, 0, z + 0.05), (2 * x, 2 * y, 0.1), white)
    for side in (-1, 1):
        _box("wall", (side * (x + 0.05), 0, z / 2), (0.1, 2 * y, z), white)
    _box("wall", (0, -y - 0.05, z / 2), (2 * x, 0.1, z), white)
    for low, high in ((-x, -1.9), (-0.7, 0.7), (1.9, x)):
        _box("pier", ((low + high) / 2, y + 0.05, z / 2), (high - low, 0.1, z), white)
        if high < x:
            for bottom, top in ((0, 0.9), (2.2, z)):
                at = (high + 0.6, y + 0.05, (bottom + top) / 2)
                _box("sill", at, (1.2, 0.1, top - bottom), white)
    _picture("floor", (0, 0, 0), (2 * x, 2 * y), textures.parquet(1536, 2 * x, rng))
    _picture("rug", (0, -0.2, 0.01), (2.2, 1.6), textures.rug(1024, rng))
    sofa = _textured("sofa", textures.blossoms(768, rng, 500))
    _box("seat", (-1.9, -0.3, 0.25), (0.9, 2.0, 0.5), sofa)
    _box("back", (-2.5, -0.3, 0.5), (0.3, 2.0, 1.0), sofa)
    oak = _textured("oak", textures.parquet(512, 1.5, rng))
    _box("table", (0, -0.2, 0.42), (1.0, 0.7, 0.05), oak)
    for i in (-1, 1):
        for j in (-1, 1):
            _box("leg", (i * 0.44, -0.2 + j * 0.29, 0.2), (0.05, 0.05, 0.4), oak)
    _box("shelf", (2.55, 0.4, 0.9), (0.3, 1.8, 1.8), oak)
    for i in range(40):
        tint = tuple(rng.uniform(0.05, 0.7, 3))
        book = material("book", color=tint, in_mask=False, roughness=0.6)
        at = (2.38, -0.42 + 0.042 * i, 0.5 + 0.55 * (i % 3))
        _box("book", at, (0.2, 0.036, rng.uniform(0.2, 0.32)), book)
    for at in ((-1.0, -1.9, 1.5), (1.6, -1.6, 1.9)):
        lamp = bpy.data.materials.new("lamp")
        _emission(lamp, (1.0, 0.75, 0.5), {"a": 25.0, "b": 80.0}[light])
        bpy.ops.mesh.primitive_uv_sphere_add(radius=0.12, location=at)
        bpy.context.object.data.materials.append(lamp)
    _sky(light, sun={"a": (0.6, 1.2), "b": (0.1, 4.0)}[light], strength={"a": 3.0, "b": 0.3}[light])
    turn = np.linspace(0, 2 * np.pi, views, endpoint=False)
    eyes = np.stack([1.5 * np.cos(turn), 1.1 * np.sin(turn), 1.4 + 0.25 * np.sin(5 * turn)], -1)
    away = turn + np.pi + 0.9 * np.sin(2 * turn)
    aims = eyes + np.stack([np.cos(away), np.sin(away), -0.15 + 0.1 * np.cos(3 * turn)], -1)
    return Place(_looks(eyes, aims, rng), 0.7)


def village(views, light, rng):
    """Houses and trees, photographed straight down by a drone on a grid."""
    _ground(60, _mottled(2048, rng, ((0.2, 0.3, 0.12), (0.42, 0.45, 0.22), (0.5, 0.44, 0.33))))
    for i in range(5):
        for j in range(4):
            at = np.array([-20 + 10 * i, -15 + 10 * j]) + rng.uniform(-2, 2, 2)
            _house(at, rng.uniform((4, 3, 2.5), (6, 5, 4)), rng)
            _tree(at + rng.uniform(3.5, 5, 2), rng.uniform(3, 6), rng)
    _sky(light, sun={"a": (0.8, 0.6), "b": (0.5, 2.8)}[light])
    columns = int(np.ceil(np.sqrt(views * 1.4)))
    rows = int(np.ceil(views / columns))
    grid = [(i, j if i % 2 else rows - 1 - j) for i in range(columns) for j in range(rows)]
    share = np.array(grid[:views]) / (max(columns - 1, 1), max(rows - 1, 1)) * 2 - 1
    eyes = np.concatenate([share * (22, 16), np.full((views, 1), 22.0)], 1)
    aims = eyes + np.array([0.0, 2.0, -22.0]) + rng.normal(0, 0.4, (views, 3))
    return Place(_looks(eyes, aims, rng), 0.8)


def showroom(views, light, rng):
    """Glossy and metal things on a polished floor, photographed from around them."""
    floor = _mottled(1024, rng, ((0.3, 0.12, 0.08), (0.7, 0.62, 0.5), (0.12, 0.2, 0.3)))
    _picture("floor", (0, 0, 0), (8, 8), floor, roughness=0.15)
    red = material("lacquer", color=(0.6, 0.1, 0.1), in_mask=False, roughness=0.12)
    brass = material("brass", color=(0.8, 0.6, 0.2), in_mask=False, roughness=0.25, metallic=0.9)
    glazed = _textured("glazed", textures.blossoms(512, rng, 300), roughness=0.2)
    polished = _textured("polished", textures.parquet(512, 1.5, rng), roughness=0.08)
    for at, radius, surface in (((-0.9, 0), 0.6, red), ((0.7, 0.6), 0.5, glazed)):
        bpy.ops.mesh.primitive_uv_sphere_add(radius=radius, location=(*at, radius), segments=64)
        _shiny(surface)
    bpy.ops.mesh.primitive_monkey_add(size=1, location=(0.5, -0.7, 0.55))
    _shiny(brass)
    _box("cabinet", (-0.4, 1.2, 0.4), (0.8, 0.8, 0.8), polished)
    _sky(light, sun={"a": (0.7, 0.8), "b": (0.4, 3.6)}[light], strength=0.5)
    for at, size, watts in (((3, -2, 4), 1, 300), ((-3, 2, 3.5), 0.7, 200), ((0, 4, 3), 1.5, 150)):
        data = bpy.data.lights.new("lamp", "AREA")
        data.size, data.energy = size, watts
        lamp = bpy.data.objects.new("lamp", data)
        lamp.location = at
        lamp.rotation_euler = (-lamp.location).to_track_quat("-Z", "Y").to_euler()
        lamp.visible_camera = False
        bpy.context.scene.collection.objects.link(lamp)
    turn = np.linspace(0, 6 * np.pi, views, endpoint=False)
    r = 3.5 + 0.3 * np.sin(turn / 2)
    eyes = np.stack([r * np.cos(turn), r * np.sin(turn), np.linspace(0.9, 2.7, views)], -1)
    return Place(_looks(eyes, np.tile((0.0, 0.0, 0.4), (views, 1)), rng), 1.07)


PLACES = {"yard": yard, "room": room, "village": village, "showroom": showroom}


def _shiny(surface):
    bpy.context.object.data.materials.append(surface)
    bpy.ops.object.shade_smooth()


def _looks(eyes, aims, rng):
    pairs = zip(eyes, aims + rng.normal(0, 0.02, aims.shape), strict=True)
    return np.stack([look_at(eye, aim, roll=rng.normal(0, 0.01)) for eye, aim in pairs])


def _mottled(n, rng, colors):
    t = np.clip(0.5 + 0.25 * textures.fractal((n, n), rng, 1.1), 0, 1)
    return np.clip(textures.mix(colors, t) + rng.normal(0, 0.03, (n, n, 1)), 0, 1)


def _textured(name, pixels, roughness=0.8):
    return material(name, image=add_image(name, pixels), in_mask=False, roughness=roughness)


def _picture(name, at, size, pixels, roughness=0.8):
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2
    vertices = np.concatenate([corners * size, np.zeros((4, 1))], 1) + at
    surface = _textured(name, pixels, roughness)
    add_mesh(name, vertices, [[0, 1, 2, 3]], surface, uv=corners[None] + 0.5)


def _ground(half, pixels):
    _picture("ground", (0, 0, 0), (2 * half, 2 * half), pixels)


def _box(name, at, size, surface):
    unit = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float) - 0.5
    faces = np.array(
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [3, 2, 6, 7], [2, 0, 4, 6], [1, 3, 7, 5]]
    )
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)
    add_mesh(name, unit * size + at, faces, surface, uv=np.tile(corners, (6, 1, 1)), smooth=False)


def _house(at, size, rng):
    """A box of bricks with windows, under a gable roof."""
    w, d, h = size
    n = 768
    wall = _mottled(n, rng, ((0.5, 0.3, 0.22), (0.66, 0.46, 0.34)))
    row, column = np.mgrid[:n, :n]
    wall[(row % 24 < 2) | ((column + 24 * (row // 24 % 2)) % 48 < 2)] = 0.7
    for x in range(n // 6, n, n // 3):
        wall[n // 3 : 2 * n // 3, x - 50 : x + 50] = (0.9, 0.9, 0.88)
        wall[n // 3 + 14 : 2 * n // 3 - 14, x - 40 : x + 40] = (0.12, 0.15, 0.2)
    _box("house", (*at, h / 2), (w, d, h), _textured("bricks", wall))
    x, y, top = w / 2 + 0.2, d / 2 + 0.2, h + 0.35 * d
    ridge = [(-x, -y, h), (x, -y, h), (x, y, h), (-x, y, h), (-x, 0, top), (x, 0, top)]
    tiles = _mottled(512, rng, ((0.28, 0.12, 0.09), (0.5, 0.24, 0.17)))
    tiles[np.arange(512) % 20 < 3] *= 0.6
    faces = np.array([[0, 1, 5, 4], [2, 3, 4, 5], [1, 2, 5, 5], [3, 0, 4, 4]])
    uv = np.tile(np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float), (4, 1, 1))
    for quad, corners in zip(faces, uv, strict=True):
        corner = dict.fromkeys(quad.tolist())  # gables are triangles
        vertices = np.array(ridge, float)[list(corner)] + (*at, 0)
        order = np.arange(len(corner))[None]
        roof = _textured("roof", tiles)
        add_mesh("roof", vertices, order, roof, uv=corners[None, : len(corner)], smooth=False)


def _tree(at, height, rng):
    bark = material("bark", color=(0.12, 0.08, 0.05), in_mask=False, roughness=0.9)
    _box("trunk", (*at, height / 4), (0.06 * height, 0.06 * height, height / 2), bark)
    ball = rng.normal(0, 1, (4000, 3))
    ball *= rng.uniform(0.55, 1, (4000, 1)) / np.linalg.norm(ball, axis=1, keepdims=True)
    bumps = 1 + 0.25 * np.sin(ball * 6).prod(1, keepdims=True)
    center, radii = np.array((*at, 0.68)), np.array([0.3, 0.3, 0.33])
    center[2] *= height
    _leaves("crown", center + ball * bumps * height * radii, 0.03 * height, rng)


def _leaves(name, centers, size, rng):
    """Square leaves in random directions, in greens of random brightness."""
    count = len(centers)
    a, b = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(0, 1, (2, count, 3)))
    b = np.cross(a, b)
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * size / 2
    vertices = centers[:, None] + signs[None, :, :1] * a[:, None] + signs[None, :, 1:] * b[:, None]
    green = np.array([0.10, 0.22, 0.04]) * rng.uniform(0.4, 1.8, (count, 1))
    green[:, 0] *= rng.uniform(0.7, 1.6, count)
    leaf = material("leaf", tint=True, in_mask=False, roughness=0.7)
    faces = np.arange(4 * count).reshape(-1, 4)
    add_mesh(name, vertices.reshape(-1, 3), faces, leaf, tint=np.repeat(green, 4, 0), smooth=False)


def _emission(surface, color, strength):
    if bpy.app.version < (5, 0):
        surface.use_nodes = True
    tree = surface.node_tree
    tree.nodes.clear()
    glow = tree.nodes.new("ShaderNodeEmission")
    glow.inputs["Color"].default_value = (*color, 1)
    glow.inputs["Strength"].default_value = strength
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(glow.outputs[0], output.inputs["Surface"])


def _sky(light, sun, strength=1.0):
    """Clouds on a blue gradient, and a sun at (height, azimuth) in radians."""
    world = bpy.data.worlds.new("sky")
    bpy.context.scene.world = world
    if bpy.app.version < (5, 0):
        world.use_nodes = True
    tree = world.node_tree
    new, link = tree.nodes.new, tree.links.new
    place, noise = new("ShaderNodeTexCoord"), new("ShaderNodeTexNoise")
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 3.0, 6.0
    link(place.outputs["Generated"], noise.inputs["Vector"])
    ramp = new("ShaderNodeValToRGB")
    ramp.color_ramp.elements[0].position, ramp.color_ramp.elements[1].position = 0.42, 0.68
    warm = light == "b"
    ramp.color_ramp.elements[0].color = (0.55, 0.35, 0.28, 1) if warm else (0.22, 0.42, 0.8, 1)
    ramp.color_ramp.elements[1].color = (0.8, 0.6, 0.5, 1) if warm else (0.9, 0.9, 0.92, 1)
    link(noise.outputs[0], ramp.inputs[0])
    background = tree.nodes["Background"]
    link(ramp.outputs[0], background.inputs["Color"])
    background.inputs["Strength"].default_value = strength * (0.5 if warm else 1.0)
    data = bpy.data.lights.new("sun", "SUN")
    data.energy, data.angle = (1.5 if warm else 3.0), 0.02
    data.color = (1.0, 0.7, 0.45) if warm else (1.0, 0.96, 0.9)
    item = bpy.data.objects.new("sun", data)
    item.rotation_euler = (np.pi / 2 - sun[0], 0, sun[1])
    bpy.context.scene.collection.objects.link(item)
