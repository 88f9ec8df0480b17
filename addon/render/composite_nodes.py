"""Compositor nodes that combine splats and meshes by depth, over the world."""

from typing import NamedTuple

import bpy

from .. import compat
from ..nodes.graph import Graph, Socket, Value, ensure, inputs
from .color import NOTHING
from .pass_renderer import HOLDOUT_PASSES
from .shadow_scene import PASS

GROUP = "Combine by Depth"
SHADE_GROUP = "Shade Splats"
_FORM, _OF_NOW = "gs_form", 3
"""Custom property of the group: version of its formula; those before 2 have none."""
_GROW = 2
"""Pixels by which the depth order grows into the holes of meshes: the radius of the smoothing."""


def group() -> bpy.types.NodeTree:
    """Node group from premultiplied pictures of meshes, splats and a world, with depths, to one.

    Meshes, visible splats and holdout splats have one depth per pixel each. M and a are the picture
    and alpha of the meshes; S and s those of the splats, cut where holdout splats are in front; W
    is the world and V its weight; h is the alpha of the holdout splats alone, A that of all splats
    if none were holdouts. With t = s and B = A except at holdout meshes, blending from back to
    front gives, for color and alpha alike, depending on the order relative to the meshes,

        splats  holdout splats
        before  before    S + (1 - B) M + V W
        before  behind    S + (1 - t) M + V W
        behind  before    (1 - a) S + (1 - h) M + V W
        behind  behind    (1 - a) S +         M + V W

    A pixel has one depth even at an edge. Therefore p and q, which are 1 for "before" and 0 for
    "behind" of the two, are smoothed along changes, and the picture is interpolated between the
    four cases:

        (1 - a (1 - p)) S + (1 - p t - q (p (B - t) + (1 - p) h)) M + V W

    A pixel that is opaque on both sides of such an edge is opaque along it. The world shows through
    splats and meshes, never in the holes of holdout meshes. With g the coverage of holdout meshes
    seen through the splats, and M and S cut there,

        V = max((1 - A) (1 - a) - g, 0)

    This leaves no world along the edge of such a mesh if its neighborhood covers the rest of the
    pixel; a product with 1 - g would leave some. M must not show there either through splats that
    are opaque next to the edge: both are cut, so that splats cover more than s of the rest of M.
    That share is t, their alpha in the part of the pixel outside these meshes, with
    1 - B = (1 - t) (1 - A) / (1 - s). Where these meshes hide everything there is no depth, and p
    and q are those of adjacent pixels.
    """
    for tree in bpy.data.node_groups:
        ours = tree.name.startswith(GROUP) and tree.bl_idname == "CompositorNodeTree"
        if ours and is_current(tree):
            return tree
    tree = bpy.data.node_groups.new(GROUP, "CompositorNodeTree")
    tree[_FORM] = _OF_NOW
    for name in ("Meshes", "Splats"):
        tree.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketColor")
        tree.interface.new_socket(f"{name} Depth", in_out="INPUT", socket_type="NodeSocketFloat")
    backdrop = tree.interface.new_socket("World", in_out="INPUT", socket_type="NodeSocketColor")
    backdrop.default_value = (0, 0, 0, 0)
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    for name in HOLDOUT_PASSES:  # last, so that links in older files stay valid
        tree.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketFloat")
    _fill(Graph(tree))
    return tree


def is_current(tree: bpy.types.NodeTree) -> bool:
    """Whether a group has the current sockets and formula."""
    return tree.get(_FORM) == _OF_NOW


def _fill(graph: Graph) -> None:
    """Add the nodes of the formula; variables are named as in it."""

    def math(operation: str, *values: Value) -> Socket:
        node = compat.new_math_node(graph.tree)
        node.operation = operation
        for socket, value in zip(node.inputs, values, strict=False):
            graph.feed(socket, value)
        return node.outputs[0]

    def before(depth: Socket, other: Socket, cut: Socket) -> Socket:
        """1 where a depth is less than another, smoothed along changes; holes without a depth take
        the value of adjacent pixels."""
        lacking = math("MULTIPLY", math("ADD", depth, other), cut)
        known = math("LESS_THAN", lacking, NOTHING / 100)
        nearer = math("MULTIPLY", math("LESS_THAN", depth, other), known)
        grown = compat.new_dilate_node(graph.tree, _GROW)
        graph.feed(grown.inputs[0], nearer)
        nearer = math("MAXIMUM", nearer, math("SUBTRACT", grown.outputs[0], known))
        return graph.call("CompositorNodeAntiAliasing", nearer)

    given = inputs(graph)
    meshes, mesh_depth, splats, splat_depth, world = list(given.values())[:5]
    h, gone, held_depth, g, t = (given[name] for name in HOLDOUT_PASSES)
    pictures = [
        list(graph.outputs("CompositorNodeSeparateColor", one).values())
        for one in (splats, meshes, world)
    ]
    s, a = pictures[0][3], pictures[1][3]
    p, q = before(splat_depth, mesh_depth, g), before(held_depth, mesh_depth, g)
    light = math("SUBTRACT", 1.0, s)
    light = math("SUBTRACT", light, math("MULTIPLY", light, gone))  # 1 - A
    more = math("MULTIPLY", math("SUBTRACT", 1.0, t), gone)  # B - t
    covered = math("MULTIPLY", a, math("SUBTRACT", 1.0, p))
    cut = math("MULTIPLY_ADD", p, math("SUBTRACT", more, h), h)
    hidden = math("MULTIPLY_ADD", q, cut, math("MULTIPLY", p, t))
    through = math("SUBTRACT", math("MULTIPLY", light, math("SUBTRACT", 1.0, a)), g)
    shares = (
        math("SUBTRACT", 1.0, covered),
        math("SUBTRACT", 1.0, hidden),
        math("MAXIMUM", through, 0.0),
    )
    totals: list[Value] = [0.0] * 4
    for picture, share in zip(pictures, shares, strict=True):
        totals = [
            math("MULTIPLY_ADD", one, share, total)
            for one, total in zip(picture, totals, strict=True)
        ]
    whole = graph.call("CompositorNodeCombineColor", *totals)
    graph.feed(graph.node("NodeGroupOutput").inputs[0], whole)
    graph.arrange()


