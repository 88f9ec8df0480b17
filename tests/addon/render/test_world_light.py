"""World from Splats and Match Sun. Oracle, unless stated otherwise: Cycles."""

import re
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Vector

from addon import compat, stored_paths
from addon.core import Splats
from addon.render.lamps import scene_light
from addon.render.light_probe import LightProbe, sky_irradiance, strongest_light
from addon.render.proxy import attach
from addon.render.white_level import white_level
from gscore.io.cameras_json import write_cameras
from gscore.io.exposure_json import write_exposures
from gscore.photo_exposure import PhotoExposure
from gscore.scene import Cameras
from tests.addon import splat_scenes as lab
from tests.light_changes import decode, encode


def panoramic(scene: bpy.types.Scene, place: tuple[float, ...]) -> bpy.types.Object:
    """A camera that sees the whole sphere from a place, turned in all axes."""
    camera = lab.prepare(scene, (96, 48), light=0.2)
    camera.location, camera.rotation_euler = place, (1.3, 0.2, 0.7)
    camera.data.type, camera.data.clip_start = "PANO", 0.05
    owner = compat.panorama_settings(camera.data)
    owner.panorama_type = "EQUIRECTANGULAR"
    bpy.context.view_layer.update()
    return camera


def shell(color: tuple[float, float, float] = (0.5, 0.4, 0.3)) -> Splats:
    """A closed ball of opaque splats around the origin, 3 units away, of one sRGB color: a
    Fibonacci lattice."""
    index = np.arange(4000) + 0.5
    up, turn = 1 - index / 2000, np.pi * (1 + 5**0.5) * index
    level = np.sqrt(1 - up**2)
    means = 3 * np.stack([level * np.cos(turn), level * np.sin(turn), up], 1)
    sh0 = np.tile((np.array(color) - 0.5) / lab.SH_C0, (len(means), 1))[:, None]
    return Splats(
        means=means.astype(np.float32),
        quats=np.tile([1, 0, 0, 0], (len(means), 1)).astype(np.float32),
        scales=np.full((len(means), 3), np.log(0.12), np.float32),
        opacities=np.full(len(means), 6, np.float32),
        sh0=sh0.astype(np.float32),
        shN=np.zeros((len(means), 0, 3), np.float32),
    )


def lit(direction: tuple[float, float, float], level: float) -> Splats:
    """The shell, with splats within 8 degrees of a direction at an sRGB level."""
    splats = shell()
    unit = np.array(direction) / np.linalg.norm(direction)
    near = splats.means @ unit > 3 * np.cos(np.radians(8))
    splats.sh0[near] = (level - 0.5) / lab.SH_C0
    return splats


