"""Panoramic cameras. Oracle, unless stated otherwise: Cycles, in pictures of the same scene."""

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from addon import compat
from addon.cameras.panorama import panorama_of
from addon.core import Splats
from addon.render import unsupported_settings
from tests.addon import splat_scenes as lab

HALF = np.pi / 2
CAMERAS: dict[str, tuple[tuple[int, int], dict[str, Any]]] = {
    "whole sphere": ((64, 32), {"panorama_type": "EQUIRECTANGULAR"}),
    "a part of it, shifted": (
        (48, 40),
        {
            "panorama_type": "EQUIRECTANGULAR",
            "latitude_min": -0.5,
            "latitude_max": 1.0,
            "longitude_min": -1.0,
            "longitude_max": 2.0,
            "shift_x": 0.1,
            "shift_y": -0.05,
        },
    ),
    "equidistant": ((40, 40), {"panorama_type": "FISHEYE_EQUIDISTANT", "fisheye_fov": np.pi}),
    "equidistant, wide, not square": (
        (56, 40),
        {"panorama_type": "FISHEYE_EQUIDISTANT", "fisheye_fov": 4.0, "shift_x": -0.05},
    ),
    "equisolid": (
        (48, 32),
        {"panorama_type": "FISHEYE_EQUISOLID", "fisheye_lens": 8.0, "fisheye_fov": 3.4},
    ),
    "equisolid, upright, vertical fit": (
        (32, 48),
        {
            "panorama_type": "FISHEYE_EQUISOLID",
            "fisheye_lens": 7.0,
            "fisheye_fov": 2.5,
            "sensor_fit": "VERTICAL",
            "shift_y": 0.1,
        },
    ),
}


def panoramic(scene: bpy.types.Scene, name: str) -> bpy.types.Object:
    """The scene's camera as one of `CAMERAS`, rotated; return its settings."""
    size, settings = CAMERAS[name]
    camera = lab.prepare(scene, size)
    camera.location, camera.rotation_euler = (0.3, -0.2, 0.5), (1.2, 0.1, 0.4)
    camera.data.type = "PANO"
    owner = compat.panorama_settings(camera.data)
    for key, value in settings.items():
        setattr(owner if hasattr(owner, key) else camera.data, key, value)
    bpy.context.view_layer.update()
    return camera


def by_cycles(scene: bpy.types.Scene, folder: Path, count: int) -> np.ndarray:
    """Picture by Cycles, sampled only at the pixels' middles."""
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = count, False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
    picture = lab.render_exr(folder, "cycles")
    scene.render.engine = "GSCORE_SPLATS"
    return picture


@pytest.mark.parametrize("name", CAMERAS)
def test_pixels_look_where_those_of_cycles_do(scene, tmp_path, name):
    """Oracle: a world with directions as colors, in Cycles."""
    camera = panoramic(scene, name)
    tree = compat.world_nodes(scene.world)
    if tree is None:
        scene.world.use_nodes = True
        tree = scene.world.node_tree
    way, scale = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeVectorMath")
    scale.operation = "MULTIPLY_ADD"
    scale.inputs[1].default_value = scale.inputs[2].default_value = (0.5, 0.5, 0.5)
    tree.links.new(way.outputs["Generated"], scale.inputs[0])
    background = next(n for n in tree.nodes if n.type == "BACKGROUND")
    tree.links.new(scale.outputs[0], background.inputs[0])
    picture = by_cycles(scene, tmp_path, 1)
    width, height = CAMERAS[name][0]
    panorama = panorama_of(camera, scene, width=width, height=height)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    own, seen = panorama.directions(x, y)
    np.testing.assert_array_equal(picture[..., :3].any(-1), seen)
    assert seen.sum() > 400
    np.testing.assert_allclose(np.linalg.norm(own[seen], axis=-1), 1)
    world = own @ panorama.viewmat[:3, :3]
    np.testing.assert_allclose(picture[seen][:, :3] * 2 - 1, world[seen], atol=0.01)


def balls(places: np.ndarray, radius: float) -> Splats:
    """White opaque splats."""
    n = len(places)
    return Splats(
        means=places.astype(np.float32),
        quats=np.tile([1, 0, 0, 0], (n, 1)).astype(np.float32),
        scales=np.full((n, 3), np.log(radius), np.float32),
        opacities=np.full(n, 6, np.float32),
        sh0=np.full((n, 1, 3), 0.5 / lab.SH_C0, np.float32),
        shN=np.zeros((n, 0, 3), np.float32),
    )


def middle(picture: np.ndarray) -> np.ndarray:
    """Centroid of the light of a picture, x and y in pixels."""
    light = picture[..., 0].astype(np.float64)
    y, x = np.mgrid[: light.shape[0], : light.shape[1]] + 0.5
    return np.array([(x * light).sum(), (y * light).sum()]) / light.sum()


