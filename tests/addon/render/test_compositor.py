"""Splats among meshes. Oracle: the depth order by construction of the scene."""

import bpy
import numpy as np
import pytest

from addon import compat
from addon.panels.render import RenderPanel
from addon.render import composite_nodes, compositor, shutter_lens, unsupported_settings
from addon.render.pass_renderer import HOLDOUT_PASSES
from tests.addon import splat_scenes as lab
from tests.addon.drawn import drawn
from tests.addon.mesh_scenes import emitter, glass, paint_world, plane
from tests.light_changes import encode

RED, SIZE = (0.9, 0.1, 0.1), (64, 48)


@pytest.fixture
def mixed(scene):
    """A red wall of splats at z = 1, a green plane in front of its left, a blue one behind its
    right."""
    lab.prepare(scene, SIZE)
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 4, False
    scene.render.film_transparent = True
    lab.add(scene, lab.wall(1.0, RED, half=0.8))
    plane(scene, 2.0, (0, 1, 0), -0.9, -0.1, "before")
    plane(scene, 0.0, (0, 0, 1), 0.1, 2.0, "behind")
    return scene


def test_meshes_before_and_behind(mixed, tmp_path):
    """Green hides red on the left, red hides blue on the right; blue shows beyond the wall."""
    name = mixed.name
    assert bpy.ops.gscore.set_up_compositing() == {"FINISHED"}
    got = lab.render_exr(tmp_path)
    row = got[24]
    assert row[22, :3] == pytest.approx((0, 1, 0), abs=1e-3)
    assert encode(row[38, :3]) == pytest.approx(RED, abs=0.01)
    assert row[62, :3] == pytest.approx((0, 0, 1), abs=0.02)
    assert row[62, 3] == pytest.approx(1, abs=1e-3)
    assert got[2, 62, 3] == 0
    assert bpy.context.scene.name == name
    # The wall alone, at a pixel without meshes: nothing is drawn twice or missing.
    assert encode(got[24, 32, :3]) == pytest.approx(RED, abs=0.01)


def test_soft_splats_blend_with_meshes(mixed, tmp_path):
    """Oracle: alpha over in linear light of the two scenes' own renders."""
    bpy.data.objects.remove(bpy.data.objects["splats"])
    mixed.render.engine = "CYCLES"
    soft = lab.blob(60, center=(0, 0, 1.0), size=0.4)
    lab.add(mixed, soft, "soft")
    other = compositor.set_up(mixed)
    both = lab.render_exr(tmp_path, "both")
    mixed.render.use_compositing = False
    meshes = lab.render_exr(tmp_path, "meshes")
    bpy.context.window.scene = other
    splats = lab.render_exr(tmp_path, "splats")
    over = splats + (1 - splats[..., 3:]) * meshes
    under = meshes + (1 - meshes[..., 3:]) * splats
    # Columns of the plane behind and of the one before, away from edges of the planes; where the
    # splats fade out, only their last thousandths are smoothed.
    for columns, want in ((slice(35, 60), over), (slice(14, 28), under)):
        np.testing.assert_allclose(both[16:32, columns], want[16:32, columns], atol=3e-3)
    partly = (splats[16:32, 35:60, 3] > 0.1) & (splats[16:32, 35:60, 3] < 0.9)
    assert partly.mean() > 0.1


def test_where_a_mesh_enters_the_splats_is_smooth(mixed, tmp_path):
    """Oracle: a plane that intersects the wall of splats along an oblique line; each pixel has one
    depth, so without smoothing none is between red and green."""
    bpy.data.objects.remove(bpy.data.objects["behind"])
    ob = bpy.data.objects["before"]
    for vertex in ob.data.vertices:
        x, y = 0.7 * np.sign(vertex.co.x + 0.5), vertex.co.y
        vertex.co = (x, y, 1 + 0.8 * (x + 0.5 * y))
    compositor.set_up(mixed)
    green = lab.render_exr(tmp_path)[14:34, 20:44, 1]
    low, high = green[:, 0], green[:, -1]
    assert low == pytest.approx(np.full(20, low[0]), abs=0.01)
    assert high == pytest.approx(np.ones(20), abs=0.01)
    between = (green > 0.1) & (green < 0.9)
    assert between.any(axis=1).mean() > 0.6
    assert between.sum(axis=1).max() <= 3


