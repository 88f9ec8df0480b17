"""Node group "Splat Display": mesh vertices to points, ellipsoids, soft splats or native splats."""

from collections.abc import Callable

import bpy

from .. import compat
from ..attributes import CAPTURED, NORMAL, ROTATION, SCALE, SH
from . import colors, filters, harmonics, materials
from .graph import Graph, Socket, ensure, inputs, is_ours, new_group, result, socket, use_group

NAME = "Splat Display"
MODES = ("POINTS", "ELLIPSOIDS", "SOFT", "NATIVE", "SPLATS")
"""Values of the group's input Display, by index. NATIVE are Blender's own splats (5.3 and later).
SPLATS shows only a box as a handle in viewports, where `live` draws the splats, and renders as
NATIVE, before 5.3 as SOFT."""
_RENDERS_SOFT = MODES.index("SOFT"), MODES.index("SPLATS")
_BOX = 2.0
"""Half sides of the handle, in standard deviations of the splats' positions."""


def group() -> bpy.types.NodeTree:
    """The group, built if the file has none."""
    return ensure(bpy.data.node_groups, NAME, _build)


def builders() -> list[Callable[[], bpy.types.ID]]:
    """Functions that build the group's parts and then the group, to be called one per step.

    Together they take a tenth of a second, which a user would notice.
    """
    parts = [materials.points, materials.ellipsoids, materials.soft, filters.group]
    measures = [colors.energy_group, colors.measure_group]
    return [*parts, *measures, *harmonics.builders(), colors.group, group]


def modifier_of(ob: bpy.types.Object) -> bpy.types.NodesModifier | None:
    """The object's display modifier, from any version of this add-on."""
    for modifier in ob.modifiers:
        if modifier.type == "NODES" and is_ours(modifier.node_group, NAME):
            return modifier
    return None


def _build(name: str) -> bpy.types.NodeTree:
    graph, tree = new_group(name)
    tree.is_modifier = True
    socket(tree, "Geometry", "Geometry")
    socket(tree, "Display", "Int", 0, min_value=0, max_value=len(MODES) - 1)
    socket(tree, "Color By", "Int", 0, min_value=0, max_value=len(colors.MODES) - 1)
    socket(tree, "Point Radius", "Float", 0.01, min_value=0.0, subtype="DISTANCE")
    socket(tree, "Ellipsoid Size", "Float", 1.5, min_value=0.0)
    filters.add_inputs(tree)
    socket(tree, "Light", "Float", 0.0, min_value=0.0, max_value=1.0)
    given = inputs(graph)
    visible = use_group(graph, filters.group(), given)
    renders_soft = [graph.compare("EQUAL", given["Display"], k) for k in _RENDERS_SOFT]
    from_camera = graph.call("FunctionNodeBooleanMath", *renders_soft, operation="OR")
    points = _points(graph, given, visible, from_camera)
    faded = _store(graph, "FLOAT", points, True, materials.OPACITY, filters.opacity(graph))
    soft = _instances(graph, faded, materials.REACH, materials.soft())
    native = _native(graph, given["Geometry"], visible) if compat.splat_cloud_type() else None
    in_viewport = graph.call("GeometryNodeIsViewport")
    options = [
        graph.call("GeometryNodeSetMaterial", points, None, materials.points()),
        _instances(graph, points, given["Ellipsoid Size"], materials.ellipsoids()),
        soft,
        native,
        graph.switch("GEOMETRY", in_viewport, native or soft, _handle(graph, given, visible)),
    ]
    result(graph, "Geometry", "Geometry", graph.choose("GEOMETRY", given["Display"], options))
    return tree


def _points(graph: Graph, given: dict[str, Socket], visible: Socket, from_camera: Socket) -> Socket:
    """The visible splats as a point cloud with a colour."""
    mesh = given["Geometry"]
    color = use_group(
        graph,
        colors.group(),
        {
            "Geometry": mesh,
            "Visible": visible,
            "Color By": given["Color By"],
            "From Camera": from_camera,
        },
    )
    colored = _store(graph, "FLOAT_COLOR", mesh, visible, materials.COLOR, color)
    # Coefficients take most of the memory and are not needed below.
    slim = graph.node("GeometryNodeRemoveAttribute")
    compat.remove_by_wildcard(slim)
    graph.feed(slim.inputs["Geometry"], colored)
    graph.feed(slim.inputs["Name"], f"{SH}*")
    lit = _store(graph, "FLOAT", slim.outputs[0], True, materials.LIGHT, _light(graph, given))
    lit = _store(graph, "FLOAT_VECTOR", lit, True, materials.FACING, _facing(graph))
    named = {"Mesh": lit, "Selection": visible, "Radius": given["Point Radius"]}
    return graph.call("GeometryNodeMeshToPoints", named=named)


def _light(graph: Graph, given: dict[str, Socket]) -> Socket:
    """The share of the scene's light; 0 for splats without captured light."""
    captured = graph.attribute(CAPTURED, "FLOAT_VECTOR")
    known = graph.math("GREATER_THAN", graph.vector("LENGTH", captured), 0.0)
    return graph.math("MULTIPLY", given["Light"], known)


def _facing(graph: Graph) -> Socket:
    """The normal in the world."""
    own = graph.outputs("GeometryNodeObjectInfo", graph.call("GeometryNodeSelfObject"))
    normal = graph.attribute(NORMAL, "FLOAT_VECTOR")
    return graph.call("FunctionNodeRotateVector", normal, own["Rotation"])


def _native(graph: Graph, mesh: Socket, visible: Socket) -> Socket:
    """The visible splats as Blender's native splats, which use the same attribute names."""
    points = graph.call("GeometryNodeMeshToPoints", named={"Mesh": mesh, "Selection": visible})
    named = {"Points": points, "Type": compat.splat_cloud_type()}
    return graph.call("GeometryNodePointsSetType", named=named)


def _handle(graph: Graph, given: dict[str, Socket], visible: Socket) -> Socket:
    """A box of edges around most of the visible splats, for clicking, outlines and framing."""
    position = graph.call("GeometryNodeInputPosition")
    of = graph.outputs(
        "GeometryNodeAttributeStatistic",
        *(given["Geometry"], visible, position),
        data_type="FLOAT_VECTOR",
        domain="POINT",
    )
    size = graph.vector("SCALE", of["Standard Deviation"], 2 * _BOX)
    cube = graph.call("GeometryNodeMeshCube", named={"Size": size})
    edges = graph.call("GeometryNodeDeleteGeometry", cube, domain="FACE", mode="ONLY_FACE")
    named = {"Geometry": edges, "Translation": of["Mean"]}
    return graph.call("GeometryNodeTransform", named=named)


def _store(graph: Graph, data_type: str, *values: Socket | str | bool) -> Socket:
    """Store an attribute: geometry, selection, name and value."""
    kind = "GeometryNodeStoreNamedAttribute"
    return graph.call(kind, *values, data_type=data_type, domain="POINT")


def _instances(
    graph: Graph, points: Socket, size: Socket | float, material: bpy.types.Material
) -> Socket:
    """A ball on every point, scaled and rotated like the splat."""
    ball = graph.call("GeometryNodeMeshIcoSphere", named={"Subdivisions": 2})
    named = {
        "Points": points,
        "Instance": graph.call("GeometryNodeSetMaterial", ball, None, material),
        "Rotation": graph.attribute(ROTATION, "QUATERNION"),
        "Scale": graph.vector("SCALE", graph.attribute(SCALE, "FLOAT_VECTOR"), size),
    }
    return graph.call("GeometryNodeInstanceOnPoints", named=named)
