"""Normal and Position passes. Oracle, unless stated otherwise: Cycles' passes of a plane at the
splats' place."""

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from addon import compat
from tests.addon import splat_scenes as lab
from tests.addon.render.test_relight import know_light
from tests.addon.render.test_splat_passes import render_passes
from tests.light_changes import decode

SIZE = (200, 160)
"""Splats are a pixel wide at least, which moves their surface towards a tilted camera."""


def three(scene, folder, name: str) -> np.ndarray:
    """A pass of three channels via the compositor, [H, W, 3]."""
    tree = compat.make_compositor_tree(scene)
    layers = next(n for n in tree.nodes if n.type == "R_LAYERS")
    tree.links.new(layers.outputs[name], compat.compositor_result(tree))
    scene.render.use_compositing = True
    return lab.render_exr(folder, name)[..., :3]


@pytest.fixture
def tilted(scene):
    """A wall of splats, turned and twice as large, and a plane like it that no camera sees yet."""
    camera = lab.prepare(scene, SIZE)
    camera.location, camera.rotation_euler = (0.3, -0.2, 4.0), (0.1, 0.05, 0.3)
    ob = lab.add(scene, lab.wall(0.0, (0.5, 0.5, 0.5), along=121))
    bpy.ops.mesh.primitive_plane_add(size=2)
    plane = bpy.context.object
    for one in (ob, plane):
        one.location, one.rotation_euler, one.scale = (0.2, 0.1, 0.3), (0.5, -0.4, 0.2), (2,) * 3
    plane.hide_render = True
    layer = scene.view_layers[0]
    layer.use_pass_normal = layer.use_pass_position = True
    bpy.context.view_layer.update()
    return scene, ob, plane, camera


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO", "PANO", "region"])
def test_passes_are_those_of_a_plane(tilted, tmp_path, kind):
    """But for the sizes of splats, by every type of camera."""
    scene, ob, plane, camera = tilted
    if kind != "region":
        camera.data.type = kind
    if kind == "PANO":
        compat.panorama_settings(camera.data).panorama_type = "FISHEYE_EQUIDISTANT"
        compat.panorama_settings(camera.data).fisheye_fov = 0.9
    scene.render.use_border = kind == "region"
    scene.render.border_min_x, scene.render.border_max_x = 0.4, 0.7
    scene.render.border_min_y, scene.render.border_max_y = 0.5, 0.8
    ours = {name: three(scene, tmp_path, name) for name in ("Normal", "Position")}
    ob.hide_render, plane.hide_render = True, False
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 1, False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
    row, column = SIZE[1] // 2 - 14, SIZE[0] // 2 + 2
    part = slice(row, row + 3), slice(column, column + 4)
    for name, found in ours.items():
        wanted = three(scene, tmp_path, name)
        assert np.linalg.norm(wanted[part], axis=-1).min() > 0.2
        np.testing.assert_allclose(found[part], wanted[part], atol=0.05)
        assert np.median(np.abs(found[part] - wanted[part])) < 0.02


def test_empty_pixels_and_blur(tilted, tmp_path):
    """Nothing where there are no splats; with depth of field the position is that of the frame."""
    scene, ob, _, camera = tilted
    sharp = three(scene, tmp_path, "Position")
    ob.scale = (0.3,) * 3
    for name in ("Normal", "Position"):
        assert not three(scene, tmp_path, name)[0, 0].any()
    ob.scale = (2,) * 3
    camera.data.dof.use_dof, camera.data.dof.aperture_fstop = True, 2.0
    camera.data.dof.focus_distance = 4.0
    scene.gscore_render.blur_samples = 4
    np.testing.assert_array_equal(three(scene, tmp_path, "Position"), sharp)
    lengths = np.linalg.norm(three(scene, tmp_path, "Normal")[80, 100])
    assert 0.9 < lengths < 1.001


def four(scene, folder, name: str) -> np.ndarray:
    """A pass of four channels via the compositor, [H, W, 4]."""
    tree = compat.make_compositor_tree(scene)
    layers = next(n for n in tree.nodes if n.type == "R_LAYERS")
    tree.links.new(layers.outputs[name], compat.compositor_result(tree))
    scene.render.use_compositing = True
    return lab.render_exr(folder, name)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO", "several"])
