"""Oracle: events of a scripted mesh, the mesh that it wrote, Blender's own importers."""

import json
from dataclasses import replace
from pathlib import Path

import bmesh
import bpy
import numpy as np
import pytest

from addon import preferences, stored_paths
from addon.core import read_surface, rgb_to_sh0, write_splats
from addon.interface.base_operator import make_active
from addon.panels.result import SurfacePanel
from addon.process import poll_timer
from addon.render import compositor
from addon.render.proxy import attach
from addon.splats import objects
from addon.splats.exporting import proxy_path
from addon.splats.objects import proxy_of
from addon.surface import fit_proxy, make_mesh
from addon.training.verb_jobs import follow
from gscore.config_file import config_json
from gscore.mesh import SurfaceMesh, write_surface
from gscore.presets import PRESETS
from tests.addon.captures import STUDIO
from tests.addon.drawn import drawn
from tests.addon.fake_trainer import fake_python
from tests.addon.trainings import placed_run, splats

SURFACE = SurfaceMesh(
    vertices=np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3.0]]),
    triangles=np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]),
    colors=np.array([[0, 0.5, 1], [1, 0, 0], [0.1, 0.2, 0.8], [1, 1, 1]], np.float32),
)


@pytest.fixture
def result(studio: bpy.types.Scene, tmp_path: Path) -> bpy.types.Object:
    """Active, moved splats of a run of the studio, with its cameras."""
    ob = placed_run(studio, tmp_path / "run")
    bpy.context.view_layer.objects.active = ob
    bpy.context.view_layer.update()
    return ob


def play(tmp_path: Path) -> Path:
    """Replace the preferences' Python by a fake that makes a mesh; return the file of its
    arguments."""
    path = tmp_path / "run" / make_mesh.FILE
    write_surface(path, SURFACE)
    script = [
        {"say": {"event": "mesh_progress", "phase": "fusing", "done": 1, "total": 2, "eta_s": 1}},
        {"say": {"event": "mesh", "path": str(path), "vertices": 4, "triangles": 4, "voxel": 1.0}},
    ]
    preferences.get().python_path = str(fake_python(tmp_path / "python", script))
    return tmp_path / "python" / "script.args"