def add_white_plane(size: float) -> None:
    """Add a level, white and diffuse square at the origin."""
    bpy.ops.mesh.primitive_plane_add(size=size, location=(0, 0, 0))
    white = bpy.data.materials.new("white")
    compat.use_nodes(white)
    white.node_tree.nodes.clear()
    shader = white.node_tree.nodes.new("ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (1, 1, 1, 1)
    out = white.node_tree.nodes.new("ShaderNodeOutputMaterial")
    white.node_tree.links.new(shader.outputs[0], out.inputs["Surface"])
    bpy.context.object.data.materials.append(white)


def test_world_is_the_panorama(scene, tmp_path):
    """The engine's panorama from a camera at the cursor equals Cycles' picture of the world, which
    is linear, bright above 1, and the former world's color where there are no splats."""
    camera = panoramic(scene, (0.2, -0.1, 0.3))
    splats = lab.blob(60, center=(2.0, 0.5, 0.2), size=0.8)
    splats.sh0[:] = np.abs(splats.sh0) * 3  # far above white
    ob = lab.add(scene, splats)
    wanted = lab.render_exr(tmp_path, "ours")
    assert wanted[..., :3].max() > 1.5
    scene.cursor.location = camera.location
    assert bpy.ops.gscore.world_from_splats(width=768, near=0.05) == {"FINISHED"}
    tree = compat.world_nodes(scene.world)
    mix = next(node for node in tree.nodes if node.type == "MIX_SHADER")
    tree.links.remove(mix.inputs[0].links[0])
    mix.inputs[0].default_value = 0  # the camera sees the light
    ob.hide_render = True
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 64, False
    scene.cycles.filter_width = 1.0
    got = lab.render_exr(tmp_path, "cycles")
    error = np.abs(got - wanted)[..., :3]
    assert np.median(error) < 0.004
    assert np.percentile(error, 95) < 0.03 * wanted[..., :3].max()


def test_undo_of_a_world(scene, tmp_path):
    """Oracle: the former world, images, materials and light of the splats, which a second use
    replaces again, with the same picture; undo of that brings the first one back."""
    lab.prepare(scene, (20, 16), light=0.3)
    ob = lab.add(scene, shell())
    bpy.ops.mesh.primitive_uv_sphere_add(radius=2.9)
    attach(scene, ob, bpy.context.object)

    def there() -> list[list[str]]:
        kinds = bpy.data.worlds, bpy.data.images, bpy.data.materials, bpy.data.objects
        return [sorted(one.name for one in kind) for kind in kinds]

    def light() -> np.ndarray:
        graph = bpy.context.evaluated_depsgraph_get()
        return scene_light(graph).world

    def use(level: float) -> np.ndarray:
        scene = bpy.context.scene
        scene.cursor.location.x = level
        assert bpy.ops.gscore.world_from_splats(width=64, near=0.1) == {"FINISHED"}
        bpy.context.view_layer.update()
        bpy.ops.ed.undo_push(message=f"used {level}")
        return light()

    bpy.context.view_layer.update()
    bpy.ops.ed.undo_push(message="start")
    before, dark = there(), light()
    first = use(0.0)
    assert np.abs(first - dark).max() > 0.01
    bpy.ops.ed.undo()
    assert there() == before and bpy.context.scene.world.name == "World"
    np.testing.assert_array_equal(light(), dark)
    np.testing.assert_array_equal(use(0.0), first)
    made = there()
    second = use(0.2)
    assert there() == made and np.abs(second - first).max() > 0
    bpy.ops.ed.undo()
    assert there() == made
    np.testing.assert_array_equal(light(), first)


def test_camera_sees_the_former_world(scene, tmp_path):
    """By Cycles and by the engine, which reports nothing about it; and again after a second run."""
    lab.prepare(scene, (20, 16), light=0.3)
    ob = lab.add(scene, shell())
    for _ in range(2):
        assert bpy.ops.gscore.world_from_splats(width=64) == {"FINISHED"}
    assert len([w for w in bpy.data.worlds if "gs_splat_world" in w]) == 1
    assert len([i for i in bpy.data.images if i.name.startswith("Splats Light")]) == 1
    ob.hide_render = True
    scene.render.engine, scene.cycles.samples = "CYCLES", 1
    scene.cycles.use_denoising = False
    np.testing.assert_allclose(lab.render_exr(tmp_path, "c")[0, 0, :3], 0.3, atol=1e-3)
    ob.hide_render, scene.render.engine = False, "GSCORE_SPLATS"
    ob.location.x = 50
    np.testing.assert_allclose(lab.render_exr(tmp_path, "ours")[0, 0, :3], 0.3, atol=1e-3)


def test_light_on_a_mesh(scene, tmp_path):
    """A white diffuse plane inside the shell is as bright as the shell's linear color; the image is
    kept in a saved file."""
    camera = lab.prepare(scene, (12, 12))
    camera.location = (0, 0, 1)
    ob = lab.add(scene, shell((0.5, 0.4, 0.3)))
    assert bpy.ops.gscore.world_from_splats(width=64, near=0.1) == {"FINISHED"}
    add_white_plane(10)
    ob.hide_render = True
    path = tmp_path / "saved.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.open_mainfile(filepath=str(path))
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples = "CYCLES", 256
    scene.cycles.use_denoising = False
    got = lab.render_exr(tmp_path, "cycles")[..., :3].mean((0, 1))
    linear = decode([0.5, 0.4, 0.3])
    np.testing.assert_allclose(got, linear, rtol=0.03)


@pytest.mark.parametrize("direction", [(1, 0.5, 0.6), (-0.3, -1, -0.2), (0.1, 0, 1)])
def test_sun_shines_from_the_bright_splats(scene, direction, capfd):
    """Oracle: the direction of the splats that are bright, in the message too."""
    lab.prepare(scene)
    lab.add(scene, lit(direction, 2.0))
    assert bpy.ops.gscore.match_sun(near=0.1) == {"FINISHED"}
    sun = next(ob for ob in scene.objects if ob.type == "LIGHT")
    towards = sun.matrix_world.to_3x3() @ Vector((0, 0, 1))
    unit = Vector(direction).normalized()
    assert np.degrees(towards.angle(unit)) < 1.0
    assert 10 < np.degrees(sun.data.angle) < 22
    side = "above" if direction[2] > 0 else "below"
    height = np.degrees(abs(np.arcsin(unit.z)))
    found = re.search(rf"(\d+) degrees {side} the horizon", "".join(capfd.readouterr()))
    assert abs(int(found[1]) - height) < 1.5
    sun.rotation_euler = 0, 0, 0
    assert bpy.ops.gscore.match_sun(near=0.1) == {"FINISHED"}  # the same lamp, turned again
    assert [ob for ob in scene.objects if ob.type == "LIGHT"] == [sun]
    assert np.degrees((sun.matrix_world.to_3x3() @ Vector((0, 0, 1))).angle(unit)) < 1.0


@pytest.mark.parametrize("case", ["even", "two lamps", "half"])
def test_no_single_light(scene, case):
    """An even sphere, two equal lamps and a bright half give no sun."""
    lab.prepare(scene)
    splats = shell()
    if case == "two lamps":
        for x in (1, -1):
            near = splats.means @ np.array([x, 0.0, 0.0]) > 3 * np.cos(np.radians(6))
            splats.sh0[near] = (0.9 - 0.5) / lab.SH_C0
            near = splats.means @ np.array([0.0, x, 0.0]) > 3 * np.cos(np.radians(6))
            splats.sh0[near] = (0.9 - 0.5) / lab.SH_C0
    elif case == "half":
        splats.sh0[splats.means[:, 2] > 0] = (0.9 - 0.5) / lab.SH_C0
    lab.add(scene, splats)
    message = lab.error_of(lambda: bpy.ops.gscore.match_sun(near=0.1))
    assert "no strongest light" in message
    assert not [ob for ob in scene.objects if ob.type == "LIGHT"]


def disk(height: float, radius: float, level: float, *, width: int = 512) -> LightProbe:
    """A probe with a disk of light `level` over a sky of 0.1."""
    empty = np.zeros((width // 2, width, 3), np.float32)
    flat = np.ones(empty.shape[:2], np.float32)
    found = LightProbe(light=empty, alpha=flat, distances=7 * flat)
    towards = np.array([np.cos(height), 0, np.sin(height)])
    inside = found.directions @ towards > np.cos(radius)
    light = np.where(inside[..., None], np.float32(level), np.float32(0.1))
    return replace(found, light=np.repeat(light, 3, axis=2))


def test_irradiance_of_probes():
    """Oracle: integrals of a uniform sky, pi L, and of a disk, pi L sin^2 r; its diameter."""
    even = disk(0.5, 0.0, 0.1)
    np.testing.assert_allclose(sky_irradiance(even), np.pi * 0.1, rtol=1e-3)
    radius = np.radians(8)
    light = strongest_light(disk(0.5, radius, 0.9))
    np.testing.assert_allclose(light.irradiance, 2 * np.pi * (1 - np.cos(radius)) * 0.9, rtol=0.05)
    assert light.angle == pytest.approx(2 * radius, rel=0.05)
    assert light.distance == 7
    assert not light.is_clipped(1.0)
    bright = strongest_light(disk(0.5, radius, 1.0))
    assert bright.is_clipped(1.0) and not bright.is_clipped(1.1)


def write_run(folder: Path, away: float, gains: tuple[float, float]) -> None:
    """Cameras and exposures of two photos that look along +X; if `away` is -1, along -X."""
    look = np.eye(4)
    look[:3, :3] = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]]) * [[away], [1], [away]]
    cameras = Cameras(
        viewmats=np.stack([look, look]),
        Ks=np.tile([[50.0, 0, 32], [0, 50, 32], [0, 0, 1]], (2, 1, 1)),
        widths=np.array([64, 64]),
        heights=np.array([64, 64]),
        names=("a.png", "b.png"),
    )
    write_cameras(folder / "cameras.json", cameras)
    by_name = {name: PhotoExposure.of([gain] * 3) for name, gain in zip("ab", gains, strict=True)}
    write_exposures(folder / "exposure.json", {f"{n}.png": one for n, one in by_name.items()})


