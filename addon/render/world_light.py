"""Light of the splats on meshes: a world rendered from them, and a sun in their strongest light."""

from functools import partial
from pathlib import Path

import bpy
import numpy as np
from bpy.props import FloatProperty, IntProperty
from mathutils import Vector

from .. import compat, stored_paths
from ..interface import editable_check
from ..interface.base_operator import Condition
from ..interface.blocks import block_of
from ..interface.incremental_operator import IncrementalOperator
from ..process.incremental_tasks import Check, Steps, run_in_thread
from ..splats.objects import is_splats
from . import device, picture
from .color import world_light
from .compare import snapshot
from .engine import final_cache
from .light_probe import Light, LightProbe, probe, sky_irradiance, strongest_light
from .proxy import WALLS, dress, proxies_of
from .scene import Placed, sources
from .white_level import white_level

WORLD = "gs_splat_world"
"""Custom property of worlds that were rendered from splats."""
SUN_NAME = "Sun of Splats"
_SUN_WIDTH = 512
"""Width of the map in which the sun is searched, pixels: 0.7 degrees each."""
_SUN_TO_SKY = 3.0
"""Irradiance of an overexposed sun, in irradiances of the sky: that of a clear day, low sun."""
_BACKGROUND, _SPLATS = "Background", "Splats"


class _AtCursor(IncrementalOperator):
    """Base of operators that draw the splats around the 3D cursor."""

    needs = Condition(
        lambda context: any(is_splats(ob) for ob in context.scene.objects),
        "Import or train splats first",
    )

    near: FloatProperty(
        name="Clip Start",
        description="Splats nearer to the 3D cursor than this give no light; 0: a fiftieth of "
        "their median distance",
        default=0.0,
        min=0.0,
        unit="LENGTH",
    )

    def changes(self, context: bpy.types.Context) -> tuple[bpy.types.ID, ...]:
        """The scene."""
        return (context.scene,)

    def probe(self, context: bpy.types.Context, width: int) -> Steps[LightProbe]:
        """The light at the cursor."""
        scene = context.scene
        taken = snapshot(context.evaluated_depsgraph_get())
        next(taken)  # takes it
        place = np.array(scene.cursor.location, np.float64)
        options = picture.Options(
            antialias=scene.gscore_render.antialias, device=device.CHOICE.device()
        )
        try:
            placed = yield from taken
        finally:
            taken.close()
        work = partial(_probed, placed, place, width, self.near, options)
        return (yield from run_in_thread(work, "Drawing the splats around the 3D cursor"))


def _probed(
    placed: list[Placed],
    place: np.ndarray,
    width: int,
    near: float,
    options: picture.Options,
    check: Check,
) -> LightProbe:
    model = final_cache.model([one for one in placed if not one.holdout])
    return probe(model, place, width=width, near=near, options=options, stop=picture.stopped(check))