LAYER_NODE, COMBINE_NODE, WORLD_NODE = "GS Splats", "GS Combine by Depth", "GS World"
SHADOW_NODE, SHADE_NODE = "GS Shadows", "GS Shade Splats"
"""Names of the nodes in the scene's tree."""


class Others(NamedTuple):
    """Scenes besides that of the meshes."""

    splats: bpy.types.Scene
    world: bpy.types.Scene | None
    """Renders the world; None: no world."""
    shadows: bpy.types.Scene | None
    """Renders the shadows of meshes on splats; None: no shadows."""


def _shade_group() -> bpy.types.NodeTree:
    """Node group that multiplies the colors of a premultiplied picture by those of another one."""

    def make(name: str) -> bpy.types.NodeTree:
        tree = bpy.data.node_groups.new(name, "CompositorNodeTree")
        for socket in ("Image", "Shadows"):
            tree.interface.new_socket(socket, in_out="INPUT", socket_type="NodeSocketColor")
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        graph = Graph(tree)
        image, light = (
            list(graph.outputs("CompositorNodeSeparateColor", one).values())
            for one in inputs(graph).values()
        )
        shaded = []
        for color, share in zip(image[:3], light[:3], strict=True):
            node = compat.new_math_node(tree)
            node.operation = "MULTIPLY"
            graph.feed(node.inputs[0], color)
            graph.feed(node.inputs[1], share)
            shaded.append(node.outputs[0])
        whole = graph.call("CompositorNodeCombineColor", *shaded, image[3])
        graph.feed(graph.node("NodeGroupOutput").inputs[0], whole)
        graph.arrange()
        return tree

    return ensure(bpy.data.node_groups, SHADE_GROUP, make)


def combine_node(scene: bpy.types.Scene) -> bpy.types.Node | None:
    """The node that combines a scene's splats with its meshes, if it was set up."""
    tree = compat.compositor_tree(scene)
    return None if tree is None else tree.nodes.get(COMBINE_NODE)


def is_older(scene: bpy.types.Scene) -> bool:
    """Whether that node comes from an earlier version, whose formula handles less."""
    node = combine_node(scene)
    return node is not None and not _is_renewed(node)


def insert(tree: bpy.types.NodeTree, scene: bpy.types.Scene, others: Others) -> None:
    """Insert the nodes after the scene's render layers, or update them.

    Args:
        tree: The scene's.
        scene: Renders the meshes.
        others: Render the rest.
    """
    layers, combine = tree.nodes.get(LAYER_NODE), tree.nodes.get(COMBINE_NODE)
    if layers is not None and combine is not None:
        layers.scene = others.splats
        _renew(tree, combine, layers)
    else:
        combine = _combine(tree, scene, others.splats)
    _show_world(tree, combine, others.world)
    _shade(tree, combine, others.shadows)


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
    for name in (LAYER_NODE, WORLD_NODE, SHADOW_NODE, SHADE_NODE):
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


def _shade(
    tree: bpy.types.NodeTree, combine: bpy.types.Node, shadows: bpy.types.Scene | None
) -> None:
    """Multiply the picture of the splats by the shadows on them; None: use it as it is."""
    layers, node, shade = (tree.nodes.get(name) for name in (LAYER_NODE, SHADOW_NODE, SHADE_NODE))
    if shadows is None:
        for one in filter(None, (node, shade)):
            tree.nodes.remove(one)
        tree.links.new(layers.outputs["Image"], combine.inputs["Splats"])
        return
    node = node or tree.nodes.new("CompositorNodeRLayers")
    node.name = node.label = SHADOW_NODE
    node.scene, node.location = shadows, (layers.location.x, layers.location.y - 840)
    shade = shade or tree.nodes.new("CompositorNodeGroup")
    shade.name = shade.label = SHADE_NODE
    shade.node_tree = _shade_group()
    shade.location = (combine.location.x - 200, combine.location.y - 200)
    tree.links.new(layers.outputs["Image"], shade.inputs["Image"])
    tree.links.new(node.outputs[PASS], shade.inputs["Shadows"])
    tree.links.new(shade.outputs["Image"], combine.inputs["Splats"])


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
