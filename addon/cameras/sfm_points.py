"""Points of structure from motion as a mesh object that shows its colours."""

import bpy
import numpy as np

from .. import compat

COLOR = "gs_color"
"""Attribute of the colours, linear RGBA. Cycles draws point clouds black whose colours are called
`color`."""
INDEX = "gs_point"
"""Attribute with each point's place in the capture, by which an export finds its track again."""
GROUP = "Capture Points"
"""Name of the node group and of its material."""
SOLID_MOST = 200_000
"""Points up to which each becomes a small octahedron, so that solid view has faces to colour; more
become a point cloud, which only Material Preview and renders colour."""
ANGLE = 0.002
"""Radius of a point as the nearest camera sees it, radians: two or three pixels of a photo."""


def create(
    points: np.ndarray,
    colors: np.ndarray,
    name: str,
    collection: bpy.types.Collection,
    parent: bpy.types.Object | None = None,
    indices: np.ndarray | None = None,
    radius: float = 0.01,
) -> bpy.types.Object:
    """A mesh object of loose vertices in the capture's world, displayed by a node group.

    It stays out of renders (`hide_render`) until the user wants it there.

    Args:
        points: [P, 3] float, in the parent's space.
        colors: [P, 3] uint8 sRGB.
        name: Of object and mesh.
        collection: To link it to.
        parent: Carries the alignment.
        indices: [P] int, places of the points in the capture; None: 0 to P - 1.
        radius: Of a displayed point, in the parent's units.
    """
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(points))
    flat = np.ascontiguousarray(points, np.float32).ravel()
    mesh.attributes["position"].data.foreach_set("vector", flat)
    rgba = np.ones((len(points), 4), np.float32)
    rgba[:, :3] = _linear(colors)
    mesh.attributes.new(COLOR, "FLOAT_COLOR", "POINT").data.foreach_set("color", rgba.ravel())
    places = np.arange(len(points)) if indices is None else indices
    mesh.attributes.new(INDEX, "INT", "POINT").data.foreach_set("value", places.astype(np.int32))
    mesh.color_attributes.active_color = mesh.color_attributes[COLOR]
    mesh.materials.append(_material())
    mesh.update()
    ob = bpy.data.objects.new(name, mesh)
    ob.parent = parent
    ob.hide_render = True
    collection.objects.link(ob)
    modifier = ob.modifiers.new(GROUP, "NODES")
    modifier.node_group = _node_group()
    compat.set_modifier_input(modifier, "Radius", radius)
    return ob


