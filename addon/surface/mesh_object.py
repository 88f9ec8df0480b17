"""Mesh object of a surface: triangles, colors at vertices and the material that shows them."""

import bpy
import numpy as np

from .. import compat
from ..core import SurfaceMesh

COLOR = "Color"
"""Name of the color attribute."""
_MATERIAL = "Splat Surface"


def filled(surface: SurfaceMesh, origin: np.ndarray | None, name: str) -> bpy.types.Mesh:
    """A mesh datablock in the coordinates of splats, owned by the caller.

    Args:
        surface: The mesh in the coordinates of the capture.
        origin: [3] float64, local origin of the splats; None: zero.
        name: Name of the datablock.
    """
    places = surface.vertices if origin is None else surface.vertices - origin
    mesh = bpy.data.meshes.new(name)
    count, triangles = len(places), len(surface.triangles)
    mesh.vertices.add(count)
    mesh.vertices.foreach_set("co", places.astype(np.float32).ravel())
    mesh.loops.add(3 * triangles)
    mesh.loops.foreach_set("vertex_index", surface.triangles.astype(np.int32).ravel())
    mesh.polygons.add(triangles)
    mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * triangles, 3, dtype=np.int32))
    rgba = np.ones((count, 4), np.float32)
    rgba[:, :3] = surface.colors
    colors = mesh.color_attributes.new(COLOR, "BYTE_COLOR", "POINT")
    colors.data.foreach_set("color_srgb", rgba.ravel())
    mesh.color_attributes.active_color = colors
    mesh.update(calc_edges=True)
    mesh.polygons.foreach_set("use_smooth", np.ones(triangles, bool))
    mesh.materials.append(material())
    return mesh


def material() -> bpy.types.Material:
    """The material of surfaces, made on first use: rough, in the colors of the vertices."""
    found = bpy.data.materials.get(_MATERIAL)
    if found is not None:
        return found
    made = bpy.data.materials.new(_MATERIAL)
    compat.use_nodes(made)
    tree = made.node_tree
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Roughness"].default_value = 1.0
    colors = tree.nodes.new("ShaderNodeVertexColor")
    colors.layer_name = COLOR
    colors.location = (shader.location[0] - 200, shader.location[1])
    tree.links.new(colors.outputs["Color"], shader.inputs["Base Color"])
    return made