def test_white_level(tmp_path):
    """Oracle: the light that the smallest gain of photos that show the place makes white, 1 over
    gain^2.4; 1 if none does, or for a run without exposures, or with those of other photos."""
    ahead = np.array([4.0, 0, 0])
    assert white_level(tmp_path, ahead) == white_level(tmp_path / "none", ahead) == 1
    for gains, least in (((0.5, 2), 0.5), ((1.25, 1.6), 1.25)):
        write_run(tmp_path, 1, gains)
        assert white_level(tmp_path, ahead) == pytest.approx(least**-2.4)
        assert white_level(tmp_path, -ahead) == 1
    write_exposures(tmp_path / "exposure.json", {"c.png": PhotoExposure.of([0.5] * 3)})
    assert white_level(tmp_path, ahead) == 1


def test_strength_of_a_sun_in_brackets(scene, tmp_path):
    """Splats of light 3 towards +X, of a run whose shortest exposure, a quarter of the light, shows
    them: the lamp has their irradiance, pi L sin^2 r for a disk. If that photo looks away, is no
    shorter than the others, or is one of hidden splats, three times that of the sky."""
    lab.prepare(scene)
    level = float(encode(3))
    ob = lab.add(scene, lit((1, 0, 0), level))
    ob.rotation_euler, ob.location = (0, 0, 0.6), (2, 0, 0)
    bpy.context.view_layer.update()
    scene.cursor.location = ob.location
    stored_paths.write(ob, stored_paths.RUN, tmp_path)

    def strength(away: float, gain: float) -> float:
        write_run(tmp_path, away, (gain, 1 / gain))
        assert bpy.ops.gscore.match_sun(near=0.1) == {"FINISHED"}
        sun = next(one for one in scene.objects if one.type == "LIGHT")
        return sun.data.energy

    low, high = (np.pi * 3 * np.sin(np.radians(r)) ** 2 for r in (4, 8))
    assert low < strength(1, 0.5) < high  # the edge of the disk is soft
    assumed = strength(-1, 0.5)
    assert assumed > 5 * high
    assert strength(1, 0.9) == pytest.approx(assumed)
    other = lab.add(scene, lab.blob(10))
    other.matrix_world = ob.matrix_world
    stored_paths.write(other, stored_paths.RUN, tmp_path)
    del ob[stored_paths.RUN]
    other.hide_viewport = True
    assert strength(1, 0.5) == pytest.approx(assumed)


