"""Holdout meshes hide the splats behind them. Oracle: pictures of the splats in front of a plane
and of all, mixed by the plane's coverage of a pixel."""

import bpy
import numpy as np
import pytest

from addon.core import Splats
from addon.equality import same
from addon.render import holdout_meshes, picture
from addon.render.engine import final_cache
from addon.render.pass_renderer import PassRenderer
from addon.render.shutter_lens import ShutterLens, View
from tests.addon import splat_scenes as lab
from tests.light_changes import encode

SIZE = 90, 70


def plane(scene, *, z=0.0, left=-9.0, right=9.0, name="plane") -> bpy.types.Object:
    """A square holdout mesh across the z axis."""
    corners = [(left, -9, z), (right, -9, z), (right, 9, z), (left, 9, z)]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    ob = bpy.data.objects.new(name, mesh)
    scene.collection.objects.link(ob)
    ob.is_holdout = True
    bpy.context.view_layer.update()
    return ob


def column(x: float, camera: bpy.types.Object, depth: float) -> float:
    """Pixel column of a position x at a depth."""
    focal = camera.data.lens / camera.data.sensor_width * max(SIZE)
    return SIZE[0] / 2 + focal * x / depth


def place(column: float, camera: bpy.types.Object, depth: float) -> float:
    """The inverse of `column`."""
    focal = camera.data.lens / camera.data.sensor_width * max(SIZE)
    return (column - SIZE[0] / 2) * depth / focal


def mixed(camera: bpy.types.Object, splats: Splats, edge: float, light: float, *, full: bool):
    """Combined pass [H, W, 4] with a plane at depth 4 that covers everything left of a column, in
    straight sRGB colours."""
    all_of, before = (lab.truth(camera, splats, SIZE, far=far) for far in (1e10, 4.0))
    share = np.clip(edge - np.arange(SIZE[0]), 0, 1)[None, :]
    alpha = share * before.alpha + (1 - share) * all_of.alpha
    through = (1 - share) * (1 - all_of.alpha) if full else 0 * alpha
    rgb = share[..., None] * before.rgb + (1 - share)[..., None] * all_of.rgb
    rgb = rgb + through[..., None] * encode(light)
    there = alpha + through
    straight = np.divide(rgb, there[..., None], out=np.zeros_like(rgb), where=there[..., None] > 0)
    return np.dstack([straight, there])


@pytest.mark.parametrize("how", ["object", "collection", "instance"])
@pytest.mark.parametrize("transparent", [True, False])
def test_a_plane_hides_what_is_behind_it(scene, tmp_path, how, transparent):
    """A vertical edge at a quarter of a pixel, so that the mixture is tested too."""
    camera = lab.prepare(scene, light=0.3)
    scene.render.film_transparent = transparent
    splats = lab.blob()
    lab.add(scene, splats)
    edge = 45.25
    ob = plane(scene, right=place(edge, camera, 4.0))
    if how != "object":
        ob.is_holdout = False
        group = bpy.data.collections.new("cut")
        scene.collection.objects.unlink(ob)
        group.objects.link(ob)
        if how == "collection":
            scene.collection.children.link(group)
            bpy.context.view_layer.layer_collection.children["cut"].holdout = True
        else:
            shower = bpy.data.objects.new("shower", None)
            shower.instance_type, shower.instance_collection = "COLLECTION", group
            scene.collection.objects.link(shower)
            shower.is_holdout = True
    got = lab.render_exr(tmp_path).astype(np.float64)
    wanted = mixed(camera, splats, edge, 0.3, full=not transparent)
    np.testing.assert_allclose(got[..., 3], wanted[..., 3], atol=1e-5)
    seen = wanted[..., 3] > 0.05
    straight = encode(got[..., :3] / np.maximum(got[..., 3:], 1e-9))
    np.testing.assert_allclose(straight[seen], wanted[..., :3][seen], atol=2e-4)
    whole = lab.truth(camera, splats, SIZE)
    assert (whole.alpha[:, :44] - wanted[:, :44, 3]).max() > 0.5  # it hides much