def test_own_nodes_stay_and_come_after(mixed, tmp_path):
    """Oracle: the tree before, and the picture: an inverting node of the user still inverts."""
    tree = compat.make_compositor_tree(mixed)
    layers = next(n for n in tree.nodes if n.type == "R_LAYERS")
    result = compat.compositor_result(tree)
    invert = tree.nodes.new("CompositorNodeInvert")
    invert.name = "mine"
    color = next(i for i in invert.inputs if i.type == "RGBA")
    tree.links.new(layers.outputs["Image"], color)
    tree.links.new(invert.outputs[0], result)
    before = {n.name for n in tree.nodes}
    compositor.set_up(mixed, transparent=False)
    added = {n.name for n in tree.nodes} - before
    assert added == {composite_nodes.LAYER_NODE, composite_nodes.COMBINE_NODE}
    got = lab.render_exr(tmp_path)
    assert got[24, 22, :3] == pytest.approx((1, 0, 1), abs=1e-2)
    assert got[24, 38, 1] > 0.95  # red's small green, inverted


def test_again_brings_up_to_date(mixed, tmp_path):
    """Oracle: counts stay; a new camera, size and splat object reach the second scene."""
    other = compositor.set_up(mixed)
    scenes, nodes = len(bpy.data.scenes), len(compat.compositor_tree(mixed).nodes)
    links = len(compat.compositor_tree(mixed).links)
    camera = bpy.data.objects.new("second", bpy.data.cameras.new("second"))
    camera.location = (0, 0, 5)
    mixed.collection.objects.link(camera)
    mixed.camera = camera
    lab.add(mixed, lab.wall(3.0, (0.1, 0.1, 0.1), half=0.1), "more")
    mixed.render.resolution_x = 80
    assert compositor.set_up(mixed) == other
    assert (len(bpy.data.scenes), len(compat.compositor_tree(mixed).nodes)) == (scenes, nodes)
    assert len(compat.compositor_tree(mixed).links) == links
    assert {o.name for o in other.objects} == {"splats", "more"}
    assert (other.camera, other.render.resolution_x) == (camera, 80)
    got = lab.render_exr(tmp_path)
    assert got.shape[:2] == (48, 80)
    assert encode(got[24, 40, :3]) == pytest.approx((0.1, 0.1, 0.1), abs=0.02)


def test_splats_added_later_are_named(mixed, tmp_path, capfd):
    """Oracle: the panel and the render name them until the button is pressed again; hidden ones
    and those of other scenes are not missing."""
    compositor.set_up(mixed)
    sentence = unsupported_settings.NOT_COMPOSITED.format("more")
    assert "is not composited" not in drawn(RenderPanel)
    more = lab.add(mixed, lab.wall(3.0, (0.1, 0.1, 0.1), half=0.1), "more")
    assert sentence in drawn(RenderPanel)
    lab.render_exr(tmp_path)
    assert sentence in "".join(capfd.readouterr())
    more.hide_render = True
    assert sentence not in drawn(RenderPanel)
    more.hide_render = False
    compositor.set_up(mixed)
    assert sentence not in drawn(RenderPanel)


def test_taking_down_a_linked_copy_keeps_the_original(mixed, tmp_path):
    """Oracle: the picture of the original before; its splats are not drawn by Cycles too."""
    compositor.set_up(mixed)
    before = lab.render_exr(tmp_path, "before")
    bpy.ops.scene.new(type="LINK_COPY")
    compositor.set_up(bpy.context.scene)
    compositor.take_down(bpy.context.scene)
    assert not any(m.show_render for m in bpy.data.objects["splats"].modifiers)
    bpy.context.window.scene = mixed
    np.testing.assert_allclose(lab.render_exr(tmp_path, "after"), before, atol=1e-3)
    compositor.take_down(mixed)
    assert all(m.show_render for m in bpy.data.objects["splats"].modifiers)


def test_the_view_is_followed(mixed, tmp_path):
    """Oracle: camera and pixel aspect of the meshes' scene; an error if it is too late."""
    other = compositor.set_up(mixed)
    camera = bpy.data.objects.new("second", bpy.data.cameras.new("second"))
    mixed.collection.objects.link(camera)
    mixed.camera, mixed.render.pixel_aspect_x = camera, 1.5
    bpy.context.view_layer.update()
    assert (other.camera, other.render.pixel_aspect_x) == (camera, 1.5)
    other.camera = bpy.data.objects["Camera"]
    bpy.context.window.scene = other
    message = lab.error_of(lambda: lab.render_exr(tmp_path))
    assert "is Camera" in message and "Composite Splats with Meshes" in message


