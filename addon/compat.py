"""Compatibility with Blender versions, by features instead of version numbers."""

import inspect
from typing import Any

import bpy
import gpu
import mathutils
import numpy as np
from gpu_extras.presets import draw_texture_2d

BLEND_RELATIVE: set[str] = (
    {"PATH_SUPPORTS_BLEND_RELATIVE"}
    if "is_path_supports_blend_relative" in bpy.types.Property.bl_rna.properties
    else set()
)
"""Property option for paths that may begin with `//`; implied in older versions."""


def matrix_to_numpy(matrix: Any) -> np.ndarray:
    """A mathutils Matrix as [4, 4] float64; numpy's own conversion gives float32 since 5.0."""
    return np.array([tuple(row) for row in matrix], np.float64)


def set_modifier_input(modifier: bpy.types.NodesModifier, name: str, value: Any) -> None:
    """Set the input socket `name` of a geometry nodes modifier, and update the modifier.

    Raises:
        KeyError: the node group has no such input.
    """
    for item in modifier.node_group.interface.items_tree:
        if item.item_type == "SOCKET" and item.in_out == "INPUT" and item.name == name:
            break
    else:
        raise KeyError(f"{modifier.node_group.name} has no input {name!r}.")
    if hasattr(modifier, "properties"):  # 5.2 and later
        getattr(modifier.properties.inputs, item.identifier).value = value
    else:
        modifier[item.identifier] = value
    modifier.id_data.update_tag()


def curves_of(block: bpy.types.ID) -> list[bpy.types.FCurve]:
    """F-curves of an animated datablock; since 4.4 datablocks may share an action."""
    animation = block.animation_data
    if not hasattr(animation, "action_slot"):
        return list(animation.action.fcurves)
    strip = animation.action.layers[0].strips[0]
    return list(strip.channelbag(animation.action_slot).fcurves)


HAS_GEOMETRY_SETS = hasattr(bpy.types.Object, "evaluated_geometry")
"""True if `evaluated_geometry` is supported: 4.5 and later."""


def evaluated_geometry(ob: bpy.types.Object) -> Any:
    """GeometrySet of an evaluated object; None before 4.5."""
    return ob.evaluated_geometry() if HAS_GEOMETRY_SETS else None


def use_nodes(material: bpy.types.Material) -> None:
    """Enable the node tree of a material; since 5.0 every material has one."""
    if material.node_tree is None:
        material.use_nodes = True


def remove_by_wildcard(node: bpy.types.Node) -> None:
    """Switch a Remove Named Attribute node to patterns; since 5.0 by an input socket."""
    if hasattr(node, "pattern_mode"):
        node.pattern_mode = "WILDCARD"
    else:
        node.inputs["Pattern Mode"].default_value = "Wildcard"


def panorama_settings(camera: bpy.types.Camera) -> Any:
    """Settings of a panoramic camera; before 5.0 those of Cycles, if it is enabled."""
    return camera if hasattr(camera, "panorama_type") else getattr(camera, "cycles", None)


def splat_cloud_type() -> str:
    """Node type of native splat point clouds; empty before 5.3, which has none."""
    kinds = bpy.types.PointCloud.bl_rna.properties.get("type")
    items = {} if kinds is None else kinds.enum_items
    there = "GAUSSIAN_SPLAT" in items and hasattr(bpy.types, "GeometryNodePointsSetType")
    return items["GAUSSIAN_SPLAT"].name if there else ""


def rec709_to_scene() -> np.ndarray:
    """[3, 3] float64 from linear Rec. 709 to the file's working space; files choose since 5.0."""
    units = (mathutils.Color(row) for row in np.eye(3))
    return np.array([tuple(c.from_rec709_linear_to_scene_linear()) for c in units], np.float64).T


def world_nodes(world: bpy.types.World) -> bpy.types.NodeTree | None:
    """Shader nodes of a world, if it has any; since 5.0 every world does."""
    tree = world.node_tree
    return tree if tree is not None and (bpy.app.version >= (5, 0) or world.use_nodes) else None


def make_world_nodes(world: bpy.types.World) -> bpy.types.NodeTree:
    """Shader nodes of a world, enabled."""
    if world_nodes(world) is None:
        world.use_nodes = True
    return world.node_tree


