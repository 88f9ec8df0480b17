"""Guide meshes of a training; oracles: Blender's own projection, rays and clock, and files."""

import json
import os
import re
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import plyfile
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Euler, Matrix, Vector

from addon import preferences
from addon.cameras.objects import photo_camera_of
from addon.core import Capture, write_splats
from addon.panels.train import GuidesPanel
from addon.training import guides, registry, start_training
from gscore.config import DataConfig
from gscore.datasets.read import read_capture
from gscore.raster.mesh import mesh_depth
from tests.addon.calls import import_capture, import_splats
from tests.addon.captures import STUDIO
from tests.addon.drawn import drawn
from tests.addon.fake_trainer import STARTED, fake_python, finish
from tests.addon.trainings import splats, until
from tests.lines_run import lines_run

REAL = os.environ.get("GSCORE_TRAINER_PYTHON", "")
needs_trainer = pytest.mark.skipif(not REAL, reason="GSCORE_TRAINER_PYTHON names no Python")


@pytest.fixture
def studio(studio: bpy.types.Scene, play: Callable[..., Path]) -> bpy.types.Scene:
    """A scene with the cameras of the studio, rotated, moved and scaled; the fake trainer ends
    immediately."""
    found: Capture = import_capture(studio, STUDIO)
    place = Matrix.Translation((3, -2, 1)) @ Euler((0.3, 0.2, 0.9)).to_matrix().to_4x4()
    found.root.matrix_world = place @ Matrix.Scale(2.5, 4) @ found.root.matrix_world
    bpy.context.view_layer.update()
    play({"say": STARTED}, finish())
    return studio


def into(scene: bpy.types.Scene, role: str, *obs: bpy.types.Object) -> bpy.types.Collection:
    """Set a guide as the button does."""
    for ob in scene.objects:
        ob.select_set(ob in obs)
    assert bpy.ops.gscore.add_guides(role=role) == {"FINISHED"}
    return getattr(scene.gscore, guides.ROLES[role])


def an_object(
    name: str, data: bpy.types.ID | None, matrix: Matrix | None = None
) -> bpy.types.Object:
    ob = bpy.data.objects.new(name, data)
    bpy.context.collection.objects.link(ob)
    ob.matrix_world = matrix or Matrix()
    bpy.context.view_layer.update()
    return ob


def a_grid(name: str, cells: int, size: float = 1.0) -> bpy.types.Mesh:
    """A square of quads, 2 cells^2 triangles, at z = 0."""
    x, y = np.meshgrid(np.linspace(-size, size, cells + 1), np.linspace(-size, size, cells + 1))
    at = np.arange((cells + 1) ** 2).reshape(cells + 1, -1)
    quads = np.stack([at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]], -1).reshape(-1, 4)
    mesh = bpy.data.meshes.new(name)
    vertices = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    mesh.from_pydata(vertices.tolist(), [], quads.tolist())
    return mesh


def written(line: list[str], role: str = "surface") -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of the file named in the options, read by plyfile."""
    path = Path(line[line.index(f"--guide-{role}") + 1])
    found = plyfile.PlyData.read(str(path))
    vertices = np.stack([found["vertex"][axis] for axis in "xyz"], axis=1)
    return vertices, np.stack(found["face"]["vertex_indices"])


def test_a_mesh_lands_where_cameras_see_it(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: Blender's projection of each corner with modifiers, and its ray casts through the
    pixels of a photo, compared with the written file and the capture's own cameras."""
    turned = Matrix.Translation((3, -2, 1)) @ Euler((0.5, 0.1, 0.2)).to_matrix().to_4x4()
    ob = an_object("Wall", a_grid("Wall", 4), turned @ Matrix.Diagonal((2, 1, 3, 1)))
    bend = ob.modifiers.new("Thick", "SOLIDIFY")
    bend.thickness = 0.4
    into(studio, "surface", ob)
    vertices, triangles = written(guides.arguments(studio, tmp_path / "out"))
    capture = read_capture(DataConfig(source=STUDIO), photos_required=False)
    views = {view.name: view for view in capture.views}

    graph = bpy.context.evaluated_depsgraph_get()
    evaluated = ob.evaluated_get(graph)
    corners = [evaluated.matrix_world @ v.co for v in evaluated.data.vertices]
    assert len(corners) == 2 * 25 == len(vertices)
    cameras = [o for o in studio.objects if o.type == "CAMERA"]
    seen = 0
    for camera in cameras[:6]:
        own = photo_camera_of(camera)
        view = views[own.image]
        studio.render.resolution_x, studio.render.resolution_y = own.width, own.height
        local = vertices @ view.viewmat[:3, :3].T + view.viewmat[:3, 3]
        scale = camera.matrix_world.to_scale()[0]
        for place, corner in zip(local, corners, strict=True):
            shown = world_to_camera_view(studio, camera, corner)
            assert shown.z / scale == pytest.approx(place[2], rel=1e-4, abs=1e-4)
            if place[2] > 0.1:
                u, v, _ = view.camera.K @ (place / place[2])
                assert (shown.x * own.width, (1 - shown.y) * own.height) == pytest.approx(
                    (u, v), rel=1e-3, abs=0.3
                )
        depth = mesh_depth(
            vertices, triangles.astype(np.int32), view.camera.K, view.viewmat, own.width, own.height
        )
        inverse = np.linalg.inv(view.camera.K)
        for row in range(20, own.height, 60):
            for column in range(20, own.width, 60):
                ray = inverse @ [column + 0.5, row + 0.5, 1]
                towards = camera.matrix_world.to_3x3() @ Vector((ray[0], -ray[1], -1))
                center = camera.matrix_world.translation
                hit, where, _, _, what, _ = studio.ray_cast(graph, center, towards)
                if hit and what.name == "Wall":
                    z = (where - center).length / towards.length
                    assert depth[row, column] * z == pytest.approx(1, rel=1e-4)
                    seen += 1
    assert seen > 20


