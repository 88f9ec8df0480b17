"""Splats, cameras and pictures for the tests of rendering."""

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from addon import compat
from addon.core import Rendered, Splats, render
from addon.render.engine import final_cache
from addon.render.model import Model
from addon.render.scene import place, sources
from addon.splats import objects

SH_C0 = 0.28209479177387814


def blob(
    count: int = 400, *, center: tuple[float, ...] = (0, 0, 0), size: float = 0.6, seed: int = 0
) -> Splats:
    """Random coloured splats around a point, degree 2."""
    rng = np.random.default_rng(seed)
    return Splats(
        means=(rng.normal(size=(count, 3)) * size / 2 + center).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        scales=rng.uniform(-4.0, -2.2, (count, 3)).astype(np.float32),
        opacities=rng.uniform(-1, 4, count).astype(np.float32),
        sh0=rng.normal(size=(count, 1, 3)).astype(np.float32),
        shN=(rng.normal(size=(count, 8, 3)) * 0.3).astype(np.float32),
    )


def veil(count: int = 500) -> Splats:
    """Large faint splats: every pixel blends all of them, so that big pictures take seconds."""
    splats = blob(count)
    fields = {n: getattr(splats, n) for n in ("means", "quats", "sh0", "shN")}
    return Splats(**fields, scales=splats.scales + 3, opacities=splats.opacities * 0 - 4)


def beads(rest: int) -> Splats:
    """Nine separate opaque balls with strongly view-dependent colours."""
    rng = np.random.default_rng(rest)
    x, y = np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0])
    means = np.stack([x.ravel(), y.ravel(), rng.uniform(-0.3, 0.3, 9)], axis=1)
    return Splats(
        means=means.astype(np.float32),
        quats=np.tile([1, 0, 0, 0], (9, 1)).astype(np.float32),
        scales=np.full((9, 3), np.log(0.1), np.float32),
        opacities=np.full(9, 8, np.float32),
        sh0=(rng.normal(size=(9, 1, 3)) * 0.3).astype(np.float32),
        shN=(rng.normal(size=(9, rest, 3)) * 0.4).astype(np.float32),
    )


def wall(
    z: float, color: tuple[float, float, float], *, half: float = 1.0, along: int = 41
) -> Splats:
    """A dense opaque square of one sRGB colour across the z axis, of `along` splats a side."""
    side = np.linspace(-half, half, along)
    x, y = np.meshgrid(side, side)
    n, size = x.size, 2 / (along - 1)
    sh0 = np.tile((np.array(color) - 0.5) / SH_C0, (n, 1))[:, None]
    return Splats(
        means=np.stack([x.ravel(), y.ravel(), np.full(n, z)], 1).astype(np.float32),
        quats=np.tile([1, 0, 0, 0], (n, 1)).astype(np.float32),
        scales=np.tile(np.log([size, size, 0.001]), (n, 1)).astype(np.float32),
        opacities=np.full(n, 6, np.float32),
        sh0=sh0.astype(np.float32),
        shN=np.zeros((n, 0, 3), np.float32),
    )


def prepare(
    scene: bpy.types.Scene, size: tuple[int, int] = (90, 70), light: float = 0.0
) -> bpy.types.Object:
    """Set the engine, a grey world, and a camera 4 units up the z axis that looks down; return
    it."""
    scene.render.engine = "GSCORE_SPLATS"
    scene.view_settings.view_transform = "Standard"
    scene.render.dither_intensity = 0.0
    scene.render.resolution_x, scene.render.resolution_y = size
    world = bpy.data.worlds.new("World")
    world.color = (light,) * 3
    tree = compat.world_nodes(world)
    if tree is not None:
        tree.nodes["Background"].inputs[0].default_value = (light, light, light, 1)
    scene.world = world
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    camera.location = (0, 0, 4)
    scene.camera = camera
    bpy.context.view_layer.update()
    return camera


def add(scene: bpy.types.Scene, splats: Splats, name: str = "splats") -> bpy.types.Object:
    """Add a splat object to the scene."""
    return objects.create(splats, name, collection=scene.collection)


def model_of(depsgraph: bpy.types.Depsgraph) -> Model:
    """Model of all visible splats of a depsgraph."""
    return final_cache.model([place(source) for source in sources(depsgraph)])


def moving(ob: bpy.types.Object, pace: float) -> None:
    """Animate an object along x, with its own position at frame 5."""
    middle = ob.location.x
    for frame in (0, 10):
        ob.location.x = middle + pace * (frame - 5)
        ob.keyframe_insert("location", frame=frame)
    for curve in curves(ob):
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"


def curves(ob: bpy.types.Object) -> list:
    """The F-curves of an object's action. Since 4.4 they are in layers, and `fcurves` has only
    those of the first user."""
    action = ob.animation_data.action
    if not hasattr(action, "layers"):
        return list(action.fcurves)
    return [c for s in action.layers[0].strips for bag in s.channelbags for c in bag.fcurves]


def truth(camera: bpy.types.Object, splats: Splats, size: tuple[int, int], **options) -> Rendered:
    """Picture by gscore.render for a perspective camera without shift, with K by the textbook."""
    width, height = size
    data = camera.data
    focal = data.lens / data.sensor_width * max(size)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    pose = np.array([tuple(row) for row in camera.matrix_world], np.float64)
    viewmat = np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(pose)
    return render(splats, K, viewmat, width, height, near=data.clip_start, **options)


def read_image(path: Path) -> np.ndarray:
    """Stored values of a picture file, [H, W, C] float32, the top row first."""
    image = bpy.data.images.load(str(path), check_existing=False)
    pixels = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    shaped = pixels.reshape(image.size[1], image.size[0], image.channels)[::-1].copy()
    bpy.data.images.remove(image)
    return shaped


def render_file(path: Path, kind: str = "PNG", mode: str = "RGB") -> np.ndarray:
    """Render to a file, and return its pixels."""
    render_settings = bpy.context.scene.render
    settings = render_settings.image_settings
    settings.file_format, settings.color_mode = kind, mode
    settings.color_depth = "8" if kind == "PNG" else "32"
    render_settings.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return read_image(path)


def render_exr(folder: Path, name: str = "a") -> np.ndarray:
    """Render as scene-linear float32 RGBA."""
    return render_file(folder / f"{name}.exr", "OPEN_EXR", "RGBA")


def render_pass(scene: bpy.types.Scene, folder: Path, name: str) -> np.ndarray:
    """A pass via the compositor, [H, W]."""
    tree = compat.make_compositor_tree(scene)
    layers = next(n for n in tree.nodes if n.type == "R_LAYERS")
    tree.links.new(layers.outputs[name], compat.compositor_result(tree))
    scene.render.use_compositing = True
    return render_exr(folder, name)[..., 0]


def error_of(action: Callable[[], object]) -> str:
    """Message of a render or operator that must fail."""
    try:
        action()
    except RuntimeError as error:
        return str(error)
    raise AssertionError("no error was reported")
