"""Nodes of the compositor that put splats among meshes by depth, and both before a world."""

import bpy

from .. import compat
from . import held_passes

LAYER_NODE, COMBINE_NODE, WORLD_NODE = "GS Splats", "GS Combine by Depth", "GS World"
"""Names of the nodes in the scene's tree."""
GROUP = "Combine by Depth"


def combine_node(scene: bpy.types.Scene) -> bpy.types.Node | None:
    """The node that puts a scene's splats among its meshes, where that was set up."""
    tree = compat.compositor_tree(scene)
    return None if tree is None else tree.nodes.get(COMBINE_NODE)


def insert(
    tree: bpy.types.NodeTree,
    scene: bpy.types.Scene,
    splats: bpy.types.Scene,
    world: bpy.types.Scene | None,
) -> None:
    """Put the nodes behind the scene's render layers, or bring them up to date.

    Args:
        tree: The scene's.
        scene: Renders the meshes.
        splats: Renders the splats.
        world: Renders what is behind everything; None: nothing is.
    """
    layers, combine = tree.nodes.get(LAYER_NODE), tree.nodes.get(COMBINE_NODE)
    if layers is not None and combine is not None:
        layers.scene = splats
        _renew(tree, combine, layers)
    else:
        combine = _combine(tree, scene, splats)
    _show_world(tree, combine, world)


def _renew(tree: bpy.types.NodeTree, combine: bpy.types.Node, layers: bpy.types.Node) -> None:
    """Give the node a group that knows of worlds and of what is held out; older files have one that
    does not."""
    if combine.node_tree is not None and _is_of_now(combine.node_tree):
        return
    # The new group's result is another socket to Blender, so that its links would go.
    targets = [link.to_socket for link in combine.outputs[0].links]
    combine.node_tree = _group()
    for target in targets:
        tree.links.new(combine.outputs[0], target)
    _link_held(tree, layers, combine)


def _link_held(tree: bpy.types.NodeTree, layers: bpy.types.Node, combine: bpy.types.Node) -> None:
    """Tell the node of what is held out, of which the node of the splats knows."""
    for name in held_passes.NAMES:
        tree.links.new(layers.outputs[name], combine.inputs[name])


def show_passes(scene: bpy.types.Scene, splats: bpy.types.Scene) -> None:
    """Give the node of the splats' render sockets for passes that were just switched on, which
    Blender 4.2 does for the nodes of the rendered scene alone."""
    tree = compat.compositor_tree(scene)
    node = None if tree is None else tree.nodes.get(LAYER_NODE)
    if node is not None:
        node.scene = splats


def remove(tree: bpy.types.NodeTree) -> None:
    """Take the nodes away; what they were put between is linked again."""
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
    combine.node_tree = _group()
    combine.location = (meshes.location.x + 300, meshes.location.y)
    followers = [link.to_socket for link in meshes.outputs["Image"].links]
    for socket in followers:
        tree.links.new(combine.outputs[0], socket)
    for i, output in enumerate((meshes, layers)):
        tree.links.new(output.outputs["Image"], combine.inputs[2 * i])
        tree.links.new(output.outputs["Depth"], combine.inputs[2 * i + 1])
    _link_held(tree, layers, combine)
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