def test_instances_modifiers_and_text_count_and_hidden_ones_do_not(
    studio: bpy.types.Scene, tmp_path: Path
) -> None:
    """Oracle: triangles counted by hand; objects left out are named before a training."""
    source = bpy.data.collections.new("Tree")  # linked to no scene: shown by instances only
    source.objects.link(bpy.data.objects.new("Leaf", a_grid("Leaf", 1)))
    obs = [an_object(name, None) for name in ("One", "Two")]
    for ob in obs:
        ob.instance_type, ob.instance_collection = "COLLECTION", source
    array = an_object("Row", a_grid("Row", 1))
    array.modifiers.new("Array", "ARRAY").count = 3
    text = an_object("Text", bpy.data.curves.new("Text", "FONT"))
    text.data.body = "l"
    hidden, light = an_object("Hidden", a_grid("Hidden", 3)), an_object("Empty", None)
    beads = tmp_path / "a.ply"
    write_splats(beads, splats(40))
    collection = into(studio, "surface", *obs, array, text, hidden)
    collection.objects.link(light)
    collection.objects.link(import_splats(bpy.context, beads))
    child = bpy.data.collections.new("Child")
    collection.children.link(child)
    child.objects.link(bpy.data.objects.new("Grandchild", a_grid("Grandchild", 2)))
    hidden.hide_set(True)
    found = guides.merged_mesh(studio, collection)
    letter = len(found.triangles) - 2 * 2 - 3 * 2 - 2 * 4
    assert 2 <= letter <= 60
    reported = start_training.unsaved(studio)
    assert reported[0] == "Hidden in Guide Surfaces, so not used: Hidden."
    assert "No meshes" in reported[1] and "Empty" in reported[1] and "a" in reported[1]
    assert len(reported) == 2


def test_texts_in_an_instanced_collection_keep_their_shapes(studio: bpy.types.Scene) -> None:
    """Oracle: each text converted to a mesh by Blender separately."""
    source, wanted = bpy.data.collections.new("Sign"), 0
    for body in ("l", "o", "mm"):
        text = bpy.data.objects.new(body, bpy.data.curves.new(body, "FONT"))
        text.data.body = body
        text.location.x = 5.0 * len(source.objects)
        source.objects.link(text)
        studio.collection.objects.link(text)
        bpy.context.view_layer.update()
        mesh = text.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
        mesh.calc_loop_triangles()
        wanted += len(mesh.loop_triangles)
        studio.collection.objects.unlink(text)
    sign = an_object("Signs", None)
    sign.instance_type, sign.instance_collection = "COLLECTION", source
    assert len(guides.merged_mesh(studio, into(studio, "surface", sign)).triangles) == wanted


