"""Node graph expressions: node trees built from functions of sockets."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import bpy

from .. import compat

Socket = bpy.types.NodeSocket
Value = Any
"""A socket to link, or a constant for the socket's default."""

VERSION = 5
"""Version of the node groups and materials; older ones in a file are replaced."""
_TAG, _NATIVE = "gs_nodes", " native"
"""Custom property of a datablock, and its suffix if nodes of Blender's native splats are used."""


def ensure(datablocks: Any, name: str, make: Callable[[str], bpy.types.ID]) -> bpy.types.ID:
    """The group or material of this name made by this add-on, or a new one.

    Datablocks of the same name from users or from other versions are not changed.
    """
    tag = f"{name} {VERSION}{_NATIVE if compat.splat_cloud_type() else ''}"
    for block in datablocks:
        if block.get(_TAG) == tag and block.library is None:
            return block
    block = make(name)
    block[_TAG] = tag
    return block


def is_of_another_blender(block: bpy.types.ID) -> bool:
    """Whether a datablock was built by a Blender with native splats and this one has none, or the
    reverse."""
    return str(block.get(_TAG, "")).endswith(_NATIVE) != bool(compat.splat_cloud_type())


def is_ours(block: bpy.types.ID | None, name: str) -> bool:
    """Whether a datablock was made by `ensure` under this name, in any version."""
    return block is not None and str(block.get(_TAG, "")).startswith(f"{name} ")


class Graph:
    """Builder of a node tree, with the same calls in every Blender version."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        self.tree = tree

    def node(self, kind: str, **settings: Any) -> bpy.types.Node:
        """Add a node and set its properties, on which its sockets depend."""
        node = self.tree.nodes.new(kind)
        for name, value in settings.items():
            if getattr(node, name) != value:  # each assignment updates the whole tree
                setattr(node, name, value)
        return node

    def feed(self, socket: Socket, value: Value) -> None:
        """Link a socket to an input or make a constant its default; None leaves it."""
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        elif value is not None:
            socket.default_value = value

    def call(
        self,
        kind: str,
        *values: Value,
        named: Mapping[str, Value] = MappingProxyType({}),
        out: int = 0,
        **settings: Any,
    ) -> Socket:
        """Add a node, feed its enabled inputs in order and others by name, and return an enabled
        output."""
        return self._outputs(kind, values, named, settings)[out]

    def outputs(self, kind: str, *values: Value, **settings: Any) -> dict[str, Socket]:
        """Like `call`; all enabled outputs by name."""
        return {s.name: s for s in self._outputs(kind, values, {}, settings)}

    def _outputs(
        self,
        kind: str,
        values: Sequence[Value],
        named: Mapping[str, Value],
        settings: dict[str, Any],
    ) -> list[Socket]:
        node = self.node(kind, **settings)
        inputs = [s for s in node.inputs if s.enabled and s.type != "CUSTOM"]
        for socket, value in zip(inputs, values, strict=False):
            self.feed(socket, value)
        for name, value in named.items():
            self.feed(node.inputs[name], value)
        return [s for s in node.outputs if s.enabled]

    def math(self, operation: str, *values: Value, clamp: bool = False) -> Socket:
        """Scalar arithmetic."""
        return self.call("ShaderNodeMath", *values, operation=operation, use_clamp=clamp)

    def vector(self, operation: str, *values: Value) -> Socket:
        """Vector arithmetic; lengths and dot products give a scalar."""
        return self.call("ShaderNodeVectorMath", *values, operation=operation)

    def attribute(self, name: str, data_type: str) -> Socket:
        """A named attribute of the current geometry; zero if it does not exist."""
        return self.call("GeometryNodeInputNamedAttribute", name, data_type=data_type)

    def compare(self, operation: str, a: Value, b: Value) -> Socket:
        """Compare two floats."""
        kind = "FunctionNodeCompare"
        return self.call(kind, a, b, data_type="FLOAT", operation=operation)

    def both(self, a: Socket, b: Socket) -> Socket:
        """Logical and."""
        return self.call("FunctionNodeBooleanMath", a, b, operation="AND")

    def switch(self, kind: str, condition: Value, false: Value, true: Value) -> Socket:
        """One of two values; with a constant condition only the chosen one is computed."""
        return self.call("GeometryNodeSwitch", condition, false, true, input_type=kind)

    def choose(self, kind: str, index: Socket, options: list[Value]) -> Socket:
        """One of several values by index; only the chosen one is computed."""
        node = self.node("GeometryNodeIndexSwitch", data_type=kind)
        while len(node.index_switch_items) < len(options):
            node.index_switch_items.new()
        sockets = [s for s in node.inputs if s.enabled and s.type != "CUSTOM"]
        for socket, value in zip(sockets, [index, *options], strict=True):
            self.feed(socket, value)
        return node.outputs[0]

    def separate(self, vector: Socket) -> list[Socket]:
        """x, y, z."""
        return list(self.outputs("ShaderNodeSeparateXYZ", vector).values())

    def channels(self, color: Socket) -> list[Socket]:
        """Red, green, blue and alpha."""
        return list(self.outputs("FunctionNodeSeparateColor", color).values())

    def arrange(self) -> None:
        """Place nodes in columns from the inputs to the output, to keep the tree readable."""
        depth: dict[str, int] = {}
        ends = [(link.from_node.name, link.to_node.name) for link in self.tree.links]
        for _ in self.tree.nodes:  # upper bound of the longest path
            before = dict(depth)
            for start, end in ends:
                depth[end] = max(depth.get(end, 0), depth.get(start, 0) + 1)
            if depth == before:
                break
        rows: dict[int, int] = {}
        places: list[float] = []
        for node in self.tree.nodes:
            column = depth.get(node.name, 0)
            places += (200 * column, -170 * rows.get(column, 0))
            rows[column] = rows.get(column, 0) + 1
        self.tree.nodes.foreach_set("location", places)  # without an update for each node


def new_group(name: str) -> tuple[Graph, bpy.types.NodeTree]:
    """An empty geometry node group."""
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    return Graph(tree), tree


def socket(
    tree: bpy.types.NodeTree, name: str, kind: str, default: Any = None, **more: Any
) -> None:
    """Add an input socket to a group's interface, for example kind Float, Int or Geometry."""
    item = tree.interface.new_socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}")
    if default is not None:
        item.default_value = default
    for key, value in more.items():
        setattr(item, key, value)


def result(graph: Graph, name: str, kind: str, value: Socket) -> None:
    """Give a group its one output."""
    graph.tree.interface.new_socket(name, in_out="OUTPUT", socket_type=f"NodeSocket{kind}")
    graph.feed(graph.node("NodeGroupOutput").inputs[0], value)
    graph.arrange()


def inputs(graph: Graph) -> dict[str, Socket]:
    """The group's inputs by name, as sockets to link from."""
    return {s.name: s for s in graph.node("NodeGroupInput").outputs if s.name}


def use_group(graph: Graph, group: bpy.types.NodeTree, values: dict[str, Value]) -> Socket:
    """Add a node group as a node, feed the inputs it shares with `values`, return its output."""
    node = graph.node("GeometryNodeGroup", node_tree=group)
    for item in node.inputs:
        graph.feed(item, values.get(item.name))
    return node.outputs[0]