def test_the_viewport_shows_the_same(scene, tmp_path):
    """Oracle: F12, pixel by pixel, from the viewports' copies of the depsgraph."""
    camera = lab.prepare(scene)
    scene.render.film_transparent = True
    lab.add(scene, lab.blob())
    ob = plane(scene, right=0.1)
    wanted = lab.render_exr(tmp_path)
    shared = holdout_meshes.HoldoutMeshes()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    shutter_lens = ShutterLens(depsgraph, camera, SIZE, final_cache, lambda *_: None)
    view = View(
        model=lab.model_of(depsgraph),
        camera=shutter_lens.view().camera,
        holdouts=shared.of(depsgraph),
    )
    pass_renderer = PassRenderer(options=picture.Options(), transparent=True, to_scene=np.eye(3))
    got = pass_renderer.render(view, lambda: False)["Combined"][::-1]
    np.testing.assert_allclose(got, wanted, atol=3e-5)
    assert same(view.holdouts, shared.of(depsgraph))  # nothing is copied again
    ob.location.x += 0.1
    bpy.context.view_layer.update()
    assert not same(view.holdouts, shared.of(bpy.context.evaluated_depsgraph_get()))


def test_modifiers_count(scene, tmp_path):
    """Oracle: a plane at the modifier's position."""
    lab.prepare(scene)
    scene.render.film_transparent = True
    lab.add(scene, lab.blob())
    ob = plane(scene, z=1.2, right=0.0)
    wanted = lab.render_exr(tmp_path, "wanted")
    for vertex in ob.data.vertices:
        vertex.co.z -= 1.2
    before = lab.render_exr(tmp_path, "before")
    modifier = ob.modifiers.new("up", "DISPLACE")
    modifier.strength, modifier.mid_level, modifier.direction = 1.2, 0.0, "Z"
    np.testing.assert_allclose(lab.render_exr(tmp_path), wanted, atol=1e-5)
    assert np.abs(before - wanted).max() > 0.1


@pytest.mark.parametrize("how", ["hidden", "camera", "plain", "behind", "clipped", "no faces"])
def test_meshes_without_effect(scene, tmp_path, how):
    """Oracle: the picture without it, bit for bit."""
    camera = lab.prepare(scene)
    scene.render.film_transparent = True
    lab.add(scene, lab.blob())
    wanted = lab.render_exr(tmp_path, "wanted")
    ob = plane(scene, z={"behind": 5.0, "clipped": 3.0}.get(how, 0.0))
    hidden = lab.render_exr(tmp_path, "hidden")
    assert (np.abs(hidden - wanted).max() > 0.1) == (how != "behind")
    if how == "hidden":
        ob.hide_render = True
    elif how == "camera":
        ob.visible_camera = False
    elif how == "plain":
        ob.is_holdout = False
    elif how == "clipped":
        camera.data.clip_start = 1.1
    elif how == "no faces":
        ob.data.clear_geometry()
    np.testing.assert_array_equal(lab.render_exr(tmp_path), wanted)


def test_orthographic_cameras_and_borders(scene, tmp_path):
    """Oracle: all splats right of the edge, none left of it, because the plane is in front of
    them."""
    camera = lab.prepare(scene)
    scene.render.film_transparent = True
    lab.add(scene, lab.blob())
    camera.data.type, camera.data.ortho_scale = "ORTHO", 3.0
    free = lab.render_exr(tmp_path, "free")
    plane(scene, z=3.0, right=0.5)
    got = lab.render_exr(tmp_path, "got")
    edge = int(45 + 0.5 * 30)
    np.testing.assert_array_equal(got[:, edge:], free[:, edge:])
    assert not got[:, :edge].any() and free[:, :edge, 3].max() > 0.9
    scene.render.use_border = True
    scene.render.border_min_x, scene.render.border_max_x = 0.4, 0.9
    scene.render.border_min_y, scene.render.border_max_y = 0.2, 0.7
    part = lab.render_exr(tmp_path, "part")
    inside = part[..., 3] > 0
    assert inside.any()
    np.testing.assert_array_equal(part[inside], got[inside])


