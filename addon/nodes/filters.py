"""Node group "Splat Filters": visibility of splats; the twin of `splats.filters.mask`."""

import bpy

from ..attributes import BASE, SCALE
from .graph import Graph, Socket, ensure, inputs, new_group, result, socket

NAME = "Splat Filters"


def group() -> bpy.types.NodeTree:
    """The group, built if the file has none: limits in, one boolean field out."""
    return ensure(bpy.data.node_groups, NAME, _build)


def add_inputs(tree: bpy.types.NodeTree) -> None:
    """The limits, as inputs of this group and of the display group around it."""
    socket(tree, "Opacity Minimum", "Float", 0.0, min_value=0.0, max_value=1.0)
    socket(tree, "Size Minimum", "Float", 0.0, min_value=0.0)
    socket(tree, "Size Maximum", "Float", 0.0, min_value=0.0)
    socket(tree, "Use Crop", "Bool", False)
    socket(tree, "Crop Object", "Object")
    socket(tree, "Crop Sphere", "Bool", False)
    socket(tree, "Crop Invert", "Bool", False)


def largest(graph: Graph) -> Socket:
    """A splat's largest standard deviation."""
    x, y, z = graph.separate(graph.attribute(SCALE, "FLOAT_VECTOR"))
    return graph.math("MAXIMUM", graph.math("MAXIMUM", x, y), z)


def opacity(graph: Graph) -> Socket:
    """A splat's opacity in [0, 1]."""
    return graph.channels(graph.attribute(BASE, "FLOAT_COLOR"))[3]


def _build(name: str) -> bpy.types.NodeTree:
    graph, tree = new_group(name)
    add_inputs(tree)
    given = inputs(graph)
    size = largest(graph)
    keep = graph.compare("GREATER_EQUAL", opacity(graph), given["Opacity Minimum"])
    keep = graph.both(keep, graph.compare("GREATER_EQUAL", size, given["Size Minimum"]))
    small = graph.compare("LESS_EQUAL", size, given["Size Maximum"])
    unlimited = graph.compare("LESS_EQUAL", given["Size Maximum"], 0.0)
    small = graph.call("FunctionNodeBooleanMath", small, unlimited, operation="OR")
    keep = graph.both(keep, small)
    inside = _inside(graph, given)
    wanted = graph.call("FunctionNodeBooleanMath", inside, given["Crop Invert"], operation="XOR")
    active = graph.both(given["Use Crop"], exists(graph, given["Crop Object"]))
    cropped = graph.switch("BOOLEAN", active, True, wanted)
    result(graph, "Visible", "Bool", graph.both(keep, cropped))
    return tree


def exists(graph: Graph, ob: Socket) -> Socket:
    """Whether the crop object still exists: a deleted one has scale 0."""
    info = graph.outputs("GeometryNodeObjectInfo", ob, transform_space="RELATIVE")
    return graph.compare("GREATER_THAN", graph.vector("LENGTH", info["Scale"]), 0.0)


def _inside(graph: Graph, given: dict[str, Socket]) -> Socket:
    """Whether a splat's centre is inside the bounds of the crop object, or their ellipsoid."""
    to_self = graph.call("GeometryNodeObjectInfo", given["Crop Object"], transform_space="RELATIVE")
    # In the original space, the geometry is without the object's transform.
    own = graph.outputs("GeometryNodeObjectInfo", given["Crop Object"], transform_space="ORIGINAL")
    bounds = graph.outputs("GeometryNodeBoundBox", own["Geometry"])
    low, high = bounds["Min"], bounds["Max"]
    middle = graph.vector("SCALE", graph.vector("ADD", low, high), 0.5)
    half = graph.vector("SCALE", graph.vector("SUBTRACT", high, low), 0.5)
    # An axis without extent counts one unit to each side.
    extended = graph.vector("CEIL", graph.vector("MINIMUM", half, (1.0, 1.0, 1.0)))
    half = graph.vector("ADD", half, graph.vector("SUBTRACT", (1.0, 1.0, 1.0), extended))
    invert = graph.outputs("FunctionNodeInvertMatrix", to_self)
    position = graph.call("GeometryNodeInputPosition")
    local = graph.call("FunctionNodeTransformPoint", position, invert["Matrix"])
    local = graph.vector("DIVIDE", graph.vector("SUBTRACT", local, middle), half)
    x, y, z = graph.separate(graph.vector("ABSOLUTE", local))
    reach = graph.math("MAXIMUM", graph.math("MAXIMUM", x, y), z)
    radius = graph.vector("LENGTH", local)
    distance = graph.switch("FLOAT", given["Crop Sphere"], reach, radius)
    within = graph.compare("LESS_EQUAL", distance, 1.0)
    return graph.both(within, invert["Invertible"])
