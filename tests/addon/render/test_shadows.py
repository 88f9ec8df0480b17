"""Shadows of meshes on splats, and of splats on meshes, by a proxy. Oracle, unless stated
otherwise: Cycles' pictures of a plane in place of the splats."""

import bpy
import numpy as np
import pytest

from addon import compat
from addon.panels.render import RenderPanel
from addon.render import composite_nodes, compositor
from addon.render.proxy import PROXIES, left_over
from addon.render.shadow_scene import SHADOW_SCENE, missing
from addon.splats.objects import proxy_of
from tests.addon import splat_scenes as lab
from tests.addon.drawn import drawn
from tests.light_changes import decode

SIZE = (48, 48)
COLOR = (0.8, 0.5, 0.2)


def lamp(scene: bpy.types.Scene, angle: float = 0.02) -> bpy.types.Object:
    """A sun that shines along +x and down."""
    made = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    made.data.energy, made.data.angle = 3.0, angle
    made.rotation_euler = (0, np.radians(-35), 0)
    scene.collection.objects.link(made)
    return made


def mesh_plane(size: float, z: float, name: str) -> bpy.types.Object:
    """A white diffuse square across the z axis."""
    bpy.ops.mesh.primitive_plane_add(size=size, location=(0, 0, z))
    ob = bpy.context.object
    ob.name = name
    white = bpy.data.materials.new(name)
    compat.use_nodes(white)
    white.node_tree.nodes.clear()
    shader = white.node_tree.nodes.new("ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (0.8, 0.8, 0.8, 1)
    out = white.node_tree.nodes.new("ShaderNodeOutputMaterial")
    white.node_tree.links.new(shader.outputs[0], out.inputs["Surface"])
    ob.data.materials.append(white)
    return ob


def use_proxy(splats: bpy.types.Object, mesh: bpy.types.Object) -> None:
    """The button's way."""
    for ob in bpy.context.view_layer.objects:
        ob.select_set(ob in (splats, mesh))
    bpy.context.view_layer.objects.active = splats
    assert bpy.ops.gscore.use_as_proxy() == {"FINISHED"}


@pytest.fixture
def shadowed(scene):
    """A wall of splats at z = 0 with a proxy, a cube above it, a sun and a grey world."""
    lab.prepare(scene, SIZE, light=0.3)
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 64, False
    splats = lab.add(scene, lab.wall(0.0, COLOR, half=1.5))
    mesh = mesh_plane(6.0, -0.003, "surface")
    lamp(scene)
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0, 0, 0.6))
    use_proxy(splats, mesh)
    return scene


def by_cycles(scene: bpy.types.Scene, folder, name: str, *, cube: bool) -> np.ndarray:
    """The plane's picture; the cube, if there, is not seen by the camera."""
    splats = next(ob for ob in scene.objects if ob.name.startswith("splats"))
    plane, box = bpy.data.objects["surface"], bpy.data.objects["Cube"]
    before = box.visible_camera
    scene.render.use_compositing = False
    for one in ("hide_render", "hide_viewport"):
        plane.driver_remove(one)
    splats.hide_render, plane.hide_render, plane.visible_camera = True, False, True
    box.hide_render, box.visible_camera = not cube, False
    picture = lab.render_exr(folder, name)
    splats.hide_render, plane.visible_camera = False, False
    box.hide_render, box.visible_camera = False, before
    scene.render.use_compositing = True
    return picture[..., :3]


def test_shadows_are_those_on_a_plane(shadowed, tmp_path):
    """The composite is the splats' picture times the plane's with the cube over that without,
    where the cube is not in front; dark in the shadow, and the splats' own elsewhere."""
    scene = shadowed
    compositor.set_up(scene)
    got = lab.render_exr(tmp_path, "ours")[..., :3]
    ratio = by_cycles(scene, tmp_path, "with", cube=True) / by_cycles(
        scene, tmp_path, "without", cube=False
    )
    light = decode(COLOR)
    wanted = ratio * light
    inside = (slice(10, 38), slice(30, 40))  # right of the cube, on the splats
    assert ratio[inside].min() < 0.5 < 0.95 < ratio[inside].max()
    error = np.abs(got - wanted)[inside]
    assert np.median(error) < 0.015
    assert np.percentile(error, 90) < 0.05


def test_without_casters_nothing_changes(shadowed, tmp_path):
    """Without the cube the composite is that without a proxy, but for noise of zero."""
    scene = shadowed
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    compositor.set_up(scene)
    got = lab.render_exr(tmp_path, "ours")
    assert bpy.ops.gscore.remove_proxy() == {"FINISHED"}
    bpy.data.objects["surface"].hide_render = True
    compositor.set_up(scene)
    assert SHADOW_SCENE not in scene
    tree = compat.compositor_tree(scene)
    assert composite_nodes.SHADE_NODE not in tree.nodes
    np.testing.assert_allclose(got, lab.render_exr(tmp_path, "plain"), atol=2e-3)