@pytest.mark.parametrize("name", ["whole sphere", "equidistant, wide, not square", "equisolid"])
@pytest.mark.parametrize("way", [(0.3, 0.2, -1.0), (-1.0, 0.4, -0.9), (0.7, -0.75, -0.72)])
def test_a_splat_lies_where_a_sphere_does(scene, tmp_path, name, way):
    """Oracle: the centroid of a small emissive mesh sphere in Cycles, to half a pixel."""
    camera = panoramic(scene, name)
    place = np.array(camera.matrix_world.to_3x3()) @ np.array(way) * 2
    place = place / np.linalg.norm(place) * 5 + np.array(camera.location)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.25, location=place)
    sphere = bpy.context.object
    glow = bpy.data.materials.new("glow")
    compat.use_nodes(glow)
    tree = glow.node_tree
    tree.nodes.clear()
    out, light = tree.nodes.new("ShaderNodeOutputMaterial"), tree.nodes.new("ShaderNodeEmission")
    tree.links.new(light.outputs[0], out.inputs[0])
    sphere.data.materials.append(glow)
    scene.cycles.max_bounces = 0
    wanted = middle(smooth(scene, tmp_path))
    sphere.hide_render = True
    lab.add(scene, balls(place[None], 0.15))
    got = lab.render_exr(tmp_path)
    assert got[..., 0].max() > 0.1
    np.testing.assert_allclose(middle(got), wanted, atol=0.5)


def smooth(scene: bpy.types.Scene, folder: Path) -> np.ndarray:
    """Picture by Cycles, averaged over whole pixels."""
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 64, False
    scene.cycles.pixel_filter_type = "BOX"
    picture = lab.render_exr(folder, "smooth")
    scene.render.engine = "GSCORE_SPLATS"
    return picture


def test_sides_of_the_cube_meet_without_a_seam(scene, tmp_path):
    """Oracle: a dense shell of one color is that color everywhere."""
    lab.prepare(scene, (128, 64)).data.type = "PANO"
    compat.panorama_settings(scene.camera.data).panorama_type = "EQUIRECTANGULAR"
    rng = np.random.default_rng(0)
    way = rng.normal(size=(6000, 3))
    shell = balls(way / np.linalg.norm(way, axis=1)[:, None] * 4 + [0, 0, 4], 0.25)
    lab.add(scene, shell)
    got = lab.render_exr(tmp_path)
    np.testing.assert_allclose(got, 1, atol=0.01)


def test_patches_of_the_cube_leave_no_edges(scene, tmp_path):
    """Oracle: the mean step between adjacent columns of pixels, which is not larger at the borders
    of patches; likewise of rows. With large, translucent splats, which differ most: an edge would
    be a step of ten to twenty times that."""
    camera = lab.prepare(scene, (360, 180))
    camera.data.type, camera.rotation_euler, camera.location = "PANO", (HALF, 0, 0), (0, 0, 0)
    compat.panorama_settings(camera.data).panorama_type = "EQUIRECTANGULAR"
    rng = np.random.default_rng(3)
    way, count = rng.normal(size=(1500, 3)), 1500
    away = rng.uniform(2, 5, (count, 1)) / np.linalg.norm(way, axis=1, keepdims=True)
    lab.add(
        scene,
        Splats(
            means=(way * away).astype(np.float32),
            quats=rng.normal(size=(count, 4)).astype(np.float32),
            scales=rng.uniform(-2.5, 0.2, (count, 3)).astype(np.float32),
            opacities=rng.uniform(-2, 1, count).astype(np.float32),
            sh0=rng.normal(size=(count, 1, 3)).astype(np.float32),
            shN=np.zeros((count, 0, 3), np.float32),
        ),
    )
    picture = lab.render_exr(tmp_path)[..., :3]
    steps = np.abs(np.diff(picture[60:120], axis=1)).mean((0, 2))
    edges = np.arange(15, 360, 30) - 1  # a pixel is a degree; sides begin at 45 degrees
    assert steps[edges].mean() < 2 * np.delete(steps, edges).mean()
    upright = np.abs(np.diff(picture[45:135], axis=0)).mean((1, 2))
    assert upright.max() < 2 * np.median(upright)