def test_motion_is_that_of_a_plane(tilted, tmp_path, kind):
    """Of a moving, turning wall and camera; with a second object that moves otherwise aside; the
    scene is at its frame afterwards, and without motion all is 0."""
    scene, ob, plane, camera = tilted
    camera.data.type = "ORTHO" if kind == "ORTHO" else "PERSP"
    if kind == "several":
        other = lab.add(scene, lab.wall(0.0, (0.2, 0.9, 0.2), half=0.2), "other")
        other.location = (0.9, 0, 1)
        lab.moving(other, -0.3)
    layer = scene.view_layers[0]
    layer.use_pass_vector = True
    for name in ("use_pass_normal", "use_pass_position"):
        setattr(layer, name, False)
    assert not four(scene, tmp_path, "Vector")[70:90, 90:110].any()
    for one in (ob, plane):
        for frame in (4, 5, 6):
            one.location.x, one.rotation_euler.z = 0.2 + 0.05 * (frame - 5), 0.2 * frame**2 / 25
            one.keyframe_insert("location", frame=frame)
            one.keyframe_insert("rotation_euler", frame=frame)
    lab.moving(camera, 0.02)
    scene.frame_set(5)
    ours = four(scene, tmp_path, "Vector")
    assert scene.frame_current == 5
    if kind == "several":
        moved = np.abs(ours[..., 0]) > 8
        assert moved.any() and not moved[60:100, 80:120].any()
    ob.hide_render, plane.hide_render = True, False
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 1, False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
    wanted = four(scene, tmp_path, "Vector")
    part = slice(60, 100), slice(80, 120)
    assert np.abs(wanted[part]).max(axis=(0, 1)).min() > 1
    difference = np.abs(ours - wanted)[part]
    assert np.median(difference) < 0.1
    assert difference.max() < 0.3


def test_a_moving_holdout_moves_nothing(tilted, tmp_path):
    """The motion of what it cuts is that of the splats."""
    scene, ob, _, _ = tilted
    scene.view_layers[0].use_pass_vector = True
    lab.moving(ob, 0.1)
    scene.frame_set(5)
    wanted = four(scene, tmp_path, "Vector")
    cutter = lab.add(scene, lab.wall(0.0, (0.2, 0.9, 0.2), half=0.2), "cutter")
    cutter.location, cutter.is_holdout = (0.9, 0, 1), True
    lab.moving(cutter, -0.3)
    part = slice(70, 90), slice(90, 110)
    found = four(scene, tmp_path, "Vector")[part]
    np.testing.assert_allclose(found, wanted[part], atol=0.01)
    assert np.abs(found).max() > 1


def test_all_passes_in_one_file(tilted, tmp_path):
    """A multilayer EXR has all passes by their names, with the values of the compositor; Splat
    Index has a splat beside the position, Diffuse Color the color over the captured
    light, and Shadow is 1 beside a cube's shadow and dark in it."""
    scene, ob, _, _ = tilted
    layer = scene.view_layers[0]
    for name in ("z", "vector", "object_index", "diffuse_color", "shadow"):
        setattr(layer, f"use_pass_{name}", True)
    scene.gscore_render.splat_index = True
    ob.pass_index = 3
    know_light(ob, captured=0.5)
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.matrix_world = ob.matrix_world.normalized()
    scene.collection.objects.link(sun)
    bpy.ops.mesh.primitive_cube_add(size=0.3)
    cube = bpy.context.object
    cube.matrix_world = ob.matrix_world @ Matrix.Translation((0.2, 0, 1))
    ob.gscore.light = 1.0
    albedo = compat.albedo_pass_name()
    names = "Depth", "Normal", "Position", "Vector", albedo, "Shadow", "Splat Index"
    wanted = {name: four(scene, tmp_path, name) for name in names}
    scene.render.use_compositing = False
    found = render_passes(scene, tmp_path)
    assert set(found) == {"Combined", *names, compat.index_pass_name()}
    for name, values in wanted.items():
        channels = found[name].reshape(*SIZE[::-1], -1)
        np.testing.assert_array_equal(channels, values[..., : channels.shape[2]], err_msg=name)
    part = slice(60, 100), slice(80, 120)
    places = np.array([(ob.matrix_world @ v.co)[:] for v in ob.data.vertices])
    rows = found["Splat Index"][part].astype(int)
    assert rows.min() >= 0 and len(np.unique(rows)) > 100
    away = np.linalg.norm(places[rows] - found["Position"][part], axis=-1)
    assert away.max() < 0.15  # splats are 0.03 apart
    np.testing.assert_allclose(found[albedo][part], decode(0.5) / 0.5, rtol=0.01)
    shadow = found["Shadow"]
    assert (shadow > 0.999).mean() > 0.5 and 50 < (shadow < 0.1).all(-1).sum() < 5000
    assert not found["Combined"][(shadow < 0.1).all(-1), :3].max() > 0.1


def test_depth_has_no_holes(scene, tmp_path):
    """Every pixel with splats has a depth, and no other one."""
    lab.prepare(scene)
    lab.add(scene, lab.blob(200))
    scene.render.film_transparent = True
    scene.view_layers[0].use_pass_z = True
    alpha = lab.render_exr(tmp_path)[..., 3]
    depth = three(scene, tmp_path, "Depth")[..., 0]
    assert 0.2 < (alpha > 0).mean() < 0.9
    np.testing.assert_array_equal(alpha > 0, depth < 1e9)