def test_it_rests_while_the_splats_engine_renders(mixed, tmp_path):
    """Oracle: the splats' own picture before the set-up; alpha is not counted twice. Meshes are
    rendered again with their engine."""
    mixed.render.film_transparent, mixed.render.engine = True, "GSCORE_SPLATS"
    soft = lab.add(mixed, lab.blob(60, center=(0, 0, 1.0), size=0.4), "soft")
    bpy.data.objects.remove(bpy.data.objects["splats"])
    want = lab.render_exr(tmp_path, "alone")
    assert want[..., 3].max() > 0.1 and soft.name in mixed.objects
    mixed.render.engine = "CYCLES"
    compositor.set_up(mixed)
    among = lab.render_exr(tmp_path, "among")
    mixed.render.engine = "GSCORE_SPLATS"
    np.testing.assert_allclose(lab.render_exr(tmp_path, "resting"), want, atol=1e-4)
    assert "meshes is off" in drawn(RenderPanel)
    mixed.render.engine = "CYCLES"
    np.testing.assert_allclose(lab.render_exr(tmp_path, "again"), among, atol=1e-3)


def test_it_can_be_taken_down(mixed, tmp_path):
    """Oracle: scenes, displays, film, the user's nodes and their links as before."""
    tree = compat.make_compositor_tree(mixed)
    film = mixed.render.film_transparent = False
    ends = {(x.from_node.name, x.to_node.name) for x in tree.links}
    compositor.set_up(mixed)
    assert bpy.ops.gscore.remove_compositing() == {"FINISHED"}
    assert {(x.from_node.name, x.to_node.name) for x in tree.links} == ends
    assert len(bpy.data.scenes) == 1 and mixed.render.film_transparent == film
    assert all(m.show_render for m in bpy.data.objects["splats"].modifiers)
    assert "no compositing" in lab.error_of(bpy.ops.gscore.remove_compositing)
    lab.render_exr(tmp_path)


def test_the_shutter_and_its_curve_are_followed(mixed):
    """Oracle: values of the curve of the splats' scene, and the settings of the meshes' scene."""
    scene = mixed
    other = compositor.set_up(scene)
    curve = scene.render.motion_blur_shutter_curve
    curve.curves[0].points.new(0.3, 0.2)
    curve.curves[0].points[0].location.y = 0.5
    curve.curves[0].points[0].handle_type = "VECTOR"
    curve.update()
    scene.render.use_motion_blur = True
    scene.render.frame_map_new = 150
    scene.view_layers[0].use_motion_blur = False
    bpy.context.view_layer.update()
    assert other.render.use_motion_blur and other.render.frame_map_new == 150
    assert not other.view_layers[0].use_motion_blur
    own = shutter_lens.shutter_of(other).curve
    assert own == shutter_lens.shutter_of(scene).curve and min(own) < 0.3
    curve.curves[0].points.remove(curve.curves[0].points[1])
    curve.update()
    scene.render.motion_blur_shutter = 0.7
    bpy.context.view_layer.update()
    assert shutter_lens.shutter_of(other) == shutter_lens.shutter_of(scene)


def test_markers_change_the_camera(mixed, tmp_path):
    """Oracle: the splats' red fills less of a frame from twice the distance."""
    far = bpy.data.objects.new("far", bpy.data.cameras.new("far"))
    mixed.collection.objects.link(far)
    far.location = (0, 0, 8)
    other = compositor.set_up(mixed)
    for frame, camera in ((1, mixed.camera), (2, far)):
        mixed.timeline_markers.new(camera.name, frame=frame).camera = camera
    bpy.context.view_layer.update()
    mixed.frame_end = 2
    mixed.render.image_settings.file_format = "PNG"
    mixed.render.filepath = str(tmp_path / "f")
    bpy.ops.render.render(animation=True)
    near, distant = (lab.read_image(tmp_path / f"f000{i}.png") for i in (1, 2))
    red = [int((p[..., 0] > 0.5).sum()) for p in (near, distant)]
    assert red[0] > 1000 and 50 < red[1] < red[0] / 2
    mixed.timeline_markers.clear()
    compositor.set_up(mixed)
    assert not other.timeline_markers


