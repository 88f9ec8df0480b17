"""Compositor setup: scenes that render splats and world separately, and nodes that combine them."""

import bpy

from .. import compat
from ..interface import editable_check
from ..splats.objects import is_proxy, is_relit, is_splats
from . import shadow_scene
from .composite_nodes import Others, combine_node, insert, remove, show_passes
from .compositing_scene import MAIN_SCENE, SPLAT_SCENE, helper
from .engine import ENGINE_BEFORE, NAME
from .holdout_meshes import holdouts_of
from .passes import MATTES
from .proxy import proxies_of
from .shadow_scene import SHADOW_SCENE

_FILM = "gs_film_transparent"
"""Custom property of a scene: whether its film was transparent before."""
_MADE, _ENGINE = "gs_film_made_transparent", "gs_engine_taken"
"""Custom properties of a scene: whether compositing has made its film transparent, and the engine
that compositing has set instead of Gaussian Splats."""
WORLD_SCENE = "gs_world_scene"
"""Custom property of a scene: the scene that renders its world, if the film is transparent."""
_OTHERS = SPLAT_SCENE, WORLD_SCENE, SHADOW_SCENE
"""Custom properties of a scene: the scenes that compositing has made."""
_WORLD_SAMPLES = 4
"""Samples of a world; few are enough, because it is nearly smooth from pixel to pixel."""
_EEVEE = "BLENDER_EEVEE", "BLENDER_EEVEE_NEXT"
"""Names of EEVEE in the versions of Blender."""
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
    "frame_map_old",
    "frame_map_new",
    "use_multiview",
    "views_format",
)


def set_up(scene: bpy.types.Scene, *, transparent: bool = True) -> bpy.types.Scene:
    """Make renders of a scene combine its splat objects and meshes by depth.

    Makes or updates a scene for the splats, and inserts nodes directly after the render layers.
    Everything else in the tree stays. The splats' display is disabled in the meshes' render. A
    scene with the engine Gaussian Splats gets the engine that it had before.

    Args:
        scene: With splats and a camera.
        transparent: Make the meshes' film transparent, so that their edges blend. A visible world
            is rendered by a scene of its own, behind everything.

    Returns:
        The scene that renders the splats.

    Raises:
        ValueError: nothing to composite, no camera, or no Cycles for shadows on proxies.
    """
    _leave_original(scene)
    scene.view_layers[0].update()  # to include what a script has just added
    splats = [ob for ob in scene.objects if is_splats(ob)]
    if not splats:
        raise ValueError(f"Scene {scene.name} has no splat objects: import a splat PLY first.")
    if scene.camera is None:
        raise ValueError(f"Scene {scene.name} has no camera: add one first.")
    if proxies_of(scene) and not hasattr(scene, "cycles"):
        raise ValueError(
            "Enable the add-on Cycles Render Engine: it renders the shadows on splats."
        )
    editable_check.check(*_changed(scene))
    if _FILM not in scene:
        scene[_FILM] = scene.render.film_transparent
    if scene.render.engine == NAME:
        _take_other_engine(scene)
        scene[_ENGINE] = scene.render.engine
    other = _helper_scene(scene, SPLAT_SCENE, "Splats")
    _synchronise(scene, other, splats)
    for view_layer in scene.view_layers:
        view_layer.use_pass_z = True
    if scene.get(_MADE) and not transparent:
        scene.render.film_transparent = bool(scene[_FILM])
    scene[_MADE] = transparent
    visible = scene.world and any(layer.use_sky for layer in scene.view_layers)
    world = _world_scene(scene) if transparent and not scene[_FILM] and visible else None
    if world is None:
        _drop(scene, WORLD_SCENE)
    shadows = _shadow_scene(scene)
    scene.render.use_compositing = True
    insert(compat.make_compositor_tree(scene), scene, Others(other, world, shadows))
    rest(scene)
    return other


def _leave_original(scene: bpy.types.Scene) -> None:
    """Separate a copied scene from the helper scenes and nodes of its original."""
    shared = [key for key in _OTHERS if key in scene and helper(scene, key) is None]
    mains = {scene[key].get(MAIN_SCENE) for key in shared if scene[key] is not None}
    for key in shared:
        del scene[key]
    tree = compat.compositor_tree(scene)
    if not shared or tree is None:
        return
    if any(other != scene and compat.compositor_tree(other) == tree for other in bpy.data.scenes):
        tree = scene.compositing_node_group = tree.copy()
    for node in tree.nodes:
        if node.type == "R_LAYERS" and node.scene in mains:
            node.scene = scene