class WorldFromSplats(_AtCursor, bpy.types.Operator):
    """Light meshes by the splats: render a panorama of them at the 3D cursor and make it the
    scene's world, for light and reflections; the camera still sees the color of the former world"""

    bl_idname = "gscore.world_from_splats"
    bl_label = "World from Splats"

    width: IntProperty(
        name="Width",
        description="Width of the panorama in pixels; larger ones have sharper reflections",
        default=2048,
        min=64,
        max=16384,
        subtype="PIXEL",
    )

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Draw, then set the world."""
        uid, place = context.scene.session_uid, context.scene.cursor.location.copy()
        found = yield from self.probe(context, self.width - self.width % 2)
        gone = "The scene was removed."
        seen = world_light(block_of(bpy.data.scenes, uid, gone).world)[0]
        rest = np.linalg.solve(compat.rec709_to_scene(), seen)
        made = yield from run_in_thread(partial(_panorama, found, rest), "Making the world")
        pixels, covered, brightest = made
        scene = block_of(bpy.data.scenes, uid, gone)
        world = scene.world
        if world is None or WORLD not in world or not editable_check.keeps(world):
            world = bpy.data.worlds.new("Splats")
            world[WORLD] = True
            scene.world = world
        show(world, image_of(world, pixels), seen)
        _show_on_walls(world, place)
        for proxy in filter(editable_check.keeps, proxies_of(scene)):
            dress(scene, proxy)
        return (
            f"World {world.name} has the light of the splats at the 3D cursor; they cover "
            f"{covered:.0%} of the directions, the brightest has {brightest:.2g} times the light "
            "of white."
        )


def _panorama(found: LightProbe, rest: np.ndarray, check: Check) -> tuple[np.ndarray, float, float]:
    """Pixels [H, W, 4] float32 of a world, with the linear Rec. 709 color `rest` where there are no
    splats; the share of directions that these cover, and their brightest light."""
    check()
    pixels = np.ones((*found.alpha.shape, 4), np.float32)
    pixels[..., :3] = found.light + (1 - found.alpha[..., None]) * rest
    covered = float((found.alpha * found.solid_angles).sum() / (4 * np.pi))
    return pixels, covered, float(found.light.max())


class MatchSun(_AtCursor, bpy.types.Operator):
    """Add or turn a sun lamp to the direction of the strongest light that the splats show around
    the 3D cursor"""

    bl_idname = "gscore.match_sun"
    bl_label = "Match Sun"

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Draw, find the light, then set the lamp."""
        found = yield from self.probe(context, _SUN_WIDTH)
        light = strongest_light(found)
        if light is None:
            raise ValueError(
                "The splats show no strongest light: no direction around the 3D cursor is much "
                "brighter than the others. Move the cursor, or set a lamp by hand."
            )
        place = np.array(context.scene.cursor.location) + light.distance * light.direction
        white = yield from _white_at(context.evaluated_depsgraph_get(), place)
        clipped = light.is_clipped(white)
        lamp = _sun(context, sky_irradiance(found), light, clipped=clipped)
        height = np.degrees(np.arcsin(light.direction[2]))
        how = (
            "Photos are overexposed there, so its strength is an assumption: three times the sky."
            if clipped
            else "Its strength is that of the splats."
        )
        side = "above" if height >= 0 else "below"
        return f"{lamp.name} stands {abs(height):.0f} degrees {side} the horizon. {how}"


def image_of(world: bpy.types.World, pixels: np.ndarray) -> bpy.types.Image:
    """The packed image of a world's light, linear Rec. 709.

    Args:
        world: Gives the name; an image of it that was made before is replaced.
        pixels: [H, W, 4] float32, the bottom row first.
    """
    if (before := _image_in(world)) is not None:
        bpy.data.images.remove(before)
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(
        f"{world.name} Light", width, height, alpha=False, float_buffer=True
    )
    image.colorspace_settings.name = "Linear Rec.709"
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.pack()
    return image


def _image_in(world: bpy.types.World) -> bpy.types.Image | None:
    tree = compat.world_nodes(world)
    node = None if tree is None else tree.nodes.get(_SPLATS)
    return None if node is None else node.image


def show(world: bpy.types.World, image: bpy.types.Image, seen: np.ndarray) -> None:
    """Make the nodes of a world: the image lights, the camera sees one color.

    Args:
        world: All its nodes are replaced.
        image: Equirectangular.
        seen: Scene-linear color [3] of the background that cameras see.
    """
    tree = compat.make_world_nodes(world)
    tree.nodes.clear()

    def node(kind: str, x: float, y: float) -> bpy.types.ShaderNode:
        made = tree.nodes.new(kind)
        made.location = x, y
        return made

    background = node("ShaderNodeBackground", 0, 0)  # first: the engine shows its color
    background.name = background.label = _BACKGROUND
    background.inputs["Color"].default_value = (*map(float, seen), 1.0)
    texture, light = (
        node("ShaderNodeTexEnvironment", -300, -150),
        node("ShaderNodeBackground", 0, -150),
    )
    texture.name = texture.label = _SPLATS
    texture.image = image
    path, mix = node("ShaderNodeLightPath", 0, 350), node("ShaderNodeMixShader", 250, 0)
    output = node("ShaderNodeOutputWorld", 450, 0)
    for source, target in (
        (texture.outputs["Color"], light.inputs["Color"]),
        (path.outputs["Is Camera Ray"], mix.inputs[0]),
        (light.outputs[0], mix.inputs[1]),
        (background.outputs[0], mix.inputs[2]),
        (mix.outputs[0], output.inputs["Surface"]),
    ):
        tree.links.new(source, target)
    world.color = tuple(map(float, seen))