def test_refusals(scene):
    """Without splats the buttons are off; hidden splats are named."""
    lab.prepare(scene)
    assert not bpy.ops.gscore.world_from_splats.poll()
    assert not bpy.ops.gscore.match_sun.poll()
    ob = lab.add(scene, shell())
    ob.hide_viewport = True
    assert "no visible splats" in lab.error_of(bpy.ops.gscore.world_from_splats)


def test_linked_lamps_and_worlds_stay(scene, tmp_path):
    """A linked active sun is named, as its changes would be lost; a linked world of splats is
    replaced by one of this file."""
    lab.prepare(scene)
    splats = lab.add(scene, lit((1, 0.5, 0.6), 2.0))
    sun = bpy.data.objects.new("their sun", bpy.data.lights.new("their sun", "SUN"))
    world = bpy.data.worlds.new("their world")
    world["gs_splat_world"] = True
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {sun, world}, fake_user=True)
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.objects, wanted.worlds = [sun.name], [world.name]
    (linked,), (scene.world,) = wanted.objects, wanted.worlds
    scene.collection.objects.link(linked)
    bpy.context.view_layer.objects.active = linked
    assert "linked from" in lab.error_of(lambda: bpy.ops.gscore.match_sun(near=0.1))
    bpy.context.view_layer.objects.active = splats
    assert bpy.ops.gscore.world_from_splats(width=64) == {"FINISHED"}
    assert scene.world.library is None


def test_walls_of_a_proxy_shine(scene, tmp_path):
    """A closed proxy around a white plane inside the shell: as bright as the shell's linear color,
    in place of black; and its own material again under another world, and without a proxy."""
    camera = lab.prepare(scene, (12, 12))
    camera.location = (0, 0, 1)
    ob = lab.add(scene, shell((0.5, 0.4, 0.3)))
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=3, radius=2.9)
    walls = bpy.context.object
    for one in (walls, ob):
        one.select_set(True)
    bpy.context.view_layer.objects.active = ob
    assert bpy.ops.gscore.use_as_proxy() == {"FINISHED"}
    scene.cursor.location = (0.3, 0.2, 0.1)
    assert bpy.ops.gscore.world_from_splats(width=64, near=0.1) == {"FINISHED"}
    add_white_plane(1)
    camera.location.z = 0.5
    for name in (m.name for m in ob.modifiers):
        ob.modifiers[name].show_render = False
    scene.render.engine, scene.cycles.samples = "CYCLES", 256
    scene.cycles.use_denoising = False
    got = lab.render_exr(tmp_path, "cycles")[4:8, 4:8, :3].mean((0, 1))
    linear = decode([0.5, 0.4, 0.3])
    np.testing.assert_allclose(got, linear, rtol=0.03)
    world, scene.world = scene.world, bpy.data.worlds.new("other")
    bpy.context.view_layer.update()
    assert [slot.link for slot in walls.material_slots] == ["DATA"]
    scene.world = world
    bpy.context.view_layer.update()
    assert [slot.link for slot in walls.material_slots] == ["OBJECT"]
    bpy.context.view_layer.objects.active = ob
    assert bpy.ops.gscore.remove_proxy() == {"FINISHED"}
    assert [slot.link for slot in walls.material_slots] == ["DATA"]
