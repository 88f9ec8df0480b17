"""Holdout meshes cut composites, including the world. Oracle: Cycles' own picture of the same
meshes, and alpha blending of layers."""

import bpy
import numpy as np
import pytest

from addon.panels.render import RenderPanel
from addon.render import compositor
from tests.addon import splat_scenes as lab
from tests.addon.drawn import drawn
from tests.addon.mesh_scenes import emitter, glass, paint_world, plane
from tests.addon.render.test_generated_instances import on_points

SIZE, WORLD = (64, 48), (3.0, 1.0, 0.2)


@pytest.fixture
def lit(scene):
    """A camera that looks down at a bright world in Cycles, with a box filter like that of the
    splats."""
    lab.prepare(scene, SIZE)
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 64, False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 1.0
    paint_world(scene, *WORLD)
    return scene


def hole(scene, *, z: float = 0.5, edge: float = 0.013) -> bpy.types.Object:
    """A plane from the left to an edge, held out."""
    ob = plane(scene, z, (1, 1, 1), -9.0, edge, "hole")
    ob.is_holdout = True
    return ob


def as_mesh(scene) -> bpy.types.Object:
    """Held out by itself."""
    ob = hole(scene)
    ob.rotation_euler.z = 0.3
    return ob


def in_collection(scene) -> bpy.types.Object:
    """Held out by its collection."""
    ob = as_mesh(scene)
    own = bpy.data.collections.new("own")
    scene.collection.children.link(own)
    own.objects.link(ob)
    scene.collection.objects.unlink(ob)
    ob.is_holdout = False
    scene.view_layers[0].layer_collection.children["own"].holdout = True
    return ob