def test_import_and_render_change_no_compositing(scene):
    """Oracle: scene and trees after import and a render by the add-on's engine."""
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    bpy.ops.render.render()
    assert len(bpy.data.scenes) == 1 and not bpy.data.node_groups.get(composite_nodes.GROUP)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda s: setattr(s, "camera", None), "no camera"),
        (lambda s: bpy.data.objects.remove(bpy.data.objects["splats"]), "no splat objects"),
    ],
)
def test_refusals_leave_the_file_alone(mixed, spoil, words):
    """Oracle: one error; as many scenes and node groups as before."""
    spoil(mixed)
    counts = len(bpy.data.scenes), len(bpy.data.node_groups), mixed.render.film_transparent
    assert words in lab.error_of(bpy.ops.gscore.set_up_compositing)
    assert counts == (
        len(bpy.data.scenes),
        len(bpy.data.node_groups),
        mixed.render.film_transparent,
    )


def in_collection(scene, ob) -> None:
    """Put an object into a new collection."""
    own = bpy.data.collections.new("own")
    scene.collection.children.link(own)
    own.objects.link(ob)
    scene.collection.objects.unlink(ob)


def switch(scene, name: str, *, on: bool) -> None:
    """Set a switch of that collection, or of the view layer's."""
    layer = scene.view_layers[0].layer_collection.children["own"]
    setattr(layer.collection if name == "hide_render" else layer, name, on)


@pytest.mark.parametrize("hide", ["hide_render", "exclude", "indirect_only", "holdout"])
def test_hidden_collections_are_respected(mixed, tmp_path, hide):
    """Oracle: the scene by construction without the wall, whose hole shows no mesh behind it
    either; then the earlier picture."""
    in_collection(mixed, bpy.data.objects["splats"])
    compositor.set_up(mixed)
    before = lab.render_exr(tmp_path, "before")
    switch(mixed, hide, on=True)
    hidden = lab.render_exr(tmp_path, "hidden")
    assert hidden[24, 32, 3] == 0
    blue = (0, 0, 0, 0) if hide == "holdout" else (0, 0, 1, 1)
    assert hidden[24, 38] == pytest.approx(blue, abs=1e-2)
    assert hidden[24, 22, :3] == pytest.approx((0, 1, 0), abs=1e-2)
    switch(mixed, hide, on=False)
    np.testing.assert_array_equal(lab.render_exr(tmp_path, "after"), before)


def test_held_out_splats_hide_all_that_is_behind_them(mixed, tmp_path):
    """Oracle: the scene by construction: a holdout wall in front of red splats and a blue mesh, and
    behind a green one."""
    lab.add(mixed, lab.wall(1.5, (0.1, 0.1, 0.9), half=0.5), "cut")
    in_collection(mixed, bpy.data.objects["cut"])
    switch(mixed, "holdout", on=True)
    compositor.set_up(mixed)
    got = lab.render_exr(tmp_path)
    assert got[24, 32, 3] < 0.02
    assert got[24, 38].max() < 0.02
    assert got[24, 22] == pytest.approx((0, 1, 0, 1), abs=1e-2)
    assert got[24, 62] == pytest.approx((0, 0, 1, 1), abs=1e-2)
    bpy.data.objects["cut"].location.z = -3.0  # behind everything
    got = lab.render_exr(tmp_path, "far")
    assert encode(got[24, 38, :3]) == pytest.approx(RED, abs=0.01)
    assert got[24, 62] == pytest.approx((0, 0, 1, 1), abs=1e-2)


@pytest.mark.parametrize("z", [1.02, 0.98])
def test_a_catcher_before_splats_darkens_them(mixed, tmp_path, z):
    """Oracle: the shadow of a mesh by construction: it is on the splats if the shadow catcher is a
    little in front of them, and covered by them otherwise."""
    bpy.data.objects.remove(bpy.data.objects["behind"])
    ground = plane(mixed, z, (1, 1, 1), -2.0, 2.0, "ground")
    ground.is_shadow_catcher = True
    ground.data.materials.clear()
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.angle, sun.rotation_euler = 0.0, (0, -np.pi / 4, 0)  # down and to the right
    mixed.collection.objects.link(sun)
    mixed.cycles.samples = 16
    compositor.set_up(mixed)
    row = lab.render_exr(tmp_path)[24]
    assert row[20, :3] == pytest.approx((0, 1, 0), abs=0.01)
    assert encode(row[30, :3]) == pytest.approx(RED, abs=0.02)
    if z > 1:  # what is left is light of the green plane
        assert row[45, 0] < 0.05 * row[30, 0]
    else:
        assert encode(row[45, :3]) == pytest.approx(RED, abs=0.02)
    assert row[45, 3] == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize("lens", [False, True])
