"""Splats among meshes: a second scene that renders the splats, and nodes that combine by depth."""

import bpy

from .. import compat
from ..interface import writable
from ..splats.objects import is_splats
from .apart import MAIN_SCENE, SPLAT_SCENE
from .engine import NAME
from .held_meshes import held_by

_FILM = "gs_film_transparent"
"""Custom property of a scene: whether its film was transparent before."""
LAYER_NODE, COMBINE_NODE = "GS Splats", "GS Combine by Depth"
"""Names of the nodes in the scene's tree."""
GROUP = "Combine by Depth"
_SHARED = (
    "resolution_x",
    "resolution_y",
    "resolution_percentage",
    "pixel_aspect_x",
    "pixel_aspect_y",
    "fps",
    "fps_base",
    "use_border",
    "use_crop_to_border",
    "border_min_x",
    "border_max_x",
    "border_min_y",
    "border_max_y",
    "use_motion_blur",
    "motion_blur_shutter",
    "motion_blur_position",
    "use_multiview",
)


def set_up(scene: bpy.types.Scene, *, transparent: bool = True) -> bpy.types.Scene:
    """Make renders of a scene show its splat objects among its meshes, by depth.

    Makes a scene for the splats, or brings that of before up to date, and puts two nodes between
    the render and whatever the compositor does with it. Everything else in the tree stays. The
    splats' own display is taken out of the meshes' render.

    Args:
        scene: Rendered by an engine for meshes.
        transparent: Make the meshes' film transparent, so that their edges blend.

    Returns:
        The scene that renders the splats.

    Raises:
        ValueError: nothing to composite, or the scene is rendered by the splats' engine.
    """
    splats = [ob for ob in scene.objects if is_splats(ob)]
    if not splats:
        raise ValueError(f"Scene {scene.name} has no splat objects: import a splat PLY first.")
    if scene.render.engine == NAME:
        raise ValueError(
            f"Scene {scene.name} is rendered by Gaussian Splats, which draws no meshes: set its "
            f"render engine to Cycles or EEVEE first."
        )
    if scene.camera is None:
        raise ValueError(f"Scene {scene.name} has no camera: add one first.")
    writable.check(*_changed(scene))
    if SPLAT_SCENE not in scene:
        scene[_FILM] = scene.render.film_transparent
    other = _splat_scene(scene)
    _synchronise(scene, other, splats)
    for view_layer in scene.view_layers:
        view_layer.use_pass_z = True
    if transparent:
        scene.render.film_transparent = True
    scene.render.use_compositing = True
    _insert(compat.make_compositor_tree(scene), scene, other)
    return other


def _changed(scene: bpy.types.Scene) -> list[bpy.types.ID]:
    """What is set up, and taken down: the scene, its nodes, and the splats' displays."""
    tree = compat.compositor_tree(scene)
    return [scene, *filter(None, (tree,)), *filter(is_splats, scene.objects)]


def _splat_scene(scene: bpy.types.Scene) -> bpy.types.Scene:
    other = scene.get(SPLAT_SCENE)
    if not isinstance(other, bpy.types.Scene):
        other = bpy.data.scenes.new(f"{scene.name} Splats")
        scene[SPLAT_SCENE] = other
        other[MAIN_SCENE] = scene
    return other


def _synchronise(
    scene: bpy.types.Scene, other: bpy.types.Scene, splats: list[bpy.types.Object]
) -> None:
    """Give the splats' scene the objects and view of the meshes' scene."""
    _link(scene, other)
    for ob in splats:
        for modifier in ob.modifiers:
            # Their picture comes from the other scene; points without faces show nothing here.
            if modifier.type == "NODES":
                modifier.show_render = False
    other.render.engine, other.world = NAME, None
    other.render.film_transparent = True
    # Blender draws no frame beyond these, whatever the frame of the meshes' scene.
    other.frame_start, other.frame_end = 0, other.bl_rna.properties["frame_end"].hard_max
    _follow(scene, other)
    for name in ("antialias", "blur_samples"):
        setattr(other.gscore_render, name, getattr(scene.gscore_render, name))
    other.view_layers[0].use_pass_z = True