def test_a_mesh_is_made_and_imported(result: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: places, triangles and colours of the file at the transform of the splats; the
    trainer's arguments; the panel."""
    args = play(tmp_path)
    there = set(bpy.data.objects)
    assert bpy.ops.gscore.make_mesh(wait=True, triangles=1000, closed=True) == {"FINISHED"}
    line = " ".join(json.loads(args.read_text()))
    for words in (f"mesh {tmp_path / 'run'}", "--triangles 1000", "--holes closed", f"-s {STUDIO}"):
        assert words in line
    (made,) = set(bpy.data.objects) - there
    assert np.allclose(made.matrix_world, result.matrix_world, atol=1e-6)
    assert made.parent == result.parent
    places = np.array([vertex.co[:] for vertex in made.data.vertices])
    np.testing.assert_allclose(places, SURFACE.vertices)
    corners = np.array([polygon.vertices[:] for polygon in made.data.polygons])
    np.testing.assert_array_equal(corners, SURFACE.triangles)
    assert not made.data.validate()
    colors = made.data.color_attributes.active_color
    srgb = np.array([one.color_srgb[:3] for one in colors.data])
    np.testing.assert_allclose(srgb, SURFACE.colors, atol=0.6 / 255)
    shader = made.data.materials[0].node_tree.nodes
    assert any(node.type == "VERTEX_COLOR" and node.layer_name == colors.name for node in shader)
    assert "4 triangles" in drawn(SurfacePanel)


def test_a_proxy_is_made(result: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the place of the splats and their visibility; a second one takes its place, and no
    object is left; a mesh that the user chose before stays."""
    play(tmp_path)
    own = bpy.data.objects.new("own", bpy.data.meshes.new("own"))
    bpy.context.scene.collection.objects.link(own)
    attach(bpy.context.scene, result, own)
    there = len(bpy.data.objects)
    for _ in range(2):
        assert bpy.ops.gscore.make_mesh(wait=True, proxy=True) == {"FINISHED"}
        proxy = proxy_of(result)
        bpy.context.view_layer.update()
        assert np.allclose(proxy.matrix_world, result.matrix_world, atol=1e-6)
        assert not proxy.visible_camera and len(proxy.data.polygons) == 4
        assert len(bpy.data.objects) == there + 1
        assert own.visible_camera and own.parent is None
        proxy.location.x += 1
    assert "Make Proxy" in drawn(SurfacePanel)


def test_what_is_missing_is_named(result: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the message; nothing is added to the scene."""
    (tmp_path / "run/point_cloud.ply").unlink()
    with pytest.raises(RuntimeError, match="no finished training"):
        bpy.ops.gscore.make_mesh(wait=True)
    with pytest.raises(RuntimeError, match="No mesh is being made"):
        bpy.ops.gscore.stop_mesh()
    write_splats(tmp_path / "run/point_cloud.ply", splats(50))
    play(tmp_path)
    job = make_mesh.make_mesh(result)
    bpy.data.objects.remove(result)
    there = set(bpy.data.meshes)
    follow(lambda: not job.ended or job.awaits_import)
    assert "splats were removed" in " ".join([job.sentence, *job.warnings])
    assert set(bpy.data.meshes) == there


@pytest.mark.parametrize("ending", [".ply", ".obj", ".glb"])
def test_blender_reads_the_files(studio: bpy.types.Scene, tmp_path: Path, ending: str) -> None:
    """Oracle: Blender's importers: size, triangles and colours; a GLB has y up from y down."""
    path = tmp_path / f"a{ending}"
    write_surface(path, SURFACE)
    there = set(bpy.data.objects)
    if ending == ".glb":
        bpy.ops.import_scene.gltf(filepath=str(path))
    elif ending == ".ply":
        bpy.ops.wm.ply_import(filepath=str(path))
    else:
        bpy.ops.wm.obj_import(filepath=str(path), forward_axis="Y", up_axis="Z")
    (made,) = [ob for ob in set(bpy.data.objects) - there if ob.type == "MESH"]
    assert len(made.data.polygons) == 4
    bpy.context.view_layer.update()
    matrix = np.array(made.matrix_world)
    places = np.array([v.co[:] for v in made.data.vertices]) @ matrix[:3, :3].T + matrix[:3, 3]
    expected = SURFACE.vertices
    if ending == ".glb":  # x, y down, z front become -x, -z (front to back), y up
        expected = expected * [-1, -1, 1]  # the node's half turn, in glTF's axes
        expected = np.stack([expected[:, 0], -expected[:, 2], expected[:, 1]], axis=1)
    order = [int(np.abs(expected - place).sum(axis=1).argmin()) for place in places]
    np.testing.assert_allclose(places, expected[order], atol=1e-5)
    colors = made.data.color_attributes[0]
    corners = colors.domain == "CORNER"
    rows = [loop.vertex_index for loop in made.data.loops] if corners else range(len(places))
    found = np.array([one.color_srgb[:3] for one in colors.data])
    for row, rgb in zip(rows, found, strict=True):
        np.testing.assert_allclose(rgb, SURFACE.colors[order[row]], atol=0.01)


def test_a_mesh_arrives_beside_its_splats(result: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the splats' scene, whichever is open, and not that which renders them alone."""
    play(tmp_path)
    scene = bpy.context.scene
    scene.camera = next(ob for ob in scene.objects if ob.type == "CAMERA")
    compositor.set_up(scene)
    bpy.context.window.scene = bpy.data.scenes.new("other")
    make_mesh.make_mesh(result, wait=True)
    (made,) = [ob for ob in scene.objects if ob.name.endswith("surface")]
    assert made.users_scene == (scene,)


def test_splats_of_a_run_know_it(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: the run folder and capture in config.json, by the button on a file of the command
    line; a copy of the file elsewhere has none."""
    run = tmp_path / "run"
    run.mkdir()
    write_splats(run / "point_cloud.ply", splats(50))
    (run / "config.json").write_text(config_json(*PRESETS["preview"](STUDIO)))
    (run / "copy.ply").write_bytes((run / "point_cloud.ply").read_bytes())
    for name, known in (("point_cloud.ply", True), ("copy.ply", False)):
        assert bpy.ops.gscore.import_splats(filepath=str(run / name)) == {"FINISHED"}
        ob = bpy.context.object
        assert stored_paths.read(ob, stored_paths.RUN) == (str(run) if known else "")
        assert stored_paths.read(ob, stored_paths.SOURCE) == (str(STUDIO) if known else "")
        assert make_mesh.MakeMesh.poll(bpy.context) == known


def made_proxy(result: bpy.types.Object, tmp_path: Path) -> bpy.types.Object:
    """The proxy of the result, by the button."""
    play(tmp_path)
    assert bpy.ops.gscore.make_mesh(wait=True, proxy=True) == {"FINISHED"}
    return proxy_of(result)


def test_copies_of_splats_have_a_proxy(result: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: an own object with the same mesh at the place of the copy; deleted splats take their
    proxy with them, and undo brings both back."""
    scene, proxy = bpy.context.scene, made_proxy(result, tmp_path)
    make_active(bpy.context, result)
    bpy.ops.ed.undo_push(message="made")
    bpy.ops.object.duplicate()
    copy = bpy.context.object
    copy.location.x += 5
    bpy.context.view_layer.update()
    poll_timer.poll()
    other = proxy_of(copy)
    assert other is not None and other != proxy and other.data == proxy.data
    assert proxy_of(result) == proxy and not other.visible_camera
    bpy.context.view_layer.update()
    assert np.allclose(other.matrix_world, copy.matrix_world, atol=1e-6)
    copy.hide_render = True
    bpy.context.view_layer.update()
    assert other.hide_render and not proxy.hide_render
    poll_timer.poll()
    there = {ob.name for ob in scene.objects}
    name = other.name
    make_active(bpy.context, copy)
    bpy.ops.ed.undo_push(message="copied")
    bpy.ops.object.delete()
    bpy.context.view_layer.update()
    poll_timer.poll()
    assert name not in scene.objects and proxy.name in scene.objects
    bpy.ops.ed.undo_push(message="deleted")
    bpy.ops.ed.undo()
    poll_timer.poll()
    assert {ob.name for ob in bpy.context.scene.objects} == there


def test_a_proxy_follows_edits(result: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the triangles at the removed splats, and the painted color. The panel names it."""
    result.location, result.rotation_euler = (0, 0, 0), (0, 0, 0)
    places = SURFACE.vertices.repeat(10, 0) + np.linspace(0, 0.05, 40)[:, None]
    made = replace(
        splats(40), means=places.astype(np.float32), opacities=np.full(40, 5, np.float32)
    )
    made.sh0[:] = rgb_to_sh0(np.array([0.2, 0.4, 0.6]))
    objects.refresh(result, made)
    proxy = made_proxy(result, tmp_path)
    assert not fit_proxy.is_stale(result)
    assert "have changed" not in drawn(SurfacePanel)
    colors = proxy.data.color_attributes.active_color
    before = np.array([one.color_srgb[:3] for one in colors.data])
    kept = made.subset(np.arange(40) < 30)  # without those at the last vertex
    kept.sh0[:10] = rgb_to_sh0(np.array([0.2, 0.4, 0.5]))
    objects.refresh(result, kept)
    bpy.context.view_layer.update()
    assert fit_proxy.is_stale(result)
    assert "have changed" in drawn(SurfacePanel)
    assert bpy.ops.gscore.update_proxy() == {"FINISHED"}
    assert not fit_proxy.is_stale(result)
    assert len(proxy.data.polygons) == 1  # the one without the last vertex
    places = np.array([vertex.co[:] for vertex in proxy.data.vertices])
    np.testing.assert_allclose(places, SURFACE.vertices[:3], atol=1e-6)
    colors = proxy.data.color_attributes.active_color
    after = np.array([one.color_srgb[:3] for one in colors.data])
    np.testing.assert_allclose(after[1:], before[1:3], atol=1 / 255)
    np.testing.assert_allclose(after[0], np.clip(before[0] - [0, 0, 0.1], 0, 1), atol=1 / 255)


@pytest.mark.parametrize("domain", ["CORNER", ""])
def test_a_proxy_with_other_colors_is_updated(
    result: bpy.types.Object, tmp_path: Path, domain: str
) -> None:
    """Colors of face corners follow what was painted; a proxy may have none."""
    result.location, result.rotation_euler = (0, 0, 0), (0, 0, 0)
    means = SURFACE.vertices.repeat(10, 0).astype(np.float32)
    made = replace(splats(40), means=means, opacities=np.full(40, 5, np.float32))
    made.sh0[:] = rgb_to_sh0(np.array([0.2, 0.4, 0.6]))
    objects.refresh(result, made)
    mesh = made_proxy(result, tmp_path).data
    mesh.color_attributes.remove(mesh.color_attributes.active_color)
    if domain:
        colors = mesh.color_attributes.new("Color", "FLOAT_COLOR", domain)
        colors.data.foreach_set("color_srgb", np.full(4 * len(mesh.loops), 0.5, np.float32))
    made.sh0[:10] = rgb_to_sh0(np.array([0.2, 0.4, 0.5]))
    objects.refresh(result, made)
    bpy.context.view_layer.update()
    assert bpy.ops.gscore.update_proxy() == {"FINISHED"}
    assert not fit_proxy.is_stale(result)
    if domain:
        after = np.array([one.color_srgb[:3] for one in mesh.color_attributes["Color"].data])
        first = np.array([one.vertex_index == 0 for one in mesh.loops])
        np.testing.assert_allclose(after[first], [[0.5, 0.5, 0.4]] * first.sum(), atol=1e-3)
        np.testing.assert_allclose(after[~first], 0.5, atol=1e-3)


def test_an_edited_proxy_is_updated(result: bpy.types.Object, tmp_path: Path) -> None:
    """Faces need not be triangles: two were joined by hand."""
    result.location, result.rotation_euler = (0, 0, 0), (0, 0, 0)
    means = SURFACE.vertices.repeat(10, 0).astype(np.float32)
    made = replace(splats(40), means=means, opacities=np.full(40, 5, np.float32))
    objects.refresh(result, made)
    proxy = made_proxy(result, tmp_path)
    shape = bmesh.new()
    shape.from_mesh(proxy.data)
    bmesh.ops.join_triangles(
        shape, faces=shape.faces, angle_face_threshold=3.2, angle_shape_threshold=3.2
    )
    shape.to_mesh(proxy.data)
    shape.free()
    faces = len(proxy.data.polygons)
    assert faces < 4
    objects.refresh(result, made.subset(np.arange(40) < 30))
    bpy.context.view_layer.update()
    assert bpy.ops.gscore.update_proxy() == {"FINISHED"}
    assert len(proxy.data.vertices) == 3
    assert len(proxy.data.polygons) < faces


def test_an_applied_transform_leaves_the_proxy(result: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: no splat is gone, so no face is. Ten times the size, distances are ten times too."""
    result.location, result.rotation_euler = (0, 0, 0), (0, 0, 0)
    means = SURFACE.vertices.repeat(10, 0) + np.linspace(0.1, 0.5, 40)[:, None]
    made = replace(splats(40), means=means.astype(np.float32), opacities=np.full(40, 5, np.float32))
    objects.refresh(result, made)
    proxy = made_proxy(result, tmp_path)
    result.scale = (10, 10, 10)
    bpy.context.view_layer.update()
    place = np.array(proxy.matrix_world)
    assert bpy.ops.gscore.apply_splat_transform() == {"FINISHED"}
    bpy.context.view_layer.update()
    np.testing.assert_allclose(proxy.matrix_world, place, atol=1e-5)
    assert bpy.ops.gscore.update_proxy() == {"FINISHED"}
    assert len(proxy.data.polygons) == 4


def test_a_joined_proxy_stays_in_place(result: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: after Join, the proxy and its shadow catcher are where the proxy was; the exported
    mesh is there too."""
    other = result.copy()
    other.data = result.data.copy()
    bpy.context.scene.collection.objects.link(other)
    proxy = made_proxy(result, tmp_path)
    place = np.array(proxy.matrix_world)
    other.location = (1, 0, 0)
    result.select_set(True)
    make_active(bpy.context, other)
    result.select_set(True)
    bpy.context.view_layer.update()
    assert bpy.ops.gscore.join_splats() == {"FINISHED"}
    bpy.context.scene.camera = next(ob for ob in bpy.data.objects if ob.type == "CAMERA")
    compositor.set_up(bpy.context.scene)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(proxy.matrix_world, place, atol=1e-5)
    catcher = bpy.data.objects[f"{proxy.name} Catcher"]
    for scene in bpy.data.scenes:
        scene.view_layers[0].update()
    np.testing.assert_allclose(catcher.matrix_world, place, atol=1e-5)
    path = tmp_path / "joined.ply"
    bpy.ops.gscore.export_splats(filepath=str(path), world="BLENDER", proxies=True)
    saved = read_surface(proxy_path(path)).vertices
    corners = SURFACE.vertices @ place[:3, :3].T + place[:3, 3]
    np.testing.assert_allclose(saved, corners, atol=1e-4)
