"""Oracle: events of a scripted mesh, the mesh that it wrote, Blender's own importers."""

import json
from pathlib import Path

import bpy
import numpy as np
import pytest

from addon import preferences, stored_paths
from addon.core import write_splats
from addon.panels.result import SurfacePanel
from addon.render import compositor
from addon.render.proxy import attach, proxy_of
from addon.surface import make_mesh
from addon.training.verb_jobs import follow
from gscore.mesh import SurfaceMesh, write_surface
from tests.addon.calls import import_splats
from tests.addon.captures import STUDIO
from tests.addon.drawn import drawn
from tests.addon.fake_trainer import fake_python
from tests.addon.trainings import splats

SURFACE = SurfaceMesh(
    vertices=np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3.0]]),
    triangles=np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]),
    colors=np.array([[0, 0.5, 1], [1, 0, 0], [0.1, 0.2, 0.8], [1, 1, 1]], np.float32),
)


@pytest.fixture
def result(studio: bpy.types.Scene, tmp_path: Path) -> bpy.types.Object:
    """Active, moved splats of a run of the studio, with its cameras."""
    bpy.ops.gscore.import_cameras()
    root = next(ob for ob in studio.objects if ob.get("gs_kind") == "capture")
    run = tmp_path / "run"
    run.mkdir()
    write_splats(run / "point_cloud.ply", splats(50))
    ob = import_splats(bpy.context, run / "point_cloud.ply", parent=root)
    stored_paths.write(ob, stored_paths.RUN, run)
    stored_paths.write(ob, stored_paths.SOURCE, STUDIO)
    ob.location, ob.rotation_euler = (0.3, 0.1, -0.2), (0.1, 0.2, 0.3)
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
