"""SfM points as a mesh object that shows their colours."""

import bpy
import numpy as np

from .. import attributes, compat
from ..nodes import materials
from ..nodes.graph import Graph, Socket, inputs, new_group, result, socket
from ..srgb import decode, encode

COLOR = "gs_color"
"""Attribute of the colours, linear RGBA; Cycles draws point clouds with `color` black."""
INDEX = "gs_point"
"""Attribute with each point's index in the capture, for an export to find its track."""
GROUP = "Capture Points"
"""Name of the node group and of its material."""
SOLID_MOST = 200_000
"""Largest number of points drawn as small octahedra, whose faces Solid shading can colour. More
become a point cloud, coloured only in Material Preview and renders."""
ANGLE = 0.002
"""Angular radius of a point from the nearest camera, radians: two or three pixels of a photo."""


def columns(
    points: np.ndarray, colors: np.ndarray, indices: np.ndarray
) -> tuple[tuple[str, str, np.ndarray], ...]:
    """Mesh attributes of points, for `attributes.fill`; no bpy.

    Args:
        points: [P, 3] float.
        colors: [P, 3] uint8 sRGB.
        indices: [P] int, indices of the points in the capture.
    """
    rgba = np.ones((len(points), 4), np.float32)
    rgba[:, :3] = decode(np.arange(256) / 255)[colors]
    return (
        (attributes.POSITION, "FLOAT_VECTOR", np.ascontiguousarray(points, np.float32).ravel()),
        (COLOR, "FLOAT_COLOR", rgba.ravel()),
        (INDEX, "INT", indices.astype(np.int32)),
    )


def complete(mesh: bpy.types.Mesh) -> None:
    """Activate the colors of a filled mesh."""
    mesh.color_attributes.active_color = mesh.color_attributes[COLOR]
    mesh.materials.append(_material())
    mesh.update()


def display(ob: bpy.types.Object, radius: float) -> None:
    """Display an object of points by a node group.

    It is hidden in renders (`hide_render`) until the user shows it.

    Args:
        ob: The object.
        radius: Radius of a displayed point, in the parent's units.
    """
    ob.hide_render = True
    modifier = ob.modifiers.new(GROUP, "NODES")
    modifier.node_group = _node_group()
    compat.set_modifier_input(modifier, "Radius", radius)


def point_radius(points: np.ndarray, centers: np.ndarray) -> float:
    """Display radius of points [P, 3] for cameras [C, 3]; P, C > 0."""
    few = points[:: max(1, len(points) // 1000)]
    some = centers[:: max(1, len(centers) // 300)]
    distances = np.linalg.norm(few[:, None] - some[None], axis=2).min(axis=1)
    return ANGLE * max(float(np.median(distances)), 1e-9)


def positions_of(ob: bpy.types.Object) -> np.ndarray:
    """Positions [P, 3] float32 of a mesh object's vertices, in its own space."""
    flat = np.empty(3 * len(ob.data.vertices), np.float32)
    ob.data.attributes["position"].data.foreach_get("vector", flat)
    return flat.reshape(-1, 3)


def places_of(ob: bpy.types.Object) -> np.ndarray:
    """[P] int32, index of each vertex in the imported capture; -1 without one."""
    out = np.full(len(ob.data.vertices), -1, np.int32)
    attribute = ob.data.attributes.get(INDEX)
    if attribute is not None and attribute.data_type == "INT" and attribute.domain == "POINT":
        attribute.data.foreach_get("value", out)
    return out


def unique_places(places: np.ndarray) -> np.ndarray:
    """[P] int32, `places_of` with -1 for the later copies of a point."""
    out = np.full(len(places), -1, np.int32)
    first = np.unique(places, return_index=True)[1]
    out[first] = places[first]
    return out


def linear_of(ob: bpy.types.Object) -> np.ndarray | None:
    """[P, 4] float32, scene-linear colours of an object of points; None: it has none."""
    attribute = ob.data.attributes.get(COLOR)
    if attribute is None or attribute.data_type != "FLOAT_COLOR" or attribute.domain != "POINT":
        return None
    rgba = np.empty(4 * len(ob.data.vertices), np.float32)
    attribute.data.foreach_get("color", rgba)
    return rgba.reshape(-1, 4)


def encoded(rgba: np.ndarray) -> np.ndarray:
    """[P, 3] uint8 sRGB of `linear_of`."""
    return np.rint(255 * encode(rgba[:, :3].clip(0, 1))).astype(np.uint8)


def _node_group() -> bpy.types.NodeTree:
    group = bpy.data.node_groups.get(GROUP)
    if group is not None and group.bl_idname == "GeometryNodeTree":
        return group
    graph, group = new_group(GROUP)
    group.is_modifier = True
    about = "Radius of a point, in units of the capture's world"
    more = {"min_value": 0.0, "subtype": "DISTANCE", "description": about}
    socket(group, "Geometry", "Geometry")
    socket(group, "Radius", "Float", 0.01, **more)
    given = inputs(graph)
    shown = _shown(graph, given["Geometry"], given["Radius"])
    painted = graph.call("GeometryNodeSetMaterial", shown, None, _material())
    result(graph, "Geometry", "Geometry", painted)
    return group


def _shown(graph: Graph, geometry: Socket, radius: Socket) -> Socket:
    """Vertices -> octahedra, or a point cloud for too many."""
    count = graph.outputs("GeometryNodeAttributeDomainSize", geometry)["Point Count"]
    comparison = {"data_type": "INT", "operation": "GREATER_THAN"}
    many = graph.call("FunctionNodeCompare", count, SOLID_MOST, **comparison)
    shape = {"Segments": 4, "Rings": 2, "Radius": radius}
    ball = graph.call("GeometryNodeMeshUVSphere", named=shape)
    balls = {"Points": geometry, "Instance": ball}
    spread = graph.call("GeometryNodeInstanceOnPoints", named=balls)
    # One bare vertex is joined, because it has the active color attribute. More would be drawn as
    # black dots over the colors.
    index = graph.call("GeometryNodeInputIndex")  # true for all but 0
    join = graph.node("GeometryNodeJoinGeometry")
    graph.feed(join.inputs[0], graph.call("GeometryNodeRealizeInstances", spread))
    graph.feed(join.inputs[0], graph.call("GeometryNodeDeleteGeometry", geometry, index))
    points = {"Mesh": geometry, "Radius": radius}
    cloud = graph.call("GeometryNodeMeshToPoints", named=points)
    return graph.switch("GEOMETRY", many, join.outputs[0], cloud)


def _material() -> bpy.types.Material:
    """Emission of the photographed colours, without lighting."""
    return bpy.data.materials.get(GROUP) or materials.plain(GROUP, "GEOMETRY")