def of_collection(scene) -> bpy.types.Object:
    """An instance of a collection, held out."""
    ob = as_mesh(scene)
    own = bpy.data.collections.new("own")
    own.objects.link(ob)
    scene.collection.objects.unlink(ob)
    ob.is_holdout = False
    empty = bpy.data.objects.new("empty", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", own
    scene.collection.objects.link(empty)
    empty.is_holdout = True
    return empty


def by_nodes(scene) -> bpy.types.Object:
    """Instances made by geometry nodes."""
    mesh = bpy.data.meshes.new("corners")
    mesh.from_pydata([(-0.5, 0.1, 0), (0.4, 0.2, 0.3)], [], [])
    ob = bpy.data.objects.new("owner", mesh)
    ob.scale = 2, 2, 2
    scene.collection.objects.link(ob)
    ob.modifiers.new("nodes", "NODES").node_group = on_points(None)
    ob.is_holdout = True
    return ob


def as_text(scene) -> bpy.types.Object:
    """Letters."""
    curve = bpy.data.curves.new("text", "FONT")
    curve.body, curve.size = "Go", 1.2
    ob = bpy.data.objects.new("text", curve)
    ob.location = -0.8, -0.4, 0
    scene.collection.objects.link(ob)
    ob.is_holdout = True
    return ob


def as_curve(scene) -> bpy.types.Object:
    """A thick ring."""
    curve = bpy.data.curves.new("ring", "CURVE")
    curve.dimensions, curve.bevel_depth = "3D", 0.15
    spline = curve.splines.new("POLY")
    spline.points.add(3)
    for point, place in zip(
        spline.points, ((-0.7, -0.5), (0.6, -0.4), (0.5, 0.5), (-0.4, 0.4)), strict=True
    ):
        point.co = (*place, 0, 1)
    spline.use_cyclic_u = True
    ob = bpy.data.objects.new("ring", curve)
    scene.collection.objects.link(ob)
    ob.is_holdout = True
    return ob


@pytest.mark.parametrize(
    "held", [as_mesh, in_collection, of_collection, by_nodes, as_text, as_curve]
)
@pytest.mark.parametrize("hidden", [False, True])
def test_the_world_is_cut_as_by_cycles_alone(lit, tmp_path, held, hidden):
    """Oracle: Cycles' picture before, with a mesh in front of the holdout and one behind it, and
    again after the removal; the splats are out of view, or not rendered."""
    held(lit)
    plane(lit, 1.5, (0, 1, 0), -0.9, -0.5, "before")
    plane(lit, -1.0, (0, 0, 1), 0.6, 1.2, "behind")
    splats = lab.add(lit, lab.wall(9.0, (0.9, 0.1, 0.1)))
    splats.hide_render = hidden
    want = lab.render_exr(tmp_path, "want")
    cut = want[..., 3] < 0.01
    assert 60 < cut.sum() < 0.7 * cut.size and want[2, 62] == pytest.approx((*WORLD, 1), abs=1e-3)
    compositor.set_up(lit)
    got = lab.render_exr(tmp_path, "got")
    np.testing.assert_allclose(got[cut], want[cut], atol=1e-3)
    inside = np.isin(want[..., 3], (0, 1))
    np.testing.assert_allclose(got[inside], want[inside], atol=1e-3)
    # Meshes are sampled at 16 points of a pixel; pixels where two edges cross are undefined.
    off = np.abs(got - want)[..., 3]
    assert (off > 0.1).sum() <= 6 and off.max() < 0.4 and off.mean() < 3e-3
    compositor.take_down(lit)
    np.testing.assert_allclose(lab.render_exr(tmp_path, "after"), want, atol=1e-4)


def only(scene, shown: bpy.types.Object, tmp_path) -> np.ndarray:
    """Picture of some splats without all others and without meshes."""
    hidden = {ob: ob.hide_render for ob in scene.objects}
    for ob in hidden:
        ob.hide_render = ob != shown
    got = lab.render_exr(tmp_path, shown.name)
    for ob, was in hidden.items():
        ob.hide_render = was
    return got


@pytest.mark.parametrize("alpha", [1.0, 0.6])
@pytest.mark.parametrize("shown", [2.2, -2.2])
@pytest.mark.parametrize("soft", [1.1, -1.1])
@pytest.mark.parametrize("cut", [False, True])
def test_surfaces_in_front_of_a_holdout_stay(lit, tmp_path, alpha, shown, soft, cut):
    """Oracle: alpha blending of layers: soft splats and glass, each in front of or behind a holdout
    plane, and holdout splats far behind it; the splats as rendered alone by their scene. Layers in
    front of the plane stay, and the world shows only outside of it."""
    glass(lit, shown, (0, 0, 1), alpha)
    near = lab.add(lit, lab.blob(60, center=(0, 0, soft), size=0.6), "near")
    far = lab.add(lit, lab.blob(60, center=(0.3, 0, -6.0), size=0.9, seed=9), "far")
    held, edge = hole(lit, z=0.0), SIZE[0] // 2
    held.scale.y = 20.0
    bpy.context.window.scene = compositor.set_up(lit)
    layers = [(soft, only(lit, near, tmp_path)), (-6.0, cut * only(lit, far, tmp_path))]
    layers += [(shown, np.float32([0, 0, alpha, alpha])), (-9.0, np.float32([*WORLD, 1]))]
    want, left = np.zeros((*SIZE[::-1], 4), np.float32), np.ones((*SIZE[::-1], 1), np.float32)
    for z, layer in sorted(layers, key=lambda one: -one[0]):
        if z < 0:
            left[:, :edge] = 0
        if z != -6.0:
            want += left * layer
        left = left * (1 - layer[..., 3:])
    far.is_holdout, far.hide_render = True, not cut
    bpy.context.window.scene = lit
    got = lab.render_exr(tmp_path, "got")
    # Depths change at the plane's edge, where the depth order is smoothed.
    beside = np.abs(np.arange(SIZE[0]) - edge) > 6
    np.testing.assert_allclose(got[:, beside], want[:, beside], atol=8e-3)
    assert soft < 0 or got[:, :edge, 3].max() > 0.5
    assert shown > 0 or soft > 0 or not got[:, : edge - 1].any()


@pytest.mark.parametrize("what", ["splats", "mesh", "both"])
def test_edges_of_holes_in_opaque_things_show_no_world(lit, tmp_path, what):
    """Oracle: by construction: a holdout plane in front of a black, opaque object, so that nothing
    of a bright world shows along its edge."""
    paint_world(lit, 9.0, 9.0, 9.0)
    lab.add(lit, lab.wall(0.0, (0, 0, 0), half=1.5 if what != "mesh" else 0.01))
    if what != "splats":
        dark = plane(lit, -0.5, (0, 0, 0), -9.0, 9.0, "dark")
        dark.scale.y = 20.0
    as_mesh(lit)
    compositor.set_up(lit)
    got = lab.render_exr(tmp_path)[8:40, 12:52]
    assert got[..., 3].min() < 1e-3 and got[..., 3].max() > 0.999
    assert ((got[..., 3] > 0.2) & (got[..., 3] < 0.8)).sum() > 10
    assert got[..., :3].max() < 0.08 * 9
    assert np.percentile(got[..., :3], 99) < 0.03 * 9


@pytest.mark.parametrize("turned", [0.0, 0.3, 1.2])
@pytest.mark.parametrize("lens", [False, True])
def test_edges_of_holes_show_no_mesh_through_splats(lit, tmp_path, turned, lens):
    """Oracle: by construction: a holdout plane in front of opaque black splats, so that nothing of
    a bright mesh behind them shows along its edge, wherever in a pixel the edge is."""
    glass(lit, -0.5, (1, 1, 1), 1.0)
    lab.add(lit, lab.wall(0.0, (0, 0, 0), half=1.5))
    held = hole(lit)
    held.rotation_euler.z = turned
    if lens:
        lit.camera.data.dof.use_dof, lit.camera.data.dof.aperture_fstop = True, 0.3
        lit.camera.data.dof.focus_distance = 4.2
    compositor.set_up(lit)
    for at in (0.0, 0.01, 0.03):
        held.location.x = at
        got = lab.render_exr(tmp_path)[8:40, 12:52]
        assert got[..., 3].min() < 1e-3 and got[..., 3].max() > 0.999
        assert ((got[..., 3] > 0.2) & (got[..., 3] < 0.8)).sum() > 10
        assert got[..., :3].max() < 0.1


def test_a_hole_behind_meshes_changes_nothing(lit, tmp_path):
    """Oracle: the picture without it, everywhere and along its edge: soft splats in front of an
    opaque mesh in front of the hole."""
    glass(lit, 0.5, (0, 0, 1), 1.0)
    soft = lab.add(lit, lab.blob(60, center=(0, 0, 1.5), size=0.6))
    held = hole(lit, z=-0.5)
    held.scale.y = 20.0
    compositor.set_up(lit)
    got = lab.render_exr(tmp_path, "held")
    held.hide_render = True
    # Where the splats fade out, only their last thousandths are smoothed.
    np.testing.assert_allclose(got, lab.render_exr(tmp_path, "want"), atol=8e-3)
    bpy.context.window.scene = compositor.set_up(lit)
    alpha = only(lit, soft, tmp_path)[:, : SIZE[0] // 2, 3]
    assert ((alpha > 0.2) & (alpha < 0.8)).sum() > 100


@pytest.mark.parametrize("lens", ["blurred", "equirectangular", "fisheye", "orthographic"])
def test_holes_are_cut_through_every_lens(lit, tmp_path, lens):
    """Oracle: Cycles' own picture; splats are not rendered."""
    as_mesh(lit)
    lab.add(lit, lab.wall(9.0, (0.9, 0.1, 0.1))).hide_render = True
    data = lit.camera.data
    if lens == "blurred":
        data.dof.use_dof, data.dof.aperture_fstop, data.dof.focus_distance = True, 0.2, 5.0
        lit.gscore_render.blur_samples = 64
    elif lens == "orthographic":
        data.type, data.ortho_scale = "ORTHO", 3.0
    else:
        data.type = "PANO"
        kind = "EQUIRECTANGULAR" if lens == "equirectangular" else "FISHEYE_EQUIDISTANT"
        owner = data if hasattr(data, "panorama_type") else data.cycles
        owner.panorama_type = kind
    want = lab.render_exr(tmp_path, "want")
    compositor.set_up(lit)
    got = lab.render_exr(tmp_path, "got")
    off = np.abs(got - want)
    middle = slice(SIZE[1] // 4, -SIZE[1] // 4), slice(SIZE[0] // 4, -SIZE[0] // 4)
    assert (want[middle][..., 3] < 0.01).sum() > 30
    assert off[..., 3].max() < 0.15 and off[middle].mean() < 8e-3


def test_motion_blurs_a_hole(lit, tmp_path):
    """Oracle: Cycles' own picture of a plane that moves."""
    ob = as_mesh(lit)
    lab.moving(ob, 0.2)
    lit.frame_set(5)
    lit.render.use_motion_blur, lit.gscore_render.blur_samples = True, 64
    lab.add(lit, lab.wall(9.0, (0.9, 0.1, 0.1)))
    want = lab.render_exr(tmp_path, "want")
    compositor.set_up(lit)
    off = np.abs(lab.render_exr(tmp_path, "got") - want)
    assert ((want[..., 3] > 0.2) & (want[..., 3] < 0.8)).sum() > 60
    assert off[..., 3].max() < 0.15 and off.mean() < 8e-3


def test_holes_come_and_go_with_what_is_held_out(lit, tmp_path):
    """Oracle: the world where nothing is held out or rendered; the panel's message."""
    ob, color = hole(lit), pytest.approx((*WORLD, 1), abs=1e-3)
    ob.is_holdout, ob.data.materials[0] = False, emitter("black", (0, 0, 0))
    lab.add(lit, lab.wall(9.0, (0.9, 0.1, 0.1)))

    def corners(name: str) -> tuple[np.ndarray, np.ndarray]:
        got = lab.render_exr(tmp_path, name)
        return got[24, 4], got[24, 60]

    compositor.set_up(lit)
    ob.is_holdout = True
    assert "Holdout of hole" in drawn(RenderPanel)
    compositor.set_up(lit)
    assert "Holdout of hole" not in drawn(RenderPanel)
    left, right = corners("held")
    assert not left.any() and right == color
    ob.hide_render = True
    assert all(corner == color for corner in corners("hidden"))
    ob.hide_render, ob.is_holdout = False, False
    assert corners("shown")[0] == pytest.approx((0, 0, 0, 1), abs=1e-3)
    ob.is_holdout, lit.render.film_transparent = True, True
    compositor.take_down(lit)
    lit.render.film_transparent = True
    compositor.set_up(lit)
    assert not any(corner.any() for corner in corners("no film"))
    lit.world = None
    compositor.set_up(lit)
    assert not any(corner.any() for corner in corners("no world"))


def test_the_panel_names_a_composite_of_an_earlier_version(lit):
    """Oracle: its message, until the button is pressed."""
    lab.add(lit, lab.wall(9.0, (0.9, 0.1, 0.1)))
    sentence = "Compositing was set up by an earlier version"
    assert sentence not in drawn(RenderPanel)
    compositor.set_up(lit)
    assert sentence not in drawn(RenderPanel)
    del compositor.combine_node(lit).node_tree["gs_form"]
    assert sentence in drawn(RenderPanel)
    compositor.set_up(lit)
    assert sentence not in drawn(RenderPanel)
