"""Compositor node group that combines splats and meshes by depth, over the world."""

import bpy

from .. import compat
from .color import NOTHING
from .pass_renderer import HOLDOUT_PASSES

GROUP = "Combine by Depth"
_FORM, _OF_NOW = "gs_form", 3
"""Custom property of the group: version of its formula; those before 2 have none."""
_GROW = 2
"""Pixels by which the depth order grows into the holes of meshes: the radius of the smoothing."""
_ROWS = 4
"""Rows in which the nodes of the group are laid out."""
Value = bpy.types.NodeSocket | float


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
    _fill(tree)
    return tree


def is_current(tree: bpy.types.NodeTree) -> bool:
    """Whether a group has the current sockets and formula."""
    return tree.get(_FORM) == _OF_NOW


def _fill(tree: bpy.types.NodeTree) -> None:
    """Add the nodes of the formula; variables are named as in it."""
    given = _placed(tree.nodes.new("NodeGroupInput"), tree)
    meshes, mesh_depth, splats, splat_depth, world = given.outputs[:5]
    h, gone, held_depth, g, t = (given.outputs[name] for name in HOLDOUT_PASSES)
    pictures = [_channels(tree, one) for one in (splats, meshes, world)]
    s, a = pictures[0][3], pictures[1][3]
    p = _before(tree, splat_depth, mesh_depth, g)
    q = _before(tree, held_depth, mesh_depth, g)
    light = _math(tree, "SUBTRACT", 1.0, s)
    light = _math(tree, "SUBTRACT", light, _math(tree, "MULTIPLY", light, gone))  # 1 - A
    more = _math(tree, "MULTIPLY", _math(tree, "SUBTRACT", 1.0, t), gone)  # B - t
    past = _math(tree, "SUBTRACT", 1.0, a)
    covered = _math(tree, "MULTIPLY", a, _math(tree, "SUBTRACT", 1.0, p))
    cut = _math(tree, "MULTIPLY_ADD", p, _math(tree, "SUBTRACT", more, h), h)
    hidden = _math(tree, "MULTIPLY_ADD", q, cut, _math(tree, "MULTIPLY", p, t))
    through = _math(tree, "SUBTRACT", _math(tree, "MULTIPLY", light, past), g)
    shares = (
        _math(tree, "SUBTRACT", 1.0, covered),
        _math(tree, "SUBTRACT", 1.0, hidden),
        _math(tree, "MAXIMUM", through, 0.0),
    )
    totals: list[Value] = [0.0] * 4
    for picture, share in zip(pictures, shares, strict=True):
        totals = [
            _math(tree, "MULTIPLY_ADD", one, share, total)
            for one, total in zip(picture, totals, strict=True)
        ]
    whole = _placed(tree.nodes.new("CompositorNodeCombineColor"), tree)
    for total, socket in zip(totals, whole.inputs, strict=True):
        _put(tree, total, socket)
    result = _placed(tree.nodes.new("NodeGroupOutput"), tree)
    tree.links.new(whole.outputs[0], result.inputs[0])


def _placed(node: bpy.types.Node, tree: bpy.types.NodeTree) -> bpy.types.Node:
    """Place a new node in the grid of columns, in order of creation."""
    column, row = divmod(len(tree.nodes) - 1, _ROWS)
    node.location = (220 * column, -200 * row)
    return node


def _channels(
    tree: bpy.types.NodeTree, picture: bpy.types.NodeSocket
) -> list[bpy.types.NodeSocket]:
    """Red, green, blue and alpha."""
    node = _placed(tree.nodes.new("CompositorNodeSeparateColor"), tree)
    tree.links.new(picture, node.inputs[0])
    return list(node.outputs)


def _before(
    tree: bpy.types.NodeTree,
    depth: bpy.types.NodeSocket,
    other: bpy.types.NodeSocket,
    cut: bpy.types.NodeSocket,
) -> bpy.types.NodeSocket:
    """1 where a depth is less than another, smoothed along changes; holes without a depth take the
    value of adjacent pixels."""
    lacking = _math(tree, "MULTIPLY", _math(tree, "ADD", depth, other), cut)
    known = _math(tree, "LESS_THAN", lacking, NOTHING / 100)
    nearer = _math(tree, "MULTIPLY", _math(tree, "LESS_THAN", depth, other), known)
    grown = _placed(compat.new_dilate_node(tree, _GROW), tree)
    tree.links.new(nearer, grown.inputs[0])
    nearer = _math(tree, "MAXIMUM", nearer, _math(tree, "SUBTRACT", grown.outputs[0], known))
    smooth = _placed(tree.nodes.new("CompositorNodeAntiAliasing"), tree)
    tree.links.new(nearer, smooth.inputs[0])
    return smooth.outputs[0]


def _math(tree: bpy.types.NodeTree, operation: str, *values: Value) -> bpy.types.NodeSocket:
    """The output of a new math node."""
    node = _placed(compat.new_math_node(tree), tree)
    node.operation = operation
    for value, socket in zip(values, node.inputs, strict=False):
        _put(tree, value, socket)
    return node.outputs[0]


def _put(tree: bpy.types.NodeTree, value: Value, socket: bpy.types.NodeSocket) -> None:
    if isinstance(value, bpy.types.NodeSocket):
        tree.links.new(value, socket)
    else:
        socket.default_value = value
