"""Meshes and worlds of one color, for the tests of composites."""

import bpy

from addon import compat


def emitter(name: str, color: tuple[float, float, float]) -> bpy.types.Material:
    """A material of one scene-linear colour."""
    material = bpy.data.materials.new(name)
    compat.use_nodes(material)
    tree = material.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeEmission")
    shader.inputs["Color"].default_value = (*color, 1)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def plane(scene, z: float, color, left: float, right: float, name: str) -> bpy.types.Object:
    """A rectangle across the z axis, from x = left to right."""
    mesh = bpy.data.meshes.new(name)
    corners = [(left, -0.6, z), (right, -0.6, z), (right, 0.6, z), (left, 0.6, z)]
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    mesh.materials.append(emitter(name, color))
    ob = bpy.data.objects.new(name, mesh)
    scene.collection.objects.link(ob)
    return ob


def glass(scene, z: float, color, alpha: float) -> bpy.types.Object:
    """A plane that fills the picture, transparent by its alpha."""
    ob = plane(scene, z, color, -9.0, 9.0, "glass")
    ob.scale.y = 20.0
    tree = ob.data.materials[0].node_tree
    shader = next(n for n in tree.nodes if n.type == "EMISSION")
    mix, clear = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("MixShader", "BsdfTransparent"))
    mix.inputs[0].default_value = alpha
    tree.links.new(clear.outputs[0], mix.inputs[1])
    tree.links.new(shader.outputs[0], mix.inputs[2])
    output = next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL")
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    return ob


def paint_world(scene: bpy.types.Scene, *color: float) -> None:
    """A world of one color behind the meshes."""
    if scene.world is None:
        scene.world = bpy.data.worlds.new("World")
    if compat.world_nodes(scene.world) is None:
        scene.world.use_nodes = True
    node = next(n for n in scene.world.node_tree.nodes if n.type == "BACKGROUND")
    node.inputs[0].default_value = (*color, 1)
    scene.render.film_transparent = False