def test_panoramas_have_the_hole(scene, tmp_path):
    """Oracle: nothing in directions of a box around the camera; on its open side, the picture
    without it."""
    camera = lab.prepare(scene, (64, 32))
    scene.render.film_transparent = True
    scene.render.engine = "CYCLES"
    camera.data.type = "PANO"
    scene.render.engine = "GSCORE_SPLATS"
    lab.add(scene, lab.blob(size=1.5))
    free = lab.render_exr(tmp_path, "free")
    plane(scene, z=3.0, right=0.0)
    got = lab.render_exr(tmp_path, "got")
    assert free[..., 3].max() > 0.5
    columns = np.flatnonzero(free[..., 3].max(0) > 0.05)
    middle = int(columns.mean().round())
    assert np.abs(got[:, : middle - 1]).max() < 1e-6 or np.abs(got[:, middle + 1 :]).max() < 1e-6
    same = (np.abs(got - free).max((0, 2)) < 1e-6)[columns]
    assert 0.3 < same.mean() < 0.7


def test_moving_meshes_blur_the_edge(scene, tmp_path):
    """Oracle: along the path of the edge, points that it passes sooner are hidden longer."""
    lab.prepare(scene)
    scene.render.film_transparent = True
    lab.add(scene, lab.wall(0.0, (0.8, 0.4, 0.2), half=2.0))
    free = lab.render_exr(tmp_path, "free")[35, :, 3]
    ob = plane(scene, z=1.0, right=0.0)
    lab.moving(ob, 0.8)
    scene.frame_set(5)
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
    scene.gscore_render.blur_samples = 16
    shown = lab.render_exr(tmp_path)[35, :, 3] / free
    assert (np.diff(shown) > -1e-5).all()
    assert shown[20] < 1e-5 and shown[70] > 1 - 1e-5
    assert ((shown > 0.2) & (shown < 0.8)).sum() > 10


def test_depths_are_those_of_what_shows(scene, tmp_path):
    """Oracle: depths of the splats in front of the plane, and of all outside of it."""
    camera = lab.prepare(scene)
    splats = lab.blob()
    lab.add(scene, splats)
    scene.view_layers[0].use_pass_z = True
    plane(scene, right=place(45.0, camera, 4.0))
    got = lab.render_pass(scene, tmp_path, "Depth")
    before, whole = (lab.truth(camera, splats, SIZE, far=far) for far in (4.0, 1e10))
    for part, rendered in ((slice(0, 45), before), (slice(45, 90), whole)):
        z = np.where(rendered.median_depth > 0, rendered.median_depth, rendered.depth)[:, part]
        np.testing.assert_allclose(got[:, part], np.where(z > 0, z, 1e10), rtol=1e-5)


def test_a_slanted_plane_has_its_depth_everywhere(scene):
    """Oracle: the plane's equation along each ray; the share of the covered rows."""
    camera = lab.prepare(scene)
    ob = plane(scene)
    ob.rotation_euler = (0.9, 0, 0)
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    lab.add(scene, lab.blob())
    view = ShutterLens(
        bpy.context.evaluated_depsgraph_get(), camera, SIZE, final_cache, print
    ).view()
    assert len(holdout_meshes.HoldoutMeshes().of(depsgraph)) == 1
    found = holdout_meshes.hidden(view.holdouts, view.camera)
    assert (found.share == 1).all()
    y = (35 - (np.arange(SIZE[1]) + 0.5)) / view.camera.K[1, 1]
    # A point (x, y t, 4 - t) is on the plane where z = y tan(0.9).
    wanted = np.broadcast_to((4 / (1 + y * np.tan(0.9)))[:, None], found.far.shape)
    np.testing.assert_allclose(found.far, wanted, rtol=1e-4)
