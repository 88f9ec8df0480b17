"""Node group "Splat Colors": the displayed colour of a splat, as a scene-linear field."""

import bpy
import numpy as np

from ..attributes import BASE, SCALE, SH, SH_COUNTS
from ..core import sh0_to_rgb
from ..srgb import decode
from . import harmonics
from .filters import exists, largest, opacity
from .graph import Graph, Socket, ensure, inputs, new_group, result, socket, use_group

NAME, ENERGY, MEASURE = "Splat Colors", "Splat Color Energy", "Splat Color Measure"
MODES = ("COLOR", "OPACITY", "SIZE", "ANISOTROPY", "SH_ENERGY", "DEPTH")
"""Values of the group's input Color By, by index."""
ELONGATION_DECADES = 2.0
"""End of the colour map: the longest axis is 10^2 times the shortest."""
_SPREAD = 2.0
"""Standard deviations to each side of the mean that the colour map spans."""
_VIRIDIS = ("440154", "46327e", "365c8d", "277f8e", "1fa187", "4ac16d", "a0da39", "fde725")
"""Samples at equal distances of the map viridis (CC0), sRGB."""


def group() -> bpy.types.NodeTree:
    """The group, built if the file has none."""
    return ensure(bpy.data.node_groups, NAME, _build)


def _build(name: str) -> bpy.types.NodeTree:
    graph, tree = new_group(name)
    socket(tree, "Geometry", "Geometry")
    socket(tree, "Visible", "Bool", True)
    socket(tree, "Color By", "Int", 0, min_value=0, max_value=len(MODES) - 1)
    socket(tree, "From Camera", "Bool", False)
    given = inputs(graph)
    mapped = _color_map(graph, use_group(graph, measure_group(), given))
    options = [_color(graph, given["From Camera"])] + [mapped] * (len(MODES) - 1)
    result(graph, "Color", "Color", graph.choose("RGBA", given["Color By"], options))
    return tree


def measure_group() -> bpy.types.NodeTree:
    """The group that outputs the chosen quantity of a splat as 0 to 1; a group of its own like
    `energy_group`."""
    return ensure(bpy.data.node_groups, MEASURE, _build_measure)


def _build_measure(name: str) -> bpy.types.NodeTree:
    graph, tree = new_group(name)
    socket(tree, "Geometry", "Geometry")
    socket(tree, "Visible", "Bool", True)
    socket(tree, "Color By", "Int", 0, min_value=0, max_value=len(MODES) - 1)
    given = inputs(graph)
    size = graph.math("LOGARITHM", largest(graph), 10.0)
    energy = use_group(graph, energy_group(), {})
    measures = [
        0.0,
        opacity(graph),
        _spread(graph, given, size),
        _elongation(graph),
        _spread(graph, given, energy, from_zero=True),
        _spread(graph, given, _camera_depth(graph)),
    ]
    result(graph, "Measure", "Float", graph.choose("FLOAT", given["Color By"], measures))
    return tree


def _color(graph: Graph, from_camera: Socket) -> Socket:
    """The colour from the scene's camera, if `from_camera` and there is one; else the mean."""
    camera = graph.call("GeometryNodeInputActiveCamera")
    place = graph.outputs("GeometryNodeObjectInfo", camera, transform_space="RELATIVE")
    viewed = use_group(graph, harmonics.group(), {"From": place["Location"]})
    by_view = graph.both(from_camera, exists(graph, camera))
    return graph.switch("RGBA", by_view, _base_color(graph), viewed)


def _base_color(graph: Graph) -> Socket:
    """The constant part of the SH colour: display-referred sRGB values, decoded to scene-linear."""
    middle = float(sh0_to_rgb(0.0))
    factor = float(sh0_to_rgb(1.0)) - middle
    channels = []
    for channel in graph.channels(graph.attribute(BASE, "FLOAT_COLOR"))[:3]:
        encoded = graph.math("MULTIPLY_ADD", channel, factor, middle)
        channels.append(harmonics.linear(graph, encoded))
    return graph.call("FunctionNodeCombineColor", *channels, 1.0)


def _elongation(graph: Graph) -> Socket:
    """0 for a ball, 1 if the longest axis is 100 times the shortest."""
    x, y, z = graph.separate(graph.attribute(SCALE, "FLOAT_VECTOR"))
    smallest = graph.math("MINIMUM", graph.math("MINIMUM", x, y), z)
    ratio = graph.math("DIVIDE", largest(graph), graph.math("MAXIMUM", smallest, 1e-30))
    return graph.math("DIVIDE", graph.math("LOGARITHM", ratio, 10.0), ELONGATION_DECADES)


def energy_group() -> bpy.types.NodeTree:
    """The group that outputs the L2 norm of the coefficients of degree 1 to 3.

    A group of its own, because the time to build a tree grows with the square of its size.
    """
    return ensure(bpy.data.node_groups, ENERGY, _build_energy)


def _build_energy(name: str) -> bpy.types.NodeTree:
    graph, tree = new_group(name)
    total: Socket | None = None
    for k in range(SH_COUNTS[3]):
        value = graph.attribute(f"{SH}{k}", "FLOAT_VECTOR")
        square = graph.vector("DOT_PRODUCT", value, value)
        total = square if total is None else graph.math("ADD", total, square)
    result(graph, "Energy", "Float", graph.math("SQRT", total))
    return tree


def _camera_depth(graph: Graph) -> Socket:
    """Distance in front of the scene's camera, along its axis."""
    camera = graph.call("GeometryNodeInputActiveCamera")
    matrix = graph.call("GeometryNodeObjectInfo", camera, transform_space="RELATIVE")
    position = graph.call("GeometryNodeInputPosition")
    to_camera = graph.call("FunctionNodeInvertMatrix", matrix)
    z = graph.separate(graph.call("FunctionNodeTransformPoint", position, to_camera))[2]
    return graph.math("MULTIPLY", z, -1.0)


def _spread(
    graph: Graph, given: dict[str, Socket], field: Socket, *, from_zero: bool = False
) -> Socket:
    """A field as 0 to 1 over mean +- 2 standard deviations of the visible splats."""
    of = graph.outputs(
        "GeometryNodeAttributeStatistic",
        *(given["Geometry"], given["Visible"], field),
        data_type="FLOAT",
        domain="POINT",
    )
    margin = graph.math("MULTIPLY", of["Standard Deviation"], _SPREAD)
    low = 0.0 if from_zero else graph.math("SUBTRACT", of["Mean"], margin)
    high = graph.math("ADD", of["Mean"], margin)
    span = graph.math("MAXIMUM", graph.math("SUBTRACT", high, low), 1e-12)
    return graph.math("DIVIDE", graph.math("SUBTRACT", field, low), span)


def _color_map(graph: Graph, measure: Socket) -> Socket:
    """Viridis: dark blue for 0, yellow for 1."""
    node = graph.node("ShaderNodeValToRGB")
    ramp = node.color_ramp
    while len(ramp.elements) < len(_VIRIDIS):
        ramp.elements.new(0.5)
    for k, code in enumerate(_VIRIDIS):
        encoded = np.array([int(code[i : i + 2], 16) / 255 for i in (0, 2, 4)])
        element = ramp.elements[k]
        element.position = k / (len(_VIRIDIS) - 1)
        element.color = (*decode(encoded).tolist(), 1.0)
    graph.feed(node.inputs[0], measure)
    return node.outputs[0]