def _group() -> bpy.types.NodeTree:
    """Two premultiplied pictures with depths to one: at each pixel the nearer one over the other,
    and both over a world. Where splats are held out before meshes or the world, these are cut.

    Blender's own Z Combine multiplies colours by alpha once more, so it is not used. Depths know no
    part of a pixel: where meshes and splats meet, the edge is smoothed.
    """
    for tree in bpy.data.node_groups:
        ours = tree.name.startswith(GROUP) and tree.bl_idname == "CompositorNodeTree"
        if ours and _is_of_now(tree):
            return tree
    tree = bpy.data.node_groups.new(GROUP, "CompositorNodeTree")
    for name in ("Meshes", "Splats"):
        tree.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketColor")
        tree.interface.new_socket(f"{name} Depth", in_out="INPUT", socket_type="NodeSocketFloat")
    backdrop = tree.interface.new_socket("World", in_out="INPUT", socket_type="NodeSocketColor")
    backdrop.default_value = (0, 0, 0, 0)
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    for name in held_passes.NAMES:  # after all others, whose links in older files so stay
        tree.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketFloat")
    given, result = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    given.location, result.location = (-1600, 0), (600, 0)
    meshes, mesh_depth, splats, splat_depth, world = given.outputs[:5]
    alone, all_of_it, held_depth = (given.outputs[name] for name in held_passes.NAMES)
    before = _before(tree, splat_depth, mesh_depth, -200)
    behind = _math(tree, "SUBTRACT", None, before, (-400, -200))
    # Splats that are held out alone before a mesh let through what they do; with all others before
    # it too, what all do, and how much the others block is seen by their alpha.
    more = _math(tree, "SUBTRACT", all_of_it, alone, (-1000, -400))
    more = _math(tree, "MULTIPLY", more, before, (-800, -400))
    cut = _math(tree, "ADD", alone, more, (-600, -400))
    held = _before(tree, held_depth, mesh_depth, -600)
    cut = _math(tree, "MULTIPLY", cut, held, (-400, -400))
    left = _over(tree, None, meshes, _math(tree, "SUBTRACT", None, cut, (-200, -400)), (-200, 200))
    far = _over(tree, None, splats, behind, (-200, 0))
    middle = _over(tree, far, left, None, (0, 0))
    near = _over(tree, middle, splats, before, (200, 0))
    light = _math(tree, "SUBTRACT", None, all_of_it, (0, -400))
    sky = _over(tree, None, world, light, (200, -200))
    tree.links.new(_over(tree, sky, near, None, (400, 0)), result.inputs[0])
    return tree


def _is_of_now(tree: bpy.types.NodeTree) -> bool:
    """Whether a group has all sockets."""
    return held_passes.HELD_DEPTH in (item.name for item in tree.interface.items_tree)


def _before(
    tree: bpy.types.NodeTree, depth: bpy.types.NodeSocket, other: bpy.types.NodeSocket, height: int
) -> bpy.types.NodeSocket:
    """1 where a depth is less than another, smoothed where that changes."""
    nearer = _math(tree, "LESS_THAN", depth, other, (-1400, height))
    smooth = tree.nodes.new("CompositorNodeAntiAliasing")
    smooth.location = (-1200, height)
    tree.links.new(nearer, smooth.inputs[0])
    return smooth.outputs[0]


def _math(
    tree: bpy.types.NodeTree,
    operation: str,
    first: bpy.types.NodeSocket | None,
    second: bpy.types.NodeSocket,
    location: tuple[int, int],
) -> bpy.types.NodeSocket:
    """A math node; without `first`, that is 1."""
    node = compat.new_math_node(tree)
    node.operation, node.location = operation, location
    if first is None:
        node.inputs[0].default_value = 1.0
    else:
        tree.links.new(first, node.inputs[0])
    tree.links.new(second, node.inputs[1])
    return node.outputs[0]


def _over(
    tree: bpy.types.NodeTree,
    below: bpy.types.NodeSocket | None,
    above: bpy.types.NodeSocket,
    factor: bpy.types.NodeSocket | None,
    location: tuple[int, int],
) -> bpy.types.NodeSocket:
    """`above` times `factor` over `below`; without them, 1 and nothing."""
    node = tree.nodes.new("CompositorNodeAlphaOver")
    node.location = location
    sockets = compat.alpha_over_sockets(node)
    sockets["below"].default_value = (0, 0, 0, 0)
    sockets["factor"].default_value = 1.0
    for name, socket in (("below", below), ("above", above), ("factor", factor)):
        if socket is not None:
            tree.links.new(socket, sockets[name])
    return node.outputs[0]