def _take_other_engine(scene: bpy.types.Scene) -> None:
    """Set the engine that a scene had before Gaussian Splats, else EEVEE."""
    for name in (scene.get(ENGINE_BEFORE, ""), *_EEVEE):
        try:
            scene.render.engine = name
        except TypeError:  # its add-on is gone, or this version has another name
            continue
        return


def _changed(scene: bpy.types.Scene) -> list[bpy.types.ID]:
    """Data that compositing changes: the scene, its nodes, and the splat objects."""
    tree = compat.compositor_tree(scene)
    return [scene, *filter(None, (tree,)), *filter(is_splats, scene.objects)]


def _helper_scene(scene: bpy.types.Scene, key: str, name: str) -> bpy.types.Scene:
    """The scene that renders splats, world or shadows of a main scene; made if missing."""
    other = helper(scene, key)
    if other is None:
        other = bpy.data.scenes.new(f"{scene.name} {name}")
        scene[key] = other
        other[MAIN_SCENE] = scene
    # Blender renders no frame outside this range, whatever the frame of the main scene.
    other.frame_start, other.frame_end = 0, other.bl_rna.properties["frame_end"].hard_max
    return other


def _shadow_scene(scene: bpy.types.Scene) -> bpy.types.Scene | None:
    """The scene of the shadows on a scene's splats; None, and removed, without proxies."""
    if not proxies_of(scene):
        _drop(scene, SHADOW_SCENE)
        return None
    other = _helper_scene(scene, SHADOW_SCENE, "Shadows")
    _follow(scene, other)
    shadow_scene.synchronise(scene, other)
    return other


def _world_scene(scene: bpy.types.Scene) -> bpy.types.Scene:
    """A scene without objects: the world from the scene's camera."""
    other = _helper_scene(scene, WORLD_SCENE, "World")
    other.render.film_transparent = False
    if hasattr(other, "cycles"):
        other.cycles.samples, other.cycles.use_denoising = _WORLD_SAMPLES, False
    if hasattr(other, "eevee"):
        other.eevee.taa_render_samples = _WORLD_SAMPLES
    _follow_world(scene, other)
    return other


def _follow_world(scene: bpy.types.Scene, other: bpy.types.Scene) -> None:
    """Copy world, engine and view to the world's scene; writes only differences."""
    _follow(scene, other)
    if other.world != scene.world:
        other.world = scene.world
    if scene.render.engine not in (NAME, other.render.engine):
        other.render.engine = scene.render.engine
    cycles = getattr(scene, "cycles", None)
    if cycles is not None and other.cycles.film_exposure != cycles.film_exposure:
        other.cycles.film_exposure = cycles.film_exposure


def _synchronise(
    scene: bpy.types.Scene, other: bpy.types.Scene, splats: list[bpy.types.Object]
) -> None:
    """Copy objects and view of the meshes' scene to the splats' scene."""
    _link(scene, other)
    for ob in splats:
        for modifier in ob.modifiers:
            # The other scene renders them; without the modifier points render nothing here.
            if modifier.type == "NODES":
                modifier.show_render = False
    other.render.engine, other.world = NAME, None
    other.render.film_transparent = True
    _follow(scene, other)
    for name in ("antialias", "blur_samples", "splat_index"):
        setattr(other.gscore_render, name, getattr(scene.gscore_render, name))
    other.view_layers[0].use_pass_z = True
    _follow_layer(scene, other)


def _follow_layer(scene: bpy.types.Scene, other: bpy.types.Scene) -> None:
    """Copy mattes and motion blur of the meshes' view layer to the splats' scene; writes only
    differences."""
    layer, own = scene.view_layers[0], other.view_layers[0]
    names = (*MATTES, "use_motion_blur")
    differing = [name for name in names if getattr(own, name) != getattr(layer, name)]
    for name in differing:
        setattr(own, name, getattr(layer, name))
    if differing:
        show_passes(scene, other)


def _link(scene: bpy.types.Scene, other: bpy.types.Scene) -> None:
    """Link the splats, the holdout meshes, which hide splats behind them, and lamps and proxies of
    relit splats to the splats' scene."""
    splats = [*filter(is_splats, scene.objects)]
    lighting = [ob for ob in scene.objects if ob.type == "LIGHT" or is_proxy(ob)]
    wanted = [*splats, *holdouts_of(scene), *(lighting if any(map(is_relit, splats)) else ())]
    wanted = list(dict.fromkeys(wanted))
    for ob in [o for o in other.collection.objects if o not in wanted]:
        other.collection.objects.unlink(ob)
    for ob in wanted:
        if other.collection.objects.get(ob.name) != ob:
            other.collection.objects.link(ob)