def _show_on_walls(world: bpy.types.World, place: Vector) -> None:
    """Make the material of proxies under a world: they shine as the panorama from `place` shows
    them, and cameras (of shadows) see a white surface."""
    material = world.get(WALLS)
    if material is None:
        material = world[WALLS] = bpy.data.materials.new(f"{world.name} Walls")
        material[WALLS] = True
    compat.use_nodes(material)
    tree = material.node_tree
    tree.nodes.clear()
    node = tree.nodes.new
    at, away, texture = (
        node("ShaderNodeNewGeometry"),
        node("ShaderNodeVectorMath"),
        node("ShaderNodeTexEnvironment"),
    )
    away.operation, away.inputs[1].default_value = "SUBTRACT", place
    texture.image = _image_in(world)
    light, surface = node("ShaderNodeEmission"), node("ShaderNodeBsdfDiffuse")
    path, mix, output = (
        node("ShaderNodeLightPath"),
        node("ShaderNodeMixShader"),
        node("ShaderNodeOutputMaterial"),
    )
    for source, target in (
        (at.outputs["Position"], away.inputs[0]),
        (away.outputs[0], texture.inputs["Vector"]),
        (texture.outputs["Color"], light.inputs["Color"]),
        (path.outputs["Is Camera Ray"], mix.inputs[0]),
        (light.outputs[0], mix.inputs[1]),
        (surface.outputs[0], mix.inputs[2]),
        (mix.outputs[0], output.inputs["Surface"]),
    ):
        tree.links.new(source, target)
    for number, made in enumerate((at, away, texture, light, surface, path, mix, output)):
        made.location = 200 * number, 0


def _white_at(depsgraph: bpy.types.Depsgraph, place: np.ndarray) -> Steps[float]:
    """The largest `white_level` of the runs of the visible splats at a world position [3]."""
    runs = []
    for source in sources(depsgraph):
        if run := stored_paths.read(source.ob.original, stored_paths.RUN):
            matrix = source.matrix
            runs.append((Path(run), np.linalg.pinv(matrix[:3, :3]) @ (place - matrix[:3, 3])))

    def found(check: Check) -> float:
        return max((white_level(run, own) for run, own in runs), default=1.0)

    return (yield from run_in_thread(found, "Reading exposures"))


def _sun(
    context: bpy.types.Context, sky: np.ndarray, light: Light, *, clipped: bool
) -> bpy.types.Object:
    """The active sun lamp, else the one made before, else a new one, with direction, angle, color
    and strength of a light; where photos are `clipped`, with an assumed strength."""
    scene, lamp = context.scene, context.view_layer.objects.active
    if not _is_sun(lamp):
        lamp = next((ob for ob in scene.objects if _is_sun(ob) and ob.get(WORLD)), None)
    if lamp is None:
        lamp = bpy.data.objects.new(SUN_NAME, bpy.data.lights.new(SUN_NAME, "SUN"))
        lamp[WORLD] = True
        scene.collection.objects.link(lamp)
        lamp.location = scene.cursor.location
    editable_check.check(lamp, lamp.data)
    irradiance = light.irradiance
    if clipped:
        irradiance = irradiance / max(irradiance.max(), 1e-9) * (_SUN_TO_SKY * sky.max())
    color = compat.rec709_to_scene() @ irradiance
    lamp.data.energy = float(color.max())
    lamp.data.color = tuple(color / max(color.max(), 1e-9))
    lamp.data.angle = light.angle
    turn = Vector(light.direction).to_track_quat("Z", "Y")
    matrix = turn.to_matrix().to_4x4()
    matrix.translation = lamp.matrix_world.translation
    lamp.matrix_world = matrix
    return lamp


def _is_sun(ob: bpy.types.Object | None) -> bool:
    return ob is not None and ob.type == "LIGHT" and ob.data.type == "SUN"
