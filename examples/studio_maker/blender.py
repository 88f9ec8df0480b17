"""Meshes, strands and materials in bpy, for Blender 4.5 and 5."""

import bpy
import numpy as np

MASK = "figure"
"""Shader output that every material of the figure sets to 1."""


def add_mesh(name, vertices, faces, material=None, *, uv=None, tint=None, smooth=True):
    """Add an object to the scene.

    Args:
        vertices: [V, 3]; faces: [F, 3 or 4].
        uv: [F, 3 or 4, 2] for each corner, or None.
        tint: [V, 3] linear colours in the attribute `tint`, or None.
    """
    faces = np.asarray(faces)
    f, n = faces.shape
    data = bpy.data.meshes.new(name)
    data.vertices.add(len(vertices))
    data.attributes["position"].data.foreach_set(
        "vector", np.ascontiguousarray(vertices, np.float32).ravel()
    )
    data.loops.add(f * n)
    data.loops.foreach_set("vertex_index", faces.astype(np.int32).ravel())
    data.polygons.add(f)
    data.polygons.foreach_set("loop_start", np.arange(0, f * n, n, dtype=np.int32))
    data.polygons.foreach_set("use_smooth", np.full(f, smooth))
    if uv is not None:
        layer = data.uv_layers.new(name="uv")
        layer.data.foreach_set("uv", np.ascontiguousarray(uv, np.float32).ravel())
    if tint is not None:
        rgba = np.concatenate([tint, np.ones((len(tint), 1))], 1).astype(np.float32)
        data.attributes.new("tint", "FLOAT_COLOR", "POINT").data.foreach_set("color", rgba.ravel())
    data.update(calc_edges=True)
    data.validate()
    item = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(item)
    if material is not None:
        data.materials.append(material)
    return item


def add_strands(name, points, radius, material):
    """Hair of strands with points [S, P, 3] and radii [S, P] in metres."""
    s, p = radius.shape
    data = bpy.data.hair_curves.new(name)
    data.add_curves([p] * s)
    data.attributes["position"].data.foreach_set(
        "vector", np.ascontiguousarray(points, np.float32).ravel()
    )
    width = data.attributes.get("radius") or data.attributes.new("radius", "FLOAT", "POINT")
    width.data.foreach_set("value", np.ascontiguousarray(radius, np.float32).ravel())
    item = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(item)
    data.materials.append(material)
    return item


def evaluated_vertices(item):
    """[V, 3] float64 world positions of an object's vertices after its modifiers."""
    shape = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    data = shape.data
    flat = np.empty(len(data.vertices) * 3, np.float32)
    data.attributes["position"].data.foreach_get("vector", flat)
    return flat.reshape(-1, 3).astype(np.float64)


def figure_surface(*, with_stage=False):
    """Triangles of everything in the mask as rendered: [V, 3] float64, metres, and [F, 3] int64.

    A strand is a tube of three sides, of its own radius. `with_stage`: the rest of the scene too.
    """
    graph = bpy.context.evaluated_depsgraph_get()
    points, triangles, count = [], [], 0
    for item in bpy.context.scene.objects:
        slots = getattr(item.data, "materials", None)
        nodes = slots[0].node_tree.nodes if slots else ()
        in_mask = any(getattr(node, "aov_name", "") == MASK for node in nodes)
        if not in_mask and not (with_stage and item.type == "MESH"):
            continue
        shape = item.evaluated_get(graph).data
        vertices, faces = tubes(shape) if item.type == "CURVES" else triangles_of(shape)
        place = np.array(item.matrix_world)
        points.append(vertices @ place[:3, :3].T + place[:3, 3])
        triangles.append(faces + count)
        count += len(vertices)
    return np.concatenate(points), np.concatenate(triangles)


def triangles_of(data):
    """[V, 3] float64 vertices of a mesh and [F, 3] int64 triangles of its faces."""
    data.calc_loop_triangles()
    flat = np.empty(3 * len(data.vertices), np.float32)
    data.attributes["position"].data.foreach_get("vector", flat)
    faces = np.empty(3 * len(data.loop_triangles), np.int32)
    data.loop_triangles.foreach_get("vertices", faces)
    return flat.reshape(-1, 3).astype(np.float64), faces.reshape(-1, 3).astype(np.int64)


def tubes(data, sides=3):
    """Vertices and triangles of tubes around strands that have equally many points."""
    strands = len(data.curves)
    flat = np.empty(3 * len(data.points), np.float32)
    data.attributes["position"].data.foreach_get("vector", flat)
    radius = np.empty(len(data.points), np.float32)
    data.attributes["radius"].data.foreach_get("value", radius)
    path = flat.reshape(strands, -1, 3).astype(np.float64)
    along = np.gradient(path, axis=1)
    along /= np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-12)
    across = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=-1)])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    turn = 2 * np.pi * np.arange(sides)[:, None] / sides
    around = across[:, :, None] * np.cos(turn) + np.cross(along, across)[:, :, None] * np.sin(turn)
    vertices = path[:, :, None] + radius.reshape(strands, -1, 1, 1) * around
    rows = np.arange(strands * path.shape[1] * sides).reshape(strands, -1, sides)
    a, b = rows[:, :-1], rows[:, 1:]
    c, d = np.roll(a, -1, axis=2), np.roll(b, -1, axis=2)
    faces = np.stack([a, c, b, b, c, d], axis=-1).reshape(-1, 3)
    return vertices.reshape(-1, 3), faces


def add_image(name, pixels):
    """Image from sRGB values [H, W, 3] in [0, 1], row 0 at the bottom (v = 0)."""
    h, w, _ = pixels.shape
    image = bpy.data.images.new(name, w, h, alpha=False)
    rgba = np.ones((h, w, 4), np.float32)
    rgba[..., :3] = pixels
    image.pixels.foreach_set(rgba.ravel())
    image.pack()
    return image


def material(name, *, color=(0.8, 0.8, 0.8), image=None, tint=False, in_mask=True, **inputs):
    """Principled material; its colour is constant, an image over `uv`, or the attribute `tint`.

    Further keyword arguments set inputs of the shader: sheen_weight=0.5 sets "Sheen Weight".
    """
    made = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0):
        made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    new, link = tree.nodes.new, tree.links.new
    output = new("ShaderNodeOutputMaterial")
    shader = new("ShaderNodeBsdfPrincipled")
    link(shader.outputs[0], output.inputs["Surface"])
    base = shader.inputs["Base Color"]
    base.default_value = (*color, 1)
    if image is not None:
        texture = new("ShaderNodeTexImage")
        texture.image = image
        link(texture.outputs["Color"], base)
    elif tint:
        attribute = new("ShaderNodeAttribute")
        attribute.attribute_name = "tint"
        link(attribute.outputs["Color"], base)
    for key, value in inputs.items():
        shader.inputs[key.replace("_", " ").title()].default_value = value
    if in_mask:
        mask = new("ShaderNodeOutputAOV")
        mask.aov_name = MASK
        mask.inputs["Value"].default_value = 1.0
    return made