def test_soft_splats_that_are_held_out_cut_softly(mixed, tmp_path, lens):
    """Oracle: in front of a mesh that fills the picture, the splats' scene alone, plus the mesh
    times the transmittance of all splats, from the alpha of a render without holdouts. With depth
    of field too, except where the sharp picture, whose depths are used, is empty."""
    for name in ("splats", "before", "behind"):
        bpy.data.objects.remove(bpy.data.objects[name])
    back = plane(mixed, -1.0, (0, 0, 1), -9.0, 9.0, "back")
    back.scale.y = 20.0
    lab.add(mixed, lab.blob(60, center=(0.2, 0, 1.0), size=0.4), "soft")
    cut = lab.add(mixed, lab.blob(80, center=(-0.2, 0.1, 1.1), size=0.4), "cut")
    if lens:
        mixed.camera.data.dof.use_dof, mixed.camera.data.dof.aperture_fstop = True, 0.3
        mixed.camera.data.dof.focus_distance = 2.5
        mixed.gscore_render.blur_samples = 4
    other = compositor.set_up(mixed)
    bpy.context.window.scene = other
    every = lab.render_exr(tmp_path, "every")
    cut.is_holdout = True
    alone = lab.render_exr(tmp_path, "alone")
    bpy.context.window.scene = mixed
    got = lab.render_exr(tmp_path, "both")
    want = alone + (1 - every[..., 3:]) * np.float32([0, 0, 1, 1])
    np.testing.assert_allclose(got, want, atol=2e-2 if lens else 5e-3)
    soft = (got[..., 3] > 0.1) & (got[..., 3] < 0.9)
    assert soft.mean() > 0.02 and got[..., 3].min() < 0.3


@pytest.mark.parametrize("alpha", [1.0, 0.6])
@pytest.mark.parametrize("shown", [2.2, -2.2])
@pytest.mark.parametrize("held", [1.1, -1.1])
def test_holdout_splats_blend_in_depth_order(mixed, tmp_path, alpha, shown, held):
    """Oracle: alpha blending of layers: soft holdout splats, and others, in front of or behind a
    mesh that fills the picture, and a bright world behind all; the splats as rendered alone by
    their scene."""
    for name in ("splats", "before", "behind"):
        bpy.data.objects.remove(bpy.data.objects[name])
    paint_world(mixed, 3.0, 1.0, 0.2)
    glass(mixed, 0.0, (0, 0, 1), alpha)
    seen = lab.add(mixed, lab.blob(60, center=(0.2, 0, shown), size=0.5), "seen")
    cut = lab.add(mixed, lab.blob(80, center=(-0.1, 0.1, held), size=0.5, seed=80), "cut")
    bpy.context.window.scene = compositor.set_up(mixed)
    layers = []
    for ob, other in ((seen, cut), (cut, seen)):
        ob.hide_render, other.hide_render = False, True
        layers.append(lab.render_exr(tmp_path, ob.name))
    seen.hide_render = False
    mesh, world = np.float32([0, 0, alpha, alpha]), np.float32([3.0, 1.0, 0.2, 1])
    layers = [(shown, layers[0]), (held, layers[1]), (0.0, mesh), (-9.0, world)]
    want, left = 0.0, 1.0
    for z, layer in sorted(layers, key=lambda one: -one[0]):
        want = want + (0.0 if z == held else left * layer)
        left = left * (1 - layer[..., 3:])
    cut.is_holdout = True
    bpy.context.window.scene = mixed
    got = lab.render_exr(tmp_path, "got")
    np.testing.assert_allclose(got, want, atol=8e-3)
    if held > 0 or alpha < 1:
        assert got[..., 3].min() < 0.8 and ((got[..., 3] > 0.1) & (got[..., 3] < 0.9)).any()