def point_radius(points: np.ndarray, centers: np.ndarray) -> float:
    """Radius at which points [P, 3] are visible to cameras [C, 3] and still apart; P, C > 0."""
    few = points[:: max(1, len(points) // 1000)]
    seen_from = centers[:: max(1, len(centers) // 300)]
    distances = np.linalg.norm(few[:, None] - seen_from[None], axis=2).min(axis=1)
    return ANGLE * max(float(np.median(distances)), 1e-9)


def positions_of(ob: bpy.types.Object) -> np.ndarray:
    """Positions [P, 3] float32 of a mesh object's vertices, in its own space."""
    flat = np.empty(3 * len(ob.data.vertices), np.float32)
    ob.data.attributes["position"].data.foreach_get("vector", flat)
    return flat.reshape(-1, 3)


def indices_of(ob: bpy.types.Object) -> np.ndarray:
    """Place of each vertex in the capture, [P] int32; -1 where it has none, or another's."""
    out = np.full(len(ob.data.vertices), -1, np.int32)
    attribute = ob.data.attributes.get(INDEX)
    if attribute is None or attribute.data_type != "INT" or attribute.domain != "POINT":
        return out
    places = np.empty_like(out)
    attribute.data.foreach_get("value", places)
    first = np.unique(places, return_index=True)[1]  # copies of a point carry its number too
    out[first] = places[first]
    return out


def colors_of(ob: bpy.types.Object) -> np.ndarray:
    """The colours [P, 3] uint8 sRGB of an object made by `create`.

    Raises:
        ValueError: the attribute is gone.
    """
    attribute = ob.data.attributes.get(COLOR)
    if attribute is None or attribute.data_type != "FLOAT_COLOR" or attribute.domain != "POINT":
        raise ValueError(
            f"{ob.name} has no colour attribute {COLOR!r} any more. Import the capture again."
        )
    rgba = np.empty(4 * len(ob.data.vertices), np.float32)
    attribute.data.foreach_get("color", rgba)
    linear = rgba.reshape(-1, 4)[:, :3].clip(0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(255 * encoded).astype(np.uint8)


def _linear(colors: np.ndarray) -> np.ndarray:
    """[P, 3] float32 scene-linear of uint8 sRGB (IEC 61966-2-1)."""
    table = np.arange(256) / 255
    table = np.where(table <= 0.04045, table / 12.92, ((table + 0.055) / 1.055) ** 2.4)
    return table.astype(np.float32)[colors]


def _node_group() -> bpy.types.NodeTree:
    group = bpy.data.node_groups.get(GROUP)
    if group is not None and group.bl_idname == "GeometryNodeTree":
        return group
    group = bpy.data.node_groups.new(GROUP, "GeometryNodeTree")
    group.is_modifier = True
    interface = group.interface
    interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    radius = interface.new_socket("Radius", in_out="INPUT", socket_type="NodeSocketFloat")
    radius.default_value, radius.min_value, radius.subtype = 0.01, 0.0, "DISTANCE"
    radius.description = "Radius of a point, in units of the capture's world"
    interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    _fill(group)
    return group


def _fill(group: bpy.types.NodeTree) -> None:
    """Vertices -> octahedra, or a point cloud where there are too many -> material."""
    place = iter(range(-800, 2000, 200))

    def node(kind: str) -> bpy.types.Node:
        made = group.nodes.new(kind)
        made.location.x = next(place)
        return made

    source, size, many = (
        node(kind)
        for kind in ("NodeGroupInput", "GeometryNodeAttributeDomainSize", "FunctionNodeCompare")
    )
    many.data_type, many.operation = "INT", "GREATER_THAN"
    limit = next(s for s in many.inputs if s.enabled and s.name == "B")
    limit.default_value = SOLID_MOST
    shape = node("GeometryNodeMeshUVSphere")
    shape.inputs["Segments"].default_value, shape.inputs["Rings"].default_value = 4, 2
    spread, real = node("GeometryNodeInstanceOnPoints"), node("GeometryNodeRealizeInstances")
    # One bare vertex comes along because it knows which colour attribute is the active one. More
    # would be drawn as black dots over the colours.
    index, rest = node("GeometryNodeInputIndex"), node("GeometryNodeDeleteGeometry")
    join = node("GeometryNodeJoinGeometry")
    cloud, switch = node("GeometryNodeMeshToPoints"), node("GeometryNodeSwitch")
    switch.input_type = "GEOMETRY"
    paint, end = node("GeometryNodeSetMaterial"), node("NodeGroupOutput")
    paint.inputs["Material"].default_value = _material()
    link = group.links.new
    geometry, radius = source.outputs["Geometry"], source.outputs["Radius"]
    link(geometry, size.inputs["Geometry"])
    link(size.outputs["Point Count"], next(s for s in many.inputs if s.enabled and s.name == "A"))
    link(geometry, spread.inputs["Points"])
    link(shape.outputs["Mesh"], spread.inputs["Instance"])
    link(radius, shape.inputs["Radius"])
    link(spread.outputs["Instances"], real.inputs["Geometry"])
    link(real.outputs["Geometry"], join.inputs["Geometry"])
    link(index.outputs["Index"], rest.inputs["Selection"])  # true for all but 0
    link(geometry, rest.inputs["Geometry"])
    link(rest.outputs["Geometry"], join.inputs["Geometry"])
    link(geometry, cloud.inputs["Mesh"])
    link(radius, cloud.inputs["Radius"])
    link(many.outputs["Result"], switch.inputs["Switch"])
    link(join.outputs["Geometry"], switch.inputs["False"])
    link(cloud.outputs["Points"], switch.inputs["True"])
    link(switch.outputs["Output"], paint.inputs["Geometry"])
    link(paint.outputs["Geometry"], end.inputs["Geometry"])


def _material() -> bpy.types.Material:
    """Emission of the colours, as photographed: not lit again."""
    material = bpy.data.materials.get(GROUP)
    if material is not None:
        return material
    material = bpy.data.materials.new(GROUP)
    if material.node_tree is None:  # before 5.0
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    color = tree.nodes.new("ShaderNodeAttribute")
    color.attribute_name = COLOR
    color.location.x = -400
    emission = tree.nodes.new("ShaderNodeEmission")
    emission.location.x = -200
    end = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(color.outputs["Color"], emission.inputs["Color"])
    tree.links.new(emission.outputs["Emission"], end.inputs["Surface"])
    return material