def test_training_receives_its_guides(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: the trainer's arguments and the files named in them; another shape gets a new file,
    so that the first run can be resumed."""
    wall, box = an_object("Wall", a_grid("Wall", 2)), an_object("Box", a_grid("Box", 1, 3.0))
    into(studio, "surface", wall)
    into(studio, "free", box)
    assert "Guide Surfaces" in drawn(GuidesPanel) or "guide_surface" in drawn(GuidesPanel)
    job = start_training.train(studio, wait=True)
    words = json.loads((tmp_path / "python" / "script.args").read_text())
    assert len(written(words)[1]) == 8 and len(written(words, "free")[1]) == 2
    first = words[words.index("--guide-surface") + 1]
    assert Path(first).parent == job.output / "guides"
    assert guides.arguments(studio, job.output) == guides.arguments(studio, job.output)
    wall.location.x += 1
    bpy.context.view_layer.update()
    second = guides.arguments(studio, job.output)[1]
    assert second != first and Path(first).is_file() and Path(second).is_file()
    studio.gscore.guide_surface = studio.gscore.guide_free = None
    assert guides.arguments(studio, job.output) == []


@needs_trainer
@pytest.mark.slow
def test_a_real_training_sees_a_wall_where_blender_does(studio: bpy.types.Scene) -> None:
    """Oracle: the number of cameras' rays through a grid of pixels that hit the wall, by Blender;
    and the trainer's message about a wall in mid-air that its points do not support."""
    cameras = sorted((o for o in studio.objects if o.type == "CAMERA"), key=lambda o: o.name)
    place = cameras[0].matrix_world @ Matrix.Translation((0, 0, -1.6))
    wall = an_object("Wall", a_grid("Wall", 2), place @ Matrix.Diagonal((0.3, 0.3, 1, 1)))
    into(studio, "surface", wall)
    graph, seen = bpy.context.evaluated_depsgraph_get(), 0
    for camera in cameras:
        own = photo_camera_of(camera)
        frame = [camera.matrix_world @ corner for corner in camera.data.view_frame(scene=studio)]
        center, hit = camera.matrix_world.translation, False
        for across in np.linspace(0.01, 0.99, own.width // 8):
            for down in np.linspace(0.01, 0.99, own.height // 8):
                upper = frame[3].lerp(frame[0], across)
                lower = frame[2].lerp(frame[1], across)
                towards = upper.lerp(lower, down) - center
                found = studio.ray_cast(graph, center, towards)
                hit = hit or (found[0] and found[4].name == "Wall")
        seen += hit
    preferences.get().python_path = REAL
    studio.gscore.preset, studio.gscore.iterations = "preview", 4
    studio.gscore.eval = False
    assert bpy.ops.gscore.train(wait=True) == {"FINISHED"}
    state = start_training.job_of(studio).state
    reported = re.search(r"pixels of (\d+) training photos", state.started.decision("guide"))
    assert 5 < seen < len(cameras) - 5
    assert seen <= int(reported[1]) <= seen + 3  # a corner of it may be between the rays
    assert any("may be in the wrong place" in text for text in state.warnings)


def test_a_discarded_run_leaves_no_meshes(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: the folder is removed."""
    into(studio, "surface", an_object("Wall", a_grid("Wall", 2)))
    play = [{"say": STARTED}, {"await": "never"}]
    preferences.get().python_path = str(fake_python(tmp_path / "slow", play))
    job = start_training.train(studio)
    assert (tmp_path / "out" / "guides").is_dir()
    until(lambda: job.state.started is not None)
    start_training.discard(job)
    until(lambda: not (tmp_path / "out").exists())


def test_unusable_guides_are_refused(studio: bpy.types.Scene) -> None:
    """Oracle: an error for each, and no training."""
    wall = an_object("Wall", a_grid("Wall", 2))
    collection = into(studio, "surface", wall)
    wall.hide_set(True)
    with pytest.raises(RuntimeError, match="Guide Surfaces has no visible faces"):
        bpy.ops.gscore.train()
    wall.hide_set(False)
    wall.data.vertices[3].co.x = float("nan")
    with pytest.raises(RuntimeError, match="Wall has vertices that are not finite"):
        bpy.ops.gscore.train()
    wall.data.vertices[3].co.x = 0
    collection.objects.unlink(wall)
    with pytest.raises(RuntimeError, match="has no visible faces"):
        bpy.ops.gscore.train()
    for ob in studio.objects:
        ob.select_set(ob.type == "CAMERA")
    with pytest.raises(RuntimeError, match="None of the selected objects is a mesh"):
        bpy.ops.gscore.add_guides(role="surface")
    assert registry.jobs() == []


def test_guides_want_the_cameras_in_the_scene(scene: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: the messages of the button and of the panel."""
    scene.gscore.capture_path = str(STUDIO)
    into(scene, "free", an_object("Wall", a_grid("Wall", 2)))
    with pytest.raises(ValueError, match="press Import Cameras first"):
        guides.arguments(scene, tmp_path)
    assert "Import the cameras" in drawn(GuidesPanel)


def test_guides_belong_to_their_capture(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: another capture has none, and choosing the first restores them."""
    collection = into(studio, "surface", an_object("Wall", a_grid("Wall", 1)))
    (tmp_path / "other" / "images").mkdir(parents=True)
    studio.gscore.capture_path = str(tmp_path / "other")
    assert studio.gscore.guide_surface is None
    studio.gscore.capture_path = str(STUDIO)
    assert studio.gscore.guide_surface == collection


def test_a_large_mesh_is_gathered_in_a_blink(studio: bpy.types.Scene) -> None:
    """Oracle: the count of lines for two triangles: ten thousand are handled by no loop of
    Python."""

    def lines(cells: int) -> int:
        collection = into(studio, "surface", an_object("Mesh", a_grid("Mesh", cells)))
        for ob in collection.objects:
            ob.hide_viewport = len(ob.data.polygons) != cells**2
        bpy.context.view_layer.update()
        assert len(guides.merged_mesh(studio, collection).triangles) == 2 * cells**2
        return lines_run(lambda: guides.merged_mesh(studio, collection))

    assert abs(lines(70) - lines(1)) < 100