def test_edges_of_opaque_things_show_no_world(mixed, tmp_path):
    """Oracle: the scene by construction: a black plane in front of an opaque red wall, so that
    nothing of a bright green world shows along the edge."""
    bpy.data.objects.remove(bpy.data.objects["behind"])
    ob = bpy.data.objects["before"]
    ob.data.materials[0] = emitter("dark", (0, 0, 0))
    ob.rotation_euler.z = 0.2
    paint_world(mixed, 0.0, 9.0, 0.0)
    compositor.set_up(mixed)
    got = lab.render_exr(tmp_path)[14:34, 16:48]
    assert got[..., 0].min() < 0.01 and got[..., 0].max() > 0.7
    assert got[..., 1].max() < 0.05
    np.testing.assert_allclose(got[..., 3], 1, atol=2e-3)


def test_held_out_splats_hide_the_world(mixed, tmp_path):
    """Oracle: nothing in the hole, the world next to it and behind a green mesh."""
    paint_world(mixed, 0.1, 0.2, 0.8)
    bpy.data.objects.remove(bpy.data.objects["behind"])
    bpy.data.objects["splats"].is_holdout = True
    compositor.set_up(mixed)
    got = lab.render_exr(tmp_path)
    assert np.abs(got[24, 40]).max() < 0.02
    assert got[2, 62] == pytest.approx((0.1, 0.2, 0.8, 1), abs=0.01)
    assert got[24, 20] == pytest.approx((0, 1, 0, 1), abs=0.01)


def test_held_out_meshes_hide_splats(mixed, tmp_path, capfd):
    """Oracle: the scene by construction; a later holdout is named."""
    compositor.set_up(mixed)
    before = lab.render_exr(tmp_path, "before")
    mixed.objects["before"].is_holdout = True
    sentence = unsupported_settings.NOT_TAKEN_OVER.format("before")
    assert sentence in drawn(RenderPanel)
    lab.render_exr(tmp_path, "later")
    assert sentence in capfd.readouterr().out
    compositor.set_up(mixed)
    got = lab.render_exr(tmp_path, "held")
    assert "Holdout" not in drawn(RenderPanel) + capfd.readouterr().out
    assert got[24, 22, 3] < 0.02 and before[24, 22, 3] > 0.99
    assert encode(got[24, 38, :3]) == pytest.approx(RED, abs=0.01)
    mixed.objects["before"].is_holdout = False
    np.testing.assert_array_equal(lab.render_exr(tmp_path, "after"), before)


def test_views_of_several_cameras_are_refused_by_name(mixed, capfd):
    """Oracle: Blender's output: the error of the splats' engine, and no other."""
    compositor.set_up(mixed)
    bpy.ops.render.render()
    assert "several cameras" not in capfd.readouterr().out
    mixed.render.use_multiview, mixed.render.views_format = True, "MULTIVIEW"
    bpy.ops.render.render()
    assert "Multi-View is not supported" in capfd.readouterr().out


def test_the_world_stays_behind_everything(mixed, tmp_path):
    """Oracle: the meshes' own picture where no splats are, before and after; it follows changes of
    the world; the splats are as without a world."""
    paint_world(mixed, 0.1, 0.2, 0.8)
    before = lab.render_exr(tmp_path, "before")
    assert before[2, 62] == pytest.approx((0.1, 0.2, 0.8, 1), abs=0.01)
    compositor.set_up(mixed)
    got = lab.render_exr(tmp_path, "both")
    np.testing.assert_allclose(got[2, 62], before[2, 62], atol=0.01)
    np.testing.assert_allclose(got[24, 62], before[24, 62], atol=0.02)
    assert encode(got[24, 38, :3]) == pytest.approx(RED, abs=0.01)
    film = mixed.render.film_transparent
    paint_world(mixed, 0.7, 0.2, 0.1)
    mixed.render.film_transparent = film
    assert lab.render_exr(tmp_path, "red")[2, 62, 0] == pytest.approx(0.7, abs=0.01)
    compositor.take_down(mixed)
    assert len(bpy.data.scenes) == 1 and not mixed.render.film_transparent
    np.testing.assert_allclose(
        lab.render_exr(tmp_path, "after")[2, 62], (0.7, 0.2, 0.1, 1), atol=0.01
    )


def test_a_film_that_was_transparent_stays_so(mixed, tmp_path):
    """Oracle: no scene for a world, and alpha 0 in empty areas."""
    mixed.world = bpy.data.worlds.new("unseen")
    compositor.set_up(mixed)
    assert len(bpy.data.scenes) == 2
    assert lab.render_exr(tmp_path)[2, 62, 3] == 0


