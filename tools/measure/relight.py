"""Relit splats beside the truth: a scene that Cycles renders under two lights, trained under one.

python tools/measure/relight.py WORK [--proxy]

Renders 27 photos under light A and 6 pictures under light B, trains splats from the photos,
relights them in Blender and prints the errors of the relit and of the unlit splats against the
pictures. Run it with the Python that has bpy; GSCORE_TRAINER_PYTHON trains.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np

SIZE = 200
LIGHTS = {
    "A": ((-0.5, 0.55, 0.0), 3.0, (1.0, 0.95, 0.85), 0.35),
    "B": ((0.6, -0.7, 0.9), 3.5, (1.0, 0.7, 0.45), 0.15),
}
"""Rotation, strength and color of the sun, and the level of the world."""


def material(name: str, color: tuple[float, float, float], checks: float = 0.0):
    """A diffuse material, plain or a checkerboard with a darker color."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
    out = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs[0], out.inputs["Surface"])
    shader.inputs["Color"].default_value = (*color, 1)
    if checks:
        texture = tree.nodes.new("ShaderNodeTexNoise")
        texture.inputs["Scale"].default_value = checks
        mix = tree.nodes.new("ShaderNodeMixRGB")
        mix.inputs[1].default_value = (*(0.35 * c for c in color), 1)
        mix.inputs[2].default_value = (*color, 1)
        tree.links.new(texture.outputs[0], mix.inputs[0])
        tree.links.new(mix.outputs[0], shader.inputs["Color"])
    return made


def build() -> None:
    """Suzanne and a ball on a rug."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_monkey_add(size=1.6, location=(0, 0, 0.9))
    head = bpy.context.object
    head.modifiers.new("smooth", "SUBSURF").levels = 2
    head.modifiers["smooth"].render_levels = 2
    head.data.materials.append(material("skin", (0.8, 0.45, 0.3), 6))
    bpy.ops.object.shade_smooth()
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.45, location=(1.3, -0.5, 0.45), segments=48)
    bpy.context.object.data.materials.append(material("ball", (0.75, 0.75, 0.8), 5))
    bpy.ops.object.shade_smooth()
    bpy.ops.mesh.primitive_cylinder_add(radius=2.4, depth=0.1, location=(0, 0, -0.05), vertices=64)
    bpy.context.object.data.materials.append(material("rug", (0.5, 0.55, 0.35), 8))
    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera, camera.data.angle = camera, 0.75
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.film_transparent = True
    scene.view_settings.view_transform = "Standard"
    scene.render.engine, scene.cycles.samples = "CYCLES", 16
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGBA"
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.angle = 0.1
    scene.collection.objects.link(sun)
    scene.world = bpy.data.worlds.new("world")


def light(name: str) -> None:
    """Set a light."""
    turn, strength, color, level = LIGHTS[name]
    sun = bpy.data.objects["sun"]
    sun.rotation_euler, sun.data.energy, sun.data.color = turn, strength, color
    world = bpy.context.scene.world
    world.color = (level, level, level)
    world.node_tree.nodes["Background"].inputs[0].default_value = (level, level, level, 1)


def look(turn: float, height: float) -> None:
    """Place the camera around the middle."""
    from mathutils import Vector

    camera = bpy.context.scene.camera
    level = np.cos(height)
    place = 6 * np.array([level * np.cos(turn), level * np.sin(turn), np.sin(height)]) + [0, 0, 0.5]
    camera.location = place
    camera.rotation_euler = (
        (Vector((0.2, 0, 0.5)) - camera.location).to_track_quat("-Z", "Y").to_euler()
    )
    bpy.context.view_layer.update()


def picture(path: Path) -> np.ndarray:
    """Render; sRGB over black [H, W, 3]."""
    bpy.context.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path), check_existing=False)
    values = np.array(image.pixels[:], np.float32).reshape(SIZE, SIZE, 4)
    bpy.data.images.remove(image)
    return values[..., :3] * values[..., 3:]


def views(count: int, offset: float) -> list[tuple[float, float]]:
    """Turns and heights of cameras."""
    heights = (0.25, 0.6, 1.0)
    return [(2 * np.pi * (i + offset) / count * 3, heights[i % 3]) for i in range(count)]


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path, help="folder for photos and run")
    parser.add_argument("--proxy", action="store_true", help="take normals from a mesh")
    args = parser.parse_args(sys.argv[1:])
    capture, run = args.work / "capture", args.work / "run"
    build()
    if not (capture / "transforms_train.json").is_file():
        (capture / "train").mkdir(parents=True, exist_ok=True)
        light("A")
        frames = []
        for i, place in enumerate(views(27, 0.0)):
            look(*place)
            picture(capture / "train" / f"r_{i}.png")
            matrix = [list(row) for row in bpy.context.scene.camera.matrix_world]
            frames.append({"file_path": f"./train/r_{i}", "transform_matrix": matrix})
        found = {"camera_angle_x": bpy.context.scene.camera.data.angle_x, "frames": frames}
        (capture / "transforms_train.json").write_text(json.dumps(found))
    python = os.environ["GSCORE_TRAINER_PYTHON"]
    if not (run / "point_cloud.ply").is_file():
        line = [python, "-m", "gscore", "train", str(capture), "-o", str(run)]
        subprocess.run([*line, "--preset", "draft", "--no-eval"], check=True)
    if args.proxy and not (run / "surface.ply").is_file():
        line = [python, "-m", "gscore", "mesh", str(run), "-o", str(run / "surface.ply")]
        subprocess.run([*line, "--triangles", "50000"], check=True)
    measure(args.work, run, args.proxy)


def measure(work: Path, run: Path, proxy: bool) -> None:
    """Print the errors."""
    import addon

    addon.register()
    from addon.core import read_surface
    from addon.render.proxy import attach
    from addon.surface.mesh_object import filled

    scene, meshes = bpy.context.scene, [o for o in bpy.context.scene.objects if o.type == "MESH"]
    truth = {}
    light("B")
    for i, place in enumerate(views(6, 0.5)):
        look(*place)
        truth[place] = picture(work / f"truth_{i}.png")
    for ob in meshes:
        ob.hide_render = ob.hide_viewport = True
    bpy.ops.gscore.import_splats(filepath=str(run / "point_cloud.ply"), turn_views=False)
    splats = bpy.context.object
    splats.matrix_world.identity()
    bpy.context.view_layer.update()
    if proxy:
        mesh = filled(read_surface(run / "surface.ply"), None, "proxy")
        made = bpy.data.objects.new("proxy", mesh)
        scene.collection.objects.link(made)
        attach(scene, splats, made)
    scene.render.engine = "GSCORE_SPLATS"

    def error(name: str) -> float:
        found = []
        for i, place in enumerate(views(6, 0.5)):
            look(*place)
            shown = picture(work / f"{name}_{i}.png")
            there = truth[place].any(axis=2)  # cameras of the truth see what no photo shows
            found.append(np.abs(shown - truth[place])[there].mean())
        return 255 * float(np.mean(found))

    splats.gscore.light = 0.0
    unlit = error("unlit")
    print(f"unlit: {unlit:.1f} of 255")
    light("A")
    bpy.context.view_layer.update()
    for captured in ("SURFACES", "SCENE"):
        light("A")
        bpy.context.view_layer.update()
        bpy.ops.gscore.relight_splats(captured=captured)
        light("B")
        lit = error(captured.lower())
        print(f"relit, {captured}: {lit:.1f} of 255, {lit / unlit:.2f} of unlit")


if __name__ == "__main__":
    main()