def test_new_and_moved_objects_cast_shadows(shadowed, tmp_path):
    """Without pressing the button again: a cube added to a collection, and moved splats with their
    proxy; after it for a cube of the scene itself, which the panel names before."""
    scene = shadowed
    props = bpy.data.collections.new("props")
    scene.collection.children.link(props)
    compositor.set_up(scene)
    assert missing(scene) == ""
    first = lab.render_exr(tmp_path, "a")[..., 0]
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0, 0.9, 0.6))
    second = bpy.context.object
    assert missing(scene) == second.name
    scene.collection.objects.unlink(second)
    props.objects.link(second)
    assert missing(scene) == ""
    both = lab.render_exr(tmp_path, "b")[..., 0]
    changed = np.abs(both - first) > 0.1
    assert changed[24 - 14 - 6 : 24 - 8, 30:42].any() != changed[24 + 8 : 24 + 20, 30:42].any()
    props.objects.unlink(second)
    scene.collection.objects.link(second)
    compositor.set_up(scene)
    assert missing(scene) == ""
    again = np.abs(lab.render_exr(tmp_path, "c")[..., 0] - both)
    assert np.percentile(again, 95) < 0.05
    splats = next(ob for ob in scene.objects if ob.name.startswith("splats"))
    splats.location.z = -0.6
    moved = lab.render_exr(tmp_path, "d")[..., 0]
    rows = [one[24, 24:] for one in (first, moved)]
    dark = [np.argwhere(row < 0.5 * row.max()).max() for row in rows]
    assert dark[1] > dark[0] + 3  # the shadow falls farther to the right


def test_proxy_follows_its_splats(shadowed):
    """Oracle: the transform and visibility of the splats; a second mesh takes its place; undone."""
    scene = shadowed
    splats = next(ob for ob in scene.objects if ob.name.startswith("splats"))
    proxy = proxy_of(splats)
    before = proxy.matrix_world.copy()
    splats.location.x, splats.hide_render = 2.0, True
    bpy.context.view_layer.update()
    assert proxy.matrix_world.translation.x == pytest.approx(before.translation.x + 2)
    assert proxy.hide_render
    assert not proxy.visible_camera
    for hidden in (True, False):
        splats.hide_viewport = hidden
        bpy.context.view_layer.update()
        assert proxy.visible_get() == (not hidden)
    splats.hide_render = False
    other = mesh_plane(1.0, 0.0, "other")
    use_proxy(splats, other)
    assert proxy_of(splats) == other
    assert proxy.visible_camera
    assert proxy.parent is None
    assert not proxy.hide_render
    bpy.context.view_layer.objects.active = splats
    assert bpy.ops.gscore.remove_proxy() == {"FINISHED"}
    assert proxy_of(splats) is None


def test_splats_shadow_meshes(scene, tmp_path):
    """A proxy above a white plane darkens it, though no camera sees the proxy."""
    lab.prepare(scene, SIZE, light=0.0)
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 16, False
    splats = lab.add(scene, lab.wall(0.8, COLOR, half=0.3))
    mesh = mesh_plane(0.6, 0.8, "surface")
    floor = mesh_plane(6.0, 0.0, "floor")
    lamp(scene)
    use_proxy(splats, mesh)
    compositor.set_up(scene)
    got = lab.render_exr(tmp_path, "with")[..., :3].mean(2)
    assert got.max() > 0.3
    row = got[24, 24:]
    assert row.min() < 0.02
    assert floor.visible_camera


def test_take_down(shadowed):
    """Scenes, twins, collections and nodes are removed."""
    scene = shadowed
    objects, scenes = len(bpy.data.objects), len(bpy.data.scenes)
    collections = len(bpy.data.collections)
    compositor.set_up(scene)
    compositor.set_up(scene)
    assert len(bpy.data.objects) == objects + 1
    compositor.take_down(scene)
    assert (len(bpy.data.objects), len(bpy.data.scenes)) == (objects, scenes)
    assert len(bpy.data.collections) == collections


def test_set_up_again_in_a_saved_file(shadowed, tmp_path):
    """Oracle: the same datablocks; changes by hand are repaired: casters removed or unlinked, the
    proxies' collection in another one, which the shadow scene leaves out there too."""
    compositor.set_up(shadowed)
    kinds = ("objects", "scenes", "collections", "meshes")
    there = {kind: set(getattr(bpy.data, kind).keys()) for kind in kinds}
    path = str(tmp_path / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    scene = bpy.context.scene
    assert missing(scene) == ""
    compositor.set_up(scene)
    assert {kind: set(getattr(bpy.data, kind).keys()) for kind in kinds} == there
    shadows = scene[SHADOW_SCENE]
    (casters,) = shadows.collection.children
    bpy.data.collections.remove(casters)
    assert "Cube" in missing(scene)
    compositor.set_up(scene)
    (casters,) = shadows.collection.children
    shadows.collection.children.unlink(casters)
    compositor.set_up(scene)
    assert list(shadows.collection.children) == [casters]
    proxies = next(one for one in scene.collection.children if PROXIES in one)
    group = bpy.data.collections.new("group")
    scene.collection.children.link(group)
    group.children.link(proxies)
    scene.collection.children.unlink(proxies)
    compositor.set_up(scene)
    layer = shadows.view_layers[0]
    layer.update()
    assert {ob.name for ob in layer.objects} == {"Cube", "sun", "surface Catcher"}


def test_collections_of_one_name(shadowed, tmp_path):
    """A linked collection with the name of a local one: both cast shadows, after every set-up."""
    scene = shadowed
    props = bpy.data.collections.new("props")
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {props}, fake_user=True)
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.collections = ["props"]
    (linked,) = wanted.collections
    for one in (props, linked):
        scene.collection.children.link(one)
    for _ in range(2):
        compositor.set_up(scene)
        assert set(scene[SHADOW_SCENE]["gs_casters"].children) == {props, linked}


