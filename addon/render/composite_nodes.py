"""Compositor nodes that combine splats and meshes by depth, over the world."""

import bpy

from .. import compat
from .composite_group import group, is_current
from .pass_renderer import HOLDOUT_PASSES

LAYER_NODE, COMBINE_NODE, WORLD_NODE = "GS Splats", "GS Combine by Depth", "GS World"
"""Names of the nodes in the scene's tree."""


def combine_node(scene: bpy.types.Scene) -> bpy.types.Node | None:
    """The node that combines a scene's splats with its meshes, if it was set up."""
    tree = compat.compositor_tree(scene)
    return None if tree is None else tree.nodes.get(COMBINE_NODE)


def is_older(scene: bpy.types.Scene) -> bool:
    """Whether that node comes from an earlier version, whose formula handles less."""
    node = combine_node(scene)
    return node is not None and not _is_renewed(node)


def insert(
    tree: bpy.types.NodeTree,
    scene: bpy.types.Scene,
    splats: bpy.types.Scene,
    world: bpy.types.Scene | None,
) -> None:
    """Insert the nodes after the scene's render layers, or update them.

    Args:
        tree: The scene's.
        scene: Renders the meshes.
        splats: Renders the splats.
        world: Renders the world; None: no world.
    """
    layers, combine = tree.nodes.get(LAYER_NODE), tree.nodes.get(COMBINE_NODE)
    if layers is not None and combine is not None:
        layers.scene = splats
        _renew(tree, combine, layers)
    else:
        combine = _combine(tree, scene, splats)
    _show_world(tree, combine, world)


def _is_renewed(combine: bpy.types.Node) -> bool:
    return combine.node_tree is not None and is_current(combine.node_tree)


def _renew(tree: bpy.types.NodeTree, combine: bpy.types.Node, layers: bpy.types.Node) -> None:
    """Give the node the current group; those of older files have no inputs for world and holdouts,
    or show the background in the holes of meshes."""
    if _is_renewed(combine):
        return
    # Blender drops links to the output, because the new group has another socket.
    targets = [link.to_socket for link in combine.outputs[0].links]
    combine.node_tree = group()
    for target in targets:
        tree.links.new(combine.outputs[0], target)
    _link_holdouts(tree, layers, combine)


def _link_holdouts(
    tree: bpy.types.NodeTree, layers: bpy.types.Node, combine: bpy.types.Node
) -> None:
    """Link the holdout passes of the splats' render layers to the node."""
    for name in HOLDOUT_PASSES:
        tree.links.new(layers.outputs[name], combine.inputs[name])


def show_passes(scene: bpy.types.Scene, splats: bpy.types.Scene) -> None:
    """Add sockets for newly enabled passes to the node of the splats' render: Blender 4.2 adds them
    only to nodes of the rendered scene."""
    tree = compat.compositor_tree(scene)
    node = None if tree is None else tree.nodes.get(LAYER_NODE)
    if node is not None:
        node.scene = splats


def remove(tree: bpy.types.NodeTree) -> None:
    """Remove the nodes and link their neighbors again."""
    if (node := tree.nodes.get(COMBINE_NODE)) is not None:
        sources = [link.from_socket for link in node.inputs[0].links]
        for target in [link.to_socket for link in node.outputs[0].links]:
            for source in sources:
                tree.links.new(source, target)
        tree.nodes.remove(node)
    for name in (LAYER_NODE, WORLD_NODE):
        if (node := tree.nodes.get(name)) is not None:
            tree.nodes.remove(node)


def _show_world(
    tree: bpy.types.NodeTree, combine: bpy.types.Node, world: bpy.types.Scene | None
) -> None:
    node = tree.nodes.get(WORLD_NODE)
    if world is None:
        if node is not None:
            tree.nodes.remove(node)
        return
    node = node or tree.nodes.new("CompositorNodeRLayers")
    node.name = node.label = WORLD_NODE
    node.scene, node.location = world, (combine.location.x - 300, combine.location.y - 840)
    tree.links.new(node.outputs["Image"], combine.inputs["World"])


def _combine(
    tree: bpy.types.NodeTree, scene: bpy.types.Scene, other: bpy.types.Scene
) -> bpy.types.Node:
    layers = tree.nodes.get(LAYER_NODE)
    meshes = _render_layers(tree, scene)
    layers = layers or tree.nodes.new("CompositorNodeRLayers")
    layers.name = layers.label = LAYER_NODE
    layers.scene, layers.location = other, (meshes.location.x, meshes.location.y - 420)
    combine = tree.nodes.new("CompositorNodeGroup")
    combine.name = combine.label = COMBINE_NODE
    combine.node_tree = group()
    combine.location = (meshes.location.x + 300, meshes.location.y)
    followers = [link.to_socket for link in meshes.outputs["Image"].links]
    for socket in followers:
        tree.links.new(combine.outputs[0], socket)
    for i, output in enumerate((meshes, layers)):
        tree.links.new(output.outputs["Image"], combine.inputs[2 * i])
        tree.links.new(output.outputs["Depth"], combine.inputs[2 * i + 1])
    _link_holdouts(tree, layers, combine)
    if not followers:
        tree.links.new(combine.outputs[0], compat.compositor_result(tree))
    return combine


def _render_layers(tree: bpy.types.NodeTree, scene: bpy.types.Scene) -> bpy.types.Node:
    """The node that brings the scene's own render into the tree."""
    for node in tree.nodes:
        if node.type == "R_LAYERS" and node.scene == scene and node.name != LAYER_NODE:
            return node
    node = tree.nodes.new("CompositorNodeRLayers")
    node.scene = scene
    return node
