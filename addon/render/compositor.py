"""Compositor setup: scenes that render splats and world separately, and nodes that combine them."""

import bpy

from .. import compat
from ..interface import editable_check
from ..splats.objects import is_splats
from .composite_nodes import combine_node, insert, remove, show_passes
from .compositing_scene import MAIN_SCENE, SPLAT_SCENE
from .engine import ENGINE_BEFORE, NAME
from .holdout_meshes import holdouts_of
from .passes import MATTES

_FILM = "gs_film_transparent"
"""Custom property of a scene: whether its film was transparent before."""
_MADE, _ENGINE = "gs_film_made_transparent", "gs_engine_taken"
"""Custom properties of a scene: whether compositing has made its film transparent, and which engine
it has taken instead of that of the splats."""
WORLD_SCENE = "gs_world_scene"
"""Custom property of a scene: the scene that renders its world, where the film hides it."""
_WORLD_SAMPLES = 4
"""Of a world, which is smooth from pixel to pixel or nearly so."""
_EEVEE = "BLENDER_EEVEE", "BLENDER_EEVEE_NEXT"
"""Its names in Blender's versions."""
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
    """Make renders of a scene show its splat objects among its meshes, by depth.

    Makes a scene for the splats, or brings that of before up to date, and puts nodes between the
    render and whatever the compositor does with it. Everything else in the tree stays. The splats'
    own display is taken out of the meshes' render. A scene that the splats' engine renders gets the
    engine that it had before.

    Args:
        scene: With splats and a camera.
        transparent: Make the meshes' film transparent, so that their edges blend. A world that was
            seen is rendered by a scene of its own, behind everything.

    Returns:
        The scene that renders the splats.

    Raises:
        ValueError: nothing to composite, or no camera.
    """
    scene.view_layers[0].update()  # knows nothing yet of what a script has just added
    splats = [ob for ob in scene.objects if is_splats(ob)]
    if not splats:
        raise ValueError(f"Scene {scene.name} has no splat objects: import a splat PLY first.")
    if scene.camera is None:
        raise ValueError(f"Scene {scene.name} has no camera: add one first.")
    editable_check.check(*_changed(scene))
    if SPLAT_SCENE not in scene:
        scene[_FILM] = scene.render.film_transparent
    if scene.render.engine == NAME:
        _take_other_engine(scene)
        scene[_ENGINE] = scene.render.engine
    other = _apart(scene, SPLAT_SCENE, "Splats")
    _synchronise(scene, other, splats)
    for view_layer in scene.view_layers:
        view_layer.use_pass_z = True
    if scene.get(_MADE) and not transparent:
        scene.render.film_transparent = bool(scene[_FILM])
    scene[_MADE] = transparent
    seen = scene.world and any(layer.use_sky for layer in scene.view_layers)
    world = _world_scene(scene) if transparent and not scene[_FILM] and seen else None
    if world is None:
        _drop(scene, WORLD_SCENE)
    scene.render.use_compositing = True
    insert(compat.make_compositor_tree(scene), scene, other, world)
    rest(scene)
    return other


def _take_other_engine(scene: bpy.types.Scene) -> None:
    """The engine that a scene had before that of the splats, else EEVEE."""
    for name in (scene.get(ENGINE_BEFORE, ""), *_EEVEE):
        try:
            scene.render.engine = name
        except TypeError:  # its add-on is gone, or a version calls it otherwise
            continue
        return


def _changed(scene: bpy.types.Scene) -> list[bpy.types.ID]:
    """What is set up, and taken down: the scene, its nodes, and the splats' displays."""
    tree = compat.compositor_tree(scene)
    return [scene, *filter(None, (tree,)), *filter(is_splats, scene.objects)]


def _apart(scene: bpy.types.Scene, key: str, name: str) -> bpy.types.Scene:
    """A scene that renders something for another one."""
    other = scene.get(key)
    if not isinstance(other, bpy.types.Scene):
        other = bpy.data.scenes.new(f"{scene.name} {name}")
        scene[key] = other
        other[MAIN_SCENE] = scene
    # Blender draws no frame beyond these, whatever the frame of the scene that it is for.
    other.frame_start, other.frame_end = 0, other.bl_rna.properties["frame_end"].hard_max
    return other


def _world_scene(scene: bpy.types.Scene) -> bpy.types.Scene:
    """A scene without objects: the world as the scene's camera sees it."""
    other = _apart(scene, WORLD_SCENE, "World")
    other.render.film_transparent = False
    if hasattr(other, "cycles"):
        other.cycles.samples, other.cycles.use_denoising = _WORLD_SAMPLES, False
    if hasattr(other, "eevee"):
        other.eevee.taa_render_samples = _WORLD_SAMPLES
    _follow_world(scene, other)
    return other