@pytest.mark.parametrize("composited", [False, True])
def test_splats_of_a_proxy_are_removed(shadowed, composited):
    """The panel names the mesh, which still casts shadows; the cross makes it visible in place."""
    scene = shadowed
    if composited:
        compositor.set_up(scene)
    splats = next(ob for ob in scene.objects if ob.name.startswith("splats"))
    mesh = bpy.data.objects["surface"]
    splats.location.x = 1
    bpy.context.view_layer.update()
    place = mesh.matrix_world.copy()
    assert left_over(scene) == []
    assert "were removed" not in drawn(RenderPanel)
    with bpy.context.temp_override(selected_objects=[splats]):
        bpy.ops.object.delete()
    assert left_over(scene) == [mesh]
    assert "splats of surface were removed" in drawn(RenderPanel)
    assert bpy.ops.gscore.remove_proxy() == {"FINISHED"}
    assert left_over(scene) == [] and mesh.visible_camera and not mesh.hide_select
    assert "were removed" not in drawn(RenderPanel)
    if composited:
        assert np.allclose(mesh.matrix_world, place)


def test_without_cycles_nothing_changes(shadowed, monkeypatch):
    """Oracle: the error, and the file as before."""
    there = len(bpy.data.scenes)
    without = lambda ob, name: name != "cycles" and hasattr(ob, name)  # noqa: E731
    monkeypatch.setattr(compositor, "hasattr", without, raising=False)
    with pytest.raises(ValueError, match="Cycles Render Engine"):
        compositor.set_up(shadowed)
    assert len(bpy.data.scenes) == there and not shadowed.render.film_transparent


def test_new_and_removed_proxies_are_named(shadowed):
    """By the panel, until the button is pressed: without a shadow scene, with one, and if a proxy
    has another mesh, is freed or deleted, of which no twin is left."""
    scene = shadowed
    splats = next(ob for ob in scene.objects if ob.name.startswith("splats"))
    mesh = bpy.data.objects["surface"]
    bpy.context.view_layer.objects.active = splats
    assert bpy.ops.gscore.remove_proxy() == {"FINISHED"}
    compositor.set_up(scene)
    assert missing(scene) == ""
    use_proxy(splats, mesh)
    assert missing(scene) == "surface"
    assert "Shadows do not follow surface yet" in drawn(RenderPanel)
    compositor.set_up(scene)
    assert missing(scene) == ""
    mesh.data = mesh.data.copy()
    assert missing(scene) == "surface"
    compositor.set_up(scene)
    assert missing(scene) == ""
    assert bpy.ops.gscore.remove_proxy() == {"FINISHED"}
    assert missing(scene) == "surface, surface Catcher"
    use_proxy(splats, mesh)
    assert missing(scene) == ""
    bpy.data.objects.remove(mesh)
    assert missing(scene) == "surface Catcher"
    compositor.set_up(scene)
    assert missing(scene) == "" and "surface Catcher" not in bpy.data.objects


def test_a_copied_scene_has_its_own(shadowed, tmp_path):
    """The scenes of a copy, once set up, are not those of the original, which still renders and
    keeps its nodes; removing one leaves the other."""
    compositor.set_up(shadowed)
    before = lab.render_exr(tmp_path, "before")
    keys = [key for key in compositor._OTHERS if key in shadowed]
    bpy.ops.scene.new(type="LINK_COPY")
    copy = bpy.context.scene
    assert copy != shadowed
    compositor.set_up(copy)
    assert all(copy[key] != shadowed[key] and copy[key]["gs_main_scene"] == copy for key in keys)
    noise = np.abs(lab.render_exr(tmp_path, "copy") - before)  # samples of other casters
    assert np.percentile(noise, 95) < 0.05
    compositor.take_down(copy)
    assert all(isinstance(shadowed[key], bpy.types.Scene) for key in keys)
    bpy.context.window.scene = shadowed
    assert composite_nodes.combine_node(shadowed) is not None
    assert np.percentile(np.abs(lab.render_exr(tmp_path, "after") - before), 95) < 0.05
