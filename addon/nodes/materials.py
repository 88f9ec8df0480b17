"""Materials with a splat's colour, unlit or relit: on points and ellipsoids, and with a falloff."""

import bpy

from .. import compat
from ..attributes import CAPTURED
from .graph import Graph, Socket, ensure

COLOR = "gs_color"
"""Attribute of the scene-linear colour. (The name `color` renders black on point clouds.)"""
OPACITY = "gs_opacity"
FACING, LIGHT = "gs_facing", "gs_light"
"""Attributes of the world normal, and of the share of the scene's light in place of the color's."""
REACH = 3.0
"""Standard deviations at which a soft splat ends; its weight there is 1.1 %."""


def points() -> bpy.types.Material:
    """Material of point clouds."""
    return ensure(bpy.data.materials, "Splat Points", lambda n: plain(n, "GEOMETRY"))


def ellipsoids() -> bpy.types.Material:
    """Opaque material of instances."""
    return ensure(bpy.data.materials, "Splat Ellipsoids", lambda n: plain(n, "INSTANCER"))


def soft() -> bpy.types.Material:
    """Material of instances of `REACH` standard deviations, with the falloff of the Gaussian."""
    return ensure(bpy.data.materials, "Splat Soft", _soft)


def _new(name: str) -> tuple[Graph, bpy.types.Material]:
    material = bpy.data.materials.new(name)
    compat.use_nodes(material)
    material.node_tree.nodes.clear()
    material.diffuse_color = (0.6, 0.6, 0.6, 1.0)
    return Graph(material.node_tree), material


def _attribute(graph: Graph, name: str, kind: str) -> bpy.types.Node:
    return graph.node("ShaderNodeAttribute", attribute_name=name, attribute_type=kind)


def _lit(graph: Graph, kind: str) -> Socket:
    """The color, or as the share of LIGHT a diffuse surface with that color under the captured
    light. Splats cast no shadows on each other."""
    color = _attribute(graph, COLOR, kind).outputs["Color"]
    captured = _attribute(graph, CAPTURED, kind).outputs["Vector"]
    normal = _attribute(graph, FACING, kind).outputs["Vector"]
    albedo = graph.vector("DIVIDE", color, captured)
    diffuse = graph.node("ShaderNodeBsdfDiffuse")
    graph.feed(diffuse.inputs["Color"], albedo)
    graph.feed(diffuse.inputs["Normal"], normal)
    emission = graph.call("ShaderNodeEmission", color)
    share = _attribute(graph, LIGHT, kind).outputs[2]
    lit = graph.call("ShaderNodeMixShader", share, emission, diffuse.outputs[0])
    is_shadow = graph.node("ShaderNodeLightPath").outputs["Is Shadow Ray"]
    clear = graph.math("MULTIPLY", is_shadow, graph.math("GREATER_THAN", share, 0.0))
    return graph.call("ShaderNodeMixShader", clear, lit, graph.call("ShaderNodeBsdfTransparent"))


def _finish(graph: Graph, shader: Socket) -> None:
    output = graph.node("ShaderNodeOutputMaterial")
    graph.feed(output.inputs["Surface"], shader)
    graph.arrange()


def plain(name: str, kind: str) -> bpy.types.Material:
    """A new material of the attribute's colour, for a geometry or its instancer."""
    graph, material = _new(name)
    _finish(graph, _lit(graph, kind))
    return material


def _soft(name: str) -> bpy.types.Material:
    """Alpha = opacity exp(-d²/2), with d the distance of the line of sight from the centre.

    The ellipsoid is a ball in its instance's space: with a point p of its surface and the line's
    direction v in that space, d² = p.p - (p.v)² in units of `REACH`.
    """
    graph, material = _new(name)
    material.surface_render_method = "DITHERED"  # sorted blending cannot work across instances
    surface = graph.node("ShaderNodeTexCoord").outputs["Object"]
    geometry = graph.node("ShaderNodeNewGeometry")
    to_instance = {"vector_type": "VECTOR", "convert_from": "WORLD", "convert_to": "OBJECT"}
    incoming = geometry.outputs["Incoming"]
    view = graph.call("ShaderNodeVectorTransform", incoming, **to_instance)
    view = graph.vector("NORMALIZE", view)
    along = graph.vector("DOT_PRODUCT", surface, view)
    squared = graph.vector("DOT_PRODUCT", surface, surface)
    distance = graph.math("SUBTRACT", squared, graph.math("MULTIPLY", along, along))
    weight = graph.math("EXPONENT", graph.math("MULTIPLY", distance, -0.5 * REACH * REACH))
    # The value socket is the third; its name depends on the version.
    opacity = _attribute(graph, OPACITY, "INSTANCER").outputs[2]
    front = graph.math("SUBTRACT", 1.0, geometry.outputs["Backfacing"])
    alpha = graph.math("MULTIPLY", graph.math("MULTIPLY", weight, opacity), front, clamp=True)
    parts = graph.call("ShaderNodeBsdfTransparent"), _lit(graph, "INSTANCER")
    _finish(graph, graph.call("ShaderNodeMixShader", alpha, *parts))
    return material