def _link(scene: bpy.types.Scene, other: bpy.types.Scene) -> None:
    """Give the splats' scene the splats, and what is held out of the meshes' scene: it hides splats
    behind it."""
    wanted = [*filter(is_splats, scene.objects), *held_by(scene)]
    for ob in [o for o in other.collection.objects if o not in wanted]:
        other.collection.objects.unlink(ob)
    for ob in wanted:
        if other.collection.objects.get(ob.name) != ob:
            other.collection.objects.link(ob)


def _follow(scene: bpy.types.Scene, other: bpy.types.Scene) -> None:
    """Give the splats' scene the view of the meshes' scene; writes only what differs."""
    if other.camera != scene.camera:
        other.camera = scene.camera
    for name in _SHARED:
        wanted = getattr(scene.render, name)
        if getattr(other.render, name) != wanted:
            setattr(other.render, name, wanted)
    # Markers that change the camera: the render looks for them in the scene that it draws.
    cuts, own = (
        {(m.frame, m.camera) for m in s.timeline_markers if m.camera} for s in (scene, other)
    )
    if cuts != own:
        other.timeline_markers.clear()
        for frame, camera in cuts:
            other.timeline_markers.new(camera.name, frame=frame).camera = camera


@bpy.app.handlers.persistent
def _after_update(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Once set up, a new camera or size of the meshes' scene is the splats' at once."""
    other = scene.get(SPLAT_SCENE)
    if isinstance(other, bpy.types.Scene):
        _follow(scene, other)
        rest(scene)


def combine_node(scene: bpy.types.Scene) -> bpy.types.Node | None:
    """The node that puts a scene's splats among its meshes, where that was set up."""
    tree = compat.compositor_tree(scene)
    return None if tree is None else tree.nodes.get(COMBINE_NODE)


def rest(scene: bpy.types.Scene) -> None:
    """Pass the render on as it is while the scene's own engine draws the splats, which would lie
    over themselves."""
    node, wanted = combine_node(scene), scene.render.engine == NAME
    if node is not None and node.mute != wanted and writable.keeps(node.id_data):
        node.mute = wanted


def take_down(scene: bpy.types.Scene) -> None:
    """Undo `set_up`: the nodes between the render and what follows, the splats' scene, and what it
    changed of displays and film. Everything else in the tree stays.

    Raises:
        ValueError: nothing was set up, or the nodes are linked.
    """
    node, other = combine_node(scene), scene.get(SPLAT_SCENE)
    if node is None and not isinstance(other, bpy.types.Scene):
        raise ValueError(f"Scene {scene.name} has no compositing of splats to be removed.")
    writable.check(*_changed(scene))
    tree = compat.compositor_tree(scene)
    if node is not None:
        sources = [link.from_socket for link in node.inputs[0].links]
        for target in [link.to_socket for link in node.outputs[0].links]:
            for source in sources:
                tree.links.new(source, target)
        tree.nodes.remove(node)
    if tree is not None and (layers := tree.nodes.get(LAYER_NODE)) is not None:
        tree.nodes.remove(layers)
    for ob in filter(is_splats, scene.objects):
        for modifier in ob.modifiers:
            if modifier.type == "NODES":
                modifier.show_render = True
    scene.render.film_transparent = bool(scene.get(_FILM, scene.render.film_transparent))
    for name in (SPLAT_SCENE, _FILM):
        scene.pop(name, None)
    if isinstance(other, bpy.types.Scene):
        bpy.data.scenes.remove(other)


def on_register() -> None:
    """Follow changes of scenes that were set up."""
    bpy.app.handlers.depsgraph_update_post.append(_after_update)
    bpy.app.handlers.render_init.append(_after_update)


def on_unregister() -> None:
    """Stop following."""
    bpy.app.handlers.render_init.remove(_after_update)
    bpy.app.handlers.depsgraph_update_post.remove(_after_update)


def _insert(tree: bpy.types.NodeTree, scene: bpy.types.Scene, other: bpy.types.Scene) -> None:
    """Put the nodes behind the scene's render layers, unless they are there."""
    layers = tree.nodes.get(LAYER_NODE)
    if layers is not None and tree.nodes.get(COMBINE_NODE) is not None:
        layers.scene = other
        return
    meshes = _render_layers(tree, scene)
    layers = layers or tree.nodes.new("CompositorNodeRLayers")
    layers.name = layers.label = LAYER_NODE
    layers.scene, layers.location = other, (meshes.location.x, meshes.location.y - 420)
    combine = tree.nodes.new("CompositorNodeGroup")
    combine.name = combine.label = COMBINE_NODE
    combine.node_tree = _group()
    combine.location = (meshes.location.x + 300, meshes.location.y)
    followers = [link.to_socket for link in meshes.outputs["Image"].links]
    for socket in followers:
        tree.links.new(combine.outputs[0], socket)
    for i, output in enumerate((meshes, layers)):
        tree.links.new(output.outputs["Image"], combine.inputs[2 * i])
        tree.links.new(output.outputs["Depth"], combine.inputs[2 * i + 1])
    if not followers:
        tree.links.new(combine.outputs[0], compat.compositor_result(tree))


def _render_layers(tree: bpy.types.NodeTree, scene: bpy.types.Scene) -> bpy.types.Node:
    """The node that brings the scene's own render into the tree."""
    for node in tree.nodes:
        if node.type == "R_LAYERS" and node.scene == scene and node.name != LAYER_NODE:
            return node
    node = tree.nodes.new("CompositorNodeRLayers")
    node.scene = scene
    return node


def _group() -> bpy.types.NodeTree:
    """Two premultiplied pictures with depths to one: at each pixel the nearer one over the other.

    Blender's own Z Combine multiplies colours by alpha once more, so it is not used. Depths know no
    part of a pixel: where meshes and splats meet, the edge is smoothed.
    """
    tree = bpy.data.node_groups.get(GROUP)
    if tree is not None and tree.bl_idname == "CompositorNodeTree":
        return tree
    tree = bpy.data.node_groups.new(GROUP, "CompositorNodeTree")
    for name in ("Meshes", "Splats"):
        tree.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketColor")
        tree.interface.new_socket(f"{name} Depth", in_out="INPUT", socket_type="NodeSocketFloat")
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    given, result = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    given.location, result.location = (-1000, 0), (400, 0)
    meshes, mesh_depth, splats, splat_depth = given.outputs[:4]
    nearer = _compare(tree, "LESS_THAN", splat_depth, mesh_depth, (-800, -200))
    smooth = tree.nodes.new("CompositorNodeAntiAliasing")
    smooth.location = (-600, -200)
    tree.links.new(nearer, smooth.inputs[0])
    before = smooth.outputs[0]
    behind = _compare(tree, "SUBTRACT", None, before, (-400, -200))
    far = _over(tree, None, splats, behind, (-200, 0))
    middle = _over(tree, far, meshes, None, (0, 0))
    near = _over(tree, middle, splats, before, (200, 0))
    tree.links.new(near, result.inputs[0])
    return tree


def _compare(
    tree: bpy.types.NodeTree,
    operation: str,
    first: bpy.types.NodeSocket | None,
    second: bpy.types.NodeSocket,
    location: tuple[int, int],
) -> bpy.types.NodeSocket:
    """A math node; without `first`, that is 1."""
    node = compat.new_math_node(tree)
    node.operation, node.location = operation, location
    if first is None:
        node.inputs[0].default_value = 1.0
    else:
        tree.links.new(first, node.inputs[0])
    tree.links.new(second, node.inputs[1])
    return node.outputs[0]


def _over(
    tree: bpy.types.NodeTree,
    below: bpy.types.NodeSocket | None,
    above: bpy.types.NodeSocket,
    factor: bpy.types.NodeSocket | None,
    location: tuple[int, int],
) -> bpy.types.NodeSocket:
    """`above` times `factor` over `below`; without them, 1 and nothing."""
    node = tree.nodes.new("CompositorNodeAlphaOver")
    node.location = location
    sockets = compat.alpha_over_sockets(node)
    sockets["below"].default_value = (0, 0, 0, 0)
    sockets["factor"].default_value = 1.0
    for name, socket in (("below", below), ("above", above), ("factor", factor)):
        if socket is not None:
            tree.links.new(socket, sockets[name])
    return node.outputs[0]