def _follow_world(scene: bpy.types.Scene, other: bpy.types.Scene) -> None:
    """Give the world's scene world, engine and view; writes only what differs."""
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
    """Give the splats' scene the objects and view of the meshes' scene."""
    _link(scene, other)
    for ob in splats:
        for modifier in ob.modifiers:
            # Their picture comes from the other scene; points without faces show nothing here.
            if modifier.type == "NODES":
                modifier.show_render = False
    other.render.engine, other.world = NAME, None
    other.render.film_transparent = True
    _follow(scene, other)
    for name in ("antialias", "blur_samples"):
        setattr(other.gscore_render, name, getattr(scene.gscore_render, name))
    other.view_layers[0].use_pass_z = True
    _follow_layer(scene, other)


def _follow_layer(scene: bpy.types.Scene, other: bpy.types.Scene) -> None:
    """Give the splats' scene the mattes and the motion blur of the meshes' view layer; writes only
    what differs."""
    layer, own = scene.view_layers[0], other.view_layers[0]
    names = (*MATTES, "use_motion_blur")
    differing = [name for name in names if getattr(own, name) != getattr(layer, name)]
    for name in differing:
        setattr(own, name, getattr(layer, name))
    if differing:
        show_passes(scene, other)


def _link(scene: bpy.types.Scene, other: bpy.types.Scene) -> None:
    """Give the splats' scene the splats, and what is held out of the meshes' scene: it hides splats
    behind it."""
    wanted = [*filter(is_splats, scene.objects), *holdouts_of(scene)]
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
    used = {view.name: view.use for view in scene.render.stereo_views}
    for own in other.render.stereo_views:
        if own.use != (use := used.get(own.name, False)):  # users may take views away
            own.use = use
    _follow_curve(*(s.render.motion_blur_shutter_curve for s in (scene, other)))
    # Markers that change the camera: the render looks for them in the scene that it draws.
    cuts, own = (
        {(m.frame, m.camera) for m in s.timeline_markers if m.camera} for s in (scene, other)
    )
    if cuts != own:
        other.timeline_markers.clear()
        for frame, camera in cuts:
            other.timeline_markers.new(camera.name, frame=frame).camera = camera


def _follow_curve(curve: bpy.types.CurveMapping, other: bpy.types.CurveMapping) -> None:
    """Give a curve the points of another one; writes only where they differ."""
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
    """Once set up, a new camera or size of the meshes' scene is the others' at once."""
    other = scene.get(SPLAT_SCENE)
    if isinstance(other, bpy.types.Scene):
        _follow(scene, other)
        _follow_layer(scene, other)
        rest(scene)
    if isinstance(world := scene.get(WORLD_SCENE), bpy.types.Scene):
        _follow_world(scene, world)


def rest(scene: bpy.types.Scene) -> None:
    """Pass the render on as it is while the scene's own engine draws the splats, which would lie
    over themselves; its film is what it was then."""
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
    """Undo `set_up`: the nodes between the render and what follows, the splats' scene, and what it
    changed of displays and film. Everything else in the tree stays.

    Raises:
        ValueError: nothing was set up, or the nodes are linked.
    """
    others = [scene.get(key) for key in (SPLAT_SCENE, WORLD_SCENE)]
    others = [other for other in others if isinstance(other, bpy.types.Scene)]
    if combine_node(scene) is None and not others:
        raise ValueError(f"Scene {scene.name} has no compositing of splats to be removed.")
    editable_check.check(*_changed(scene))
    if (tree := compat.compositor_tree(scene)) is not None:
        remove(tree)
    for ob in filter(is_splats, scene.objects):
        for modifier in ob.modifiers:
            if modifier.type == "NODES":
                modifier.show_render = True
    scene.render.film_transparent = bool(scene.get(_FILM, scene.render.film_transparent))
    if scene.get(_ENGINE) == scene.render.engine:  # else the user has chosen another
        scene.render.engine = NAME
    for name in (SPLAT_SCENE, WORLD_SCENE):
        _drop(scene, name)
    for name in (_FILM, _MADE, _ENGINE):
        scene.pop(name, None)


def _drop(scene: bpy.types.Scene, key: str) -> None:
    """Remove a scene that renders something for another one, if there is one."""
    other = scene.get(key)
    scene.pop(key, None)
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