def compositor_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree | None:
    """A scene's compositor nodes, in use or not; since 5.0 they are a node group."""
    if hasattr(scene, "compositing_node_group"):
        return scene.compositing_node_group
    return scene.node_tree


def _pass_name(before: str, since: str) -> str:
    """Name of a pass in Cycles, before Blender 5.0 and since; then it is that of the panel."""
    older = "node_tree" in bpy.types.Scene.bl_rna.properties  # the compositor's, gone in 5.0
    return before if older else since


def index_pass_name() -> str:
    """Name of the object index pass."""
    return _pass_name("IndexOB", "Object Index")


def albedo_pass_name() -> str:
    """Name of the pass of diffuse colors."""
    return _pass_name("DiffCol", "Diffuse Color")


def make_compositor_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    """Compositor nodes of a scene, enabled; new ones pass the render through."""
    if not hasattr(scene, "compositing_node_group"):
        scene.use_nodes = True
        return scene.node_tree
    if scene.compositing_node_group is None:
        tree = bpy.data.node_groups.new(f"{scene.name} Compositing", "CompositorNodeTree")
        scene.compositing_node_group = tree
        layers = tree.nodes.new("CompositorNodeRLayers")
        layers.scene, layers.location = scene, (-600, 0)
        tree.links.new(layers.outputs["Image"], compositor_result(tree))
    return scene.compositing_node_group


def compositor_result(tree: bpy.types.NodeTree) -> bpy.types.NodeSocket:
    """Input socket of a compositor tree's output; the node is created if missing."""
    if hasattr(bpy.types, "CompositorNodeComposite"):
        found = next((n for n in tree.nodes if n.type == "COMPOSITE"), None)
        node = found or tree.nodes.new("CompositorNodeComposite")
        return node.inputs["Image"]
    outputs = [i for i in tree.interface.items_tree if getattr(i, "in_out", "") == "OUTPUT"]
    if not outputs:
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    found = next((n for n in tree.nodes if n.type == "GROUP_OUTPUT"), None)
    return (found or tree.nodes.new("NodeGroupOutput")).inputs[0]


def new_math_node(tree: bpy.types.NodeTree) -> bpy.types.Node:
    """A math node in a compositor tree; since 5.0 the shader one."""
    compositing = hasattr(bpy.types, "CompositorNodeMath")
    return tree.nodes.new("CompositorNodeMath" if compositing else "ShaderNodeMath")


def new_dilate_node(tree: bpy.types.NodeTree, pixels: int) -> bpy.types.Node:
    """A node that dilates a mask by `pixels`; since 5.0 set by a socket."""
    node = tree.nodes.new("CompositorNodeDilateErode")
    if hasattr(node, "distance"):
        node.distance = pixels
    else:
        node.inputs["Size"].default_value = pixels
    return node


def tool_settings(context: bpy.types.Context) -> bpy.types.ToolSettings:
    """Tool settings of the scene. `context.tool_settings` in Blender 4.2 would keep the scene as
    its owner: after the next file load its members, e.g. the window, point to freed memory."""
    return context.scene.tool_settings


_DECLARES_DEPTH = hasattr(gpu.types.GPUShaderCreateInfo, "depth_write")


def shaders_write_depth() -> bool:
    """True if shaders may write depth, which OpenGL does undeclared. Call while drawing."""
    return _DECLARES_DEPTH or gpu.platform.backend_type_get() == "OPENGL"


def blends_float32() -> bool:
    """True if float32 RGBA can be blended, which Apple GPUs cannot. Call while drawing."""
    return gpu.platform.backend_type_get() != "METAL"


def draws_into_views() -> bool:
    """True if the framebuffer bound before a 3D view is drawn is still its target afterwards.
    Verified for these two backends; Metal is untested. Call while drawing."""
    return gpu.platform.backend_type_get() in {"OPENGL", "VULKAN"}


def declare_depth(info: gpu.types.GPUShaderCreateInfo) -> None:
    """Declare that a shader writes `gl_FragDepth`."""
    if _DECLARES_DEPTH:
        info.depth_write("ANY")


TEXTURES_ARE_ENCODED = (
    "is_scene_linear_with_rec709_srgb_target" in inspect.signature(draw_texture_2d).parameters
)
"""True if `draw_texture_2d` reads values as encoded for an encoded target; else as linear."""
