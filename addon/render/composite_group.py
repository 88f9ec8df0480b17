"""Compositor node group that combines splats and meshes by depth, over the world."""

import bpy

from .. import compat
from . import holdout_passes
from .color import NOTHING

GROUP = "Combine by Depth"
_FORM, _OF_NOW = "gs_form", 3
"""Custom property of the group: which form of the formula it has; those before 2 have none."""
_GROW = 2
"""Pixels by which the order of depths grows into what meshes cut; the smoothing looks so far."""
_ROWS = 4
"""Of the nodes in the group."""
Value = bpy.types.NodeSocket | float


def group() -> bpy.types.NodeTree:
    """Premultiplied pictures of meshes and splats with depths, and of a world, to one.

    Of each pixel meshes, splats that are shown and splats that are held out have one depth each.
    With M and a the picture and alpha of the meshes, S and s those of the splats, which are cut
    where others are held out before them, W the world, V how much of it shows, h the alpha of all
    that are held out by themselves, and A that of all splats if none were, light that goes from
    back to front gives, with t = s and B = A but where meshes are held out,

        splats  held out
        before  before    S + (1 - B) M + V W
        before  behind    S + (1 - t) M + V W
        behind  before    (1 - a) S + (1 - h) M + V W
        behind  behind    (1 - a) S +         M + V W

    the meshes, for color and alpha alike. Depths know no part of a pixel: with p and q for "before"
    of the two, 1 or 0, smoothed where that changes, and the picture between the four,

        (1 - a (1 - p)) S + (1 - p t - q (p (B - t) + (1 - p) h)) M + V W

    What is opaque before and after such an edge so is opaque along it. The world shows where splats
    and meshes let it through, never where the meshes are cut. With g how much of a pixel are meshes
    that are held out, seen through the splats, and M and S cut there,

        V = max((1 - A) (1 - a) - g, 0)

    Along the edge of such a mesh no world is left then where what is beside it covers the rest; a
    product with 1 - g would leave a part. Nor does M show there through splats that are opaque
    beside the edge: both are cut, so that splats cover more than s of what is left of M. That is t,
    their alpha in the part of the pixel beside such meshes, with 1 - B = (1 - t) (1 - A) / (1 - s).
    Where these meshes hide all there are no depths, and p and q are those of what is next to it.
    """
    for tree in bpy.data.node_groups:
        ours = tree.name.startswith(GROUP) and tree.bl_idname == "CompositorNodeTree"
        if ours and is_of_now(tree):
            return tree
    tree = bpy.data.node_groups.new(GROUP, "CompositorNodeTree")
    tree[_FORM] = _OF_NOW
    for name in ("Meshes", "Splats"):
        tree.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketColor")
        tree.interface.new_socket(f"{name} Depth", in_out="INPUT", socket_type="NodeSocketFloat")
    backdrop = tree.interface.new_socket("World", in_out="INPUT", socket_type="NodeSocketColor")
    backdrop.default_value = (0, 0, 0, 0)
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    for name in holdout_passes.NAMES:  # after all others, whose links in older files so stay
        tree.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketFloat")
    _fill(tree)
    return tree


def is_of_now(tree: bpy.types.NodeTree) -> bool:
    """Whether a group has the sockets and the formula of today."""
    return tree.get(_FORM) == _OF_NOW


def _fill(tree: bpy.types.NodeTree) -> None:
    """The formula, with its names."""
    given = _placed(tree.nodes.new("NodeGroupInput"), tree)
    meshes, mesh_depth, splats, splat_depth, world = given.outputs[:5]
    h, gone, held_depth, g, t = (given.outputs[name] for name in holdout_passes.NAMES)
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
    """A node just made, in its place: in columns, in the order in which they are made."""
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
    """1 where a depth is less than another, smoothed where that changes. Where one is missing since
    all is cut, what is next to it counts."""
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
    """What a math node makes of its inputs."""
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