def test_clip_start_is_a_distance(scene, tmp_path):
    """Oracle: the picture without nearer splats, in the corners of the cube too."""
    camera = lab.prepare(scene, (64, 32))
    camera.data.type, camera.data.clip_start = "PANO", 1.0
    compat.panorama_settings(camera.data).panorama_type = "EQUIRECTANGULAR"
    way = np.array([(1.0, 1, 1), (1, 0, 0), (-1, 1, -1)])
    way /= np.linalg.norm(way, axis=1)[:, None]
    lab.add(scene, balls(way * 1.05 + [0, 0, 4], 0.02))
    alone = lab.render_exr(tmp_path, "alone")
    lab.add(scene, balls(way[:, ::-1] * 0.95 + [0, 0, 4], 0.2), "near")
    np.testing.assert_array_equal(lab.render_exr(tmp_path), alone)
    assert (alone[..., 0] > 0.05).sum() >= 3


@pytest.mark.parametrize("crop", [False, True])
def test_a_region_of_a_panorama(scene, tmp_path, crop):
    """Oracle: the same pixels of the whole picture."""
    panoramic(scene, "equisolid")
    lab.add(scene, balls(np.random.default_rng(1).normal(size=(300, 3)) * 3, 0.2))
    whole = lab.render_exr(tmp_path, "whole")
    render = scene.render
    render.use_border, render.use_crop_to_border = True, crop
    render.border_min_x, render.border_max_x = 0.25, 0.75
    render.border_min_y, render.border_max_y = 0.25, 0.5
    part = lab.render_exr(tmp_path, "part")
    part = part if crop else part[16:24, 12:36]
    np.testing.assert_allclose(part, whole[16:24, 12:36], atol=1e-5)
    assert part[..., 0].std() > 0.05


def test_depth_is_the_distance(scene, tmp_path):
    """Oracle: the distance of a wall's points from the camera, in any direction."""
    camera = lab.prepare(scene, (160, 160))
    camera.data.type = "PANO"
    owner = compat.panorama_settings(camera.data)
    owner.panorama_type, owner.fisheye_fov = "FISHEYE_EQUIDISTANT", np.pi
    scene.view_layers[0].use_pass_z = True
    lab.add(scene, lab.wall(3.0, (0.9, 0.2, 0.1), half=2.0))
    depth = lab.render_pass(scene, tmp_path, "Depth")
    x, y = np.meshgrid(np.arange(160) + 0.5, np.arange(160) + 0.5)
    panorama = panorama_of(camera, scene, width=160, height=160)
    angle = np.arccos(panorama.directions(x, y)[0][..., 2])
    known = angle < np.arctan(1.3)  # on the sides of the cube too
    error = depth[known] * np.cos(angle[known]) - 1
    assert np.abs(error).mean() < 0.015 and np.abs(error).max() < 0.08  # splats are 0.1 apart
    assert depth[0, 0] == pytest.approx(1e10)


def test_film_beyond_the_circle(scene, tmp_path):
    """Oracle: Cycles, which leaves it black; a transparent film is empty there."""
    panoramic(scene, "equidistant")
    lab.add(scene, lab.blob())
    wanted = by_cycles(scene, tmp_path, 1)[0, 0]
    np.testing.assert_allclose(lab.render_exr(tmp_path)[0, 0], wanted, atol=1e-6)
    scene.render.film_transparent = True
    assert not lab.render_exr(tmp_path)[0, 0].any()


def test_a_panorama_that_moves_blurs(scene, tmp_path):
    """Oracle: a rotation of 36 degrees spans a tenth of the picture's width."""
    camera = lab.prepare(scene, (200, 40))
    camera.data.type = "PANO"
    compat.panorama_settings(camera.data).panorama_type = "EQUIRECTANGULAR"
    camera.location, camera.rotation_euler = (0, 0, 0), (HALF, 0, 0)
    lab.add(scene, balls(np.array([[0, 5.0, 0]]), 0.02))
    for frame, turn in ((1, 0.0), (2, np.pi / 5)):
        camera.rotation_euler.z = turn
        camera.keyframe_insert("rotation_euler", frame=frame)
    scene.frame_set(1)
    scene.render.use_motion_blur, scene.render.motion_blur_position = True, "START"
    scene.render.motion_blur_shutter = 1.0
    scene.gscore_render.blur_samples = 32
    lit = np.flatnonzero(lab.render_exr(tmp_path)[..., 0].sum(0) > 1e-4)
    assert lit.min() == pytest.approx(100, abs=2) and np.ptp(lit) == pytest.approx(20, abs=3)


def test_depth_of_field_of_a_panorama_is_named(scene):
    """Oracle: the table that the panel and the render read."""
    camera = panoramic(scene, "equidistant")
    camera.data.dof.use_dof = True
    shown = unsupported_settings.Shown(scene=scene, layer=bpy.context.view_layer, camera=camera)
    (sentence,) = unsupported_settings.without_effect(shown)
    assert "Depth of Field of Camera" in sentence and not unsupported_settings.refused(shown)