def _follow(scene: bpy.types.Scene, other: bpy.types.Scene) -> None:
    """Copy the view of the meshes' scene to the other scene; writes only differences."""
    if other.camera != scene.camera:
        other.camera = scene.camera
    for name in _SHARED:
        wanted = getattr(scene.render, name)
        if getattr(other.render, name) != wanted:
            setattr(other.render, name, wanted)
    used = {view.name: view.use for view in scene.render.stereo_views}
    for own in other.render.stereo_views:
        if own.use != (use := used.get(own.name, False)):  # users may remove views
            own.use = use
    _follow_curve(*(s.render.motion_blur_shutter_curve for s in (scene, other)))
    # Camera markers: a render reads those of the rendered scene only.
    cuts, own = (
        {(m.frame, m.camera) for m in s.timeline_markers if m.camera} for s in (scene, other)
    )
    if cuts != own:
        other.timeline_markers.clear()
        for frame, camera in cuts:
            other.timeline_markers.new(camera.name, frame=frame).camera = camera


def _follow_curve(curve: bpy.types.CurveMapping, other: bpy.types.CurveMapping) -> None:
    """Copy the points of `curve` to `other`; writes only differences."""
    wanted, own = (
        [(tuple(p.location), p.handle_type) for p in c.curves[0].points] for c in (curve, other)
    )
    if wanted == own:
        return
    points = other.curves[0].points
    for _ in range(len(own) - len(wanted)):
        points.remove(points[-1])
    for _ in range(len(wanted) - len(own)):
        points.new(1, 1)
    for point, (location, handle) in zip(points, wanted, strict=True):
        point.location, point.handle_type = location, handle
    other.update()


@bpy.app.handlers.persistent
def _after_update(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Copy changes of the meshes' scene, such as camera or size, to its other scenes."""
    if (other := helper(scene, SPLAT_SCENE)) is not None:
        _follow(scene, other)
        _follow_layer(scene, other)
        rest(scene)
    if (world := helper(scene, WORLD_SCENE)) is not None:
        _follow_world(scene, world)
    if (shadows := helper(scene, SHADOW_SCENE)) is not None:
        _follow(scene, shadows)
        shadow_scene.follow(scene, shadows)


def rest(scene: bpy.types.Scene) -> None:
    """Mute the node and restore the film while the scene's engine is Gaussian Splats, because the
    splats would be drawn twice."""
    node, rests = combine_node(scene), scene.render.engine == NAME
    if node is None or not editable_check.keeps(node.id_data) or not editable_check.keeps(scene):
        return
    if node.mute != rests:
        node.mute = rests
    if scene.get(_MADE) and scene.render.film_transparent != (
        film := not rests or bool(scene.get(_FILM))
    ):
        scene.render.film_transparent = film


def take_down(scene: bpy.types.Scene) -> None:
    """Undo `set_up`: nodes, the scenes of splats and world, and changes of displays and film.
    Everything else in the tree stays, and the displays of splats that another scene composites.

    Raises:
        ValueError: nothing was set up, or the nodes are linked.
    """
    _leave_original(scene)
    others = [other for key in _OTHERS if (other := helper(scene, key)) is not None]
    if combine_node(scene) is None and not others:
        raise ValueError(f"Scene {scene.name} has no compositing of splats to remove.")
    editable_check.check(*_changed(scene))
    if (tree := compat.compositor_tree(scene)) is not None:
        remove(tree)
    mains = (one for one in bpy.data.scenes if one != scene and helper(one, SPLAT_SCENE))
    shared = {ob for one in mains for ob in one.objects}
    for ob in filter(is_splats, set(scene.objects) - shared):
        for modifier in ob.modifiers:
            if modifier.type == "NODES":
                modifier.show_render = True
    scene.render.film_transparent = bool(scene.get(_FILM, scene.render.film_transparent))
    if scene.get(_ENGINE) == scene.render.engine:  # else the user has chosen another
        scene.render.engine = NAME
    for name in _OTHERS:
        _drop(scene, name)
    for name in (_FILM, _MADE, _ENGINE):
        scene.pop(name, None)


def _drop(scene: bpy.types.Scene, key: str) -> None:
    """Remove the scene that renders splats, world or shadows of a main scene, if it exists."""
    if key == SHADOW_SCENE:
        shadow_scene.drop(scene)
    other = helper(scene, key)
    scene.pop(key, None)
    if other is not None:
        bpy.data.scenes.remove(other)


HANDLERS = {"depsgraph_update_post": _after_update, "render_init": _after_update}