def test_it_is_set_up_from_the_engine_of_splats(mixed, tmp_path):
    """Oracle: the earlier engine, which removing restores; with the add-on's engine, film and
    picture are those without compositing."""
    paint_world(mixed, 0.1, 0.2, 0.8)
    assert bpy.ops.gscore.use_engine() == {"FINISHED"}
    alone = lab.render_exr(tmp_path, "alone")
    assert bpy.ops.gscore.set_up_compositing() == {"FINISHED"}
    assert mixed.render.engine == "CYCLES" and mixed.render.film_transparent
    mixed.render.engine = "GSCORE_SPLATS"
    bpy.context.view_layer.update()
    assert not mixed.render.film_transparent
    assert "Compositing with meshes is off" in drawn(RenderPanel)
    np.testing.assert_array_equal(lab.render_exr(tmp_path, "rests"), alone)
    assert bpy.ops.gscore.set_up_compositing() == {"FINISHED"}
    assert mixed.render.engine == "CYCLES" and mixed.render.film_transparent
    assert bpy.ops.gscore.remove_compositing() == {"FINISHED"}
    assert mixed.render.engine == "GSCORE_SPLATS" and not mixed.render.film_transparent


def test_an_engine_that_is_gone_is_replaced(mixed):
    """Oracle: Blender's own names of EEVEE."""
    mixed.render.engine, mixed["gs_engine_before"] = "GSCORE_SPLATS", "NOT_THERE"
    compositor.set_up(mixed)
    assert mixed.render.engine in ("BLENDER_EEVEE", "BLENDER_EEVEE_NEXT")


@pytest.mark.parametrize(
    "lacking",
    [
        (),
        HOLDOUT_PASSES[3:],
        HOLDOUT_PASSES,
        ("World", *HOLDOUT_PASSES),
    ],
)
def test_an_older_file_keeps_its_links(mixed, tmp_path, lacking):
    """Oracle: the picture of a new set-up with holdout splats and a holdout mesh, and one group,
    although the file has an older one."""
    paint_world(mixed, 0.1, 0.2, 0.8)
    lab.add(mixed, lab.wall(1.5, (0.1, 0.1, 0.9), half=0.3), "cut").is_holdout = True
    mixed.objects["behind"].is_holdout = True
    compositor.set_up(mixed)
    want = lab.render_exr(tmp_path, "new")
    tree = compat.compositor_tree(mixed)
    combine = tree.nodes[composite_nodes.COMBINE_NODE]
    group = combine.node_tree
    old = group.copy()
    del old["gs_form"]
    old.nodes.remove(next(n for n in old.nodes if n.type == "COMBINE_COLOR"))  # another formula
    for item in [i for i in old.interface.items_tree if i.name in lacking]:
        old.interface.remove(item)
    targets = [link.to_socket for link in combine.outputs[0].links]
    combine.node_tree = old
    for target in targets:
        tree.links.new(combine.outputs[0], target)
    for _ in range(2):
        compositor.set_up(mixed)
        assert combine.node_tree == group and combine.outputs[0].links
    np.testing.assert_allclose(lab.render_exr(tmp_path, "again"), want, atol=1e-4)


def test_later_settings_are_kept(mixed):
    """Oracle: the user's engine, and the earlier film if edges should not blend."""
    paint_world(mixed, 0.1, 0.2, 0.8)
    mixed.render.engine = "GSCORE_SPLATS"
    compositor.set_up(mixed)
    mixed.render.engine = "CYCLES"
    assert len(bpy.data.scenes) == 3
    compositor.set_up(mixed, transparent=False)
    assert not mixed.render.film_transparent and len(bpy.data.scenes) == 2
    compositor.take_down(mixed)
    assert mixed.render.engine == "CYCLES"


def test_a_world_that_no_layer_shows_stays_away(mixed, tmp_path):
    """Oracle: the corner of the picture, and its brightness with another exposure of the film."""
    paint_world(mixed, 0.1, 0.2, 0.8)
    mixed.cycles.film_exposure = 2.0
    before = lab.render_exr(tmp_path, "before")[2, 62]
    compositor.set_up(mixed)
    np.testing.assert_allclose(lab.render_exr(tmp_path, "both")[2, 62], before, atol=0.02)
    compositor.take_down(mixed)
    mixed.view_layers[0].use_sky = False
    compositor.set_up(mixed)
    assert lab.render_exr(tmp_path, "dark")[2, 62, :3].max() < 1e-3
