"""Oracle: files passed to a scripted training, a real training's bytes, and the scene."""

import json
import os
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Vector

from addon import attributes, preferences, stored_paths
from addon.core import read_splats, write_splats
from addon.panels.edit import RegionPanel
from addon.process import poll_timer
from addon.region_training import train_region
from addon.render.mesh_copies import read_marks
from addon.splats import edit, objects, point_attributes, read_chunked, splat_files
from addon.training import verb_job
from tests.addon.calls import import_splats
from tests.addon.drawn import drawn
from tests.addon.fake_trainer import STARTED, done, progress
from tests.addon.trainings import positions, splats, until

REAL = os.environ.get("GSCORE_TRAINER_PYTHON", "")
needs_trainer = pytest.mark.skipif(not REAL, reason="GSCORE_TRAINER_PYTHON names no Python")
Play = Callable[..., Path]
FILES = "start/start", "point_cloud"


@pytest.fixture
def studio(studio: bpy.types.Scene) -> bpy.types.Scene:
    """A scene with the studio's cameras."""
    bpy.ops.gscore.import_cameras()
    return studio


def cropped(scene: bpy.types.Scene, path: Path) -> bpy.types.Object:
    """Active splats of a file as a result of the capture, with a rotated crop box in the middle."""
    root = next(ob for ob in scene.objects if ob.get("gs_kind") == "capture")
    ob = import_splats(bpy.context, path, parent=root)
    bpy.context.view_layer.objects.active = ob
    box = edit.add_crop_box(bpy.context, ob)
    box.rotation_euler = 0.2, 0.3, 0.4
    box.scale = 0.5 * np.array(box.scale)
    bpy.context.view_layer.update()
    return ob


def in_box(ob: bpy.types.Object, points: np.ndarray) -> np.ndarray:
    """Points of the object's data inside its crop by Blender's own matrices, [N] bool."""
    box = ob.gscore.crop_object
    inverse = box.matrix_world.inverted() @ ob.matrix_world
    local = np.array([inverse @ Vector(p.tolist()) for p in points])
    return np.abs(local).max(axis=1) <= 1


def test_trainer_input_and_result(studio: bpy.types.Scene, tmp_path: Path, play: Play) -> None:
    """Oracle: the box in the file contains the same splats as by Blender's own matrices, and the
    PLY has the object's splats to the bit; the result replaces them, and the earlier folder
    stays."""
    write_splats(tmp_path / "a.ply", splats(500))
    write_splats(tmp_path / "b.ply", splats(700, seed=1))
    result = done(40, "finished", str(tmp_path / "b.ply"))
    about = STARTED | {"region": "3 splats in the region; 497 around it are frozen."}
    reported = play({"say": about}, {"say": progress(10)}, {"await": "go"}, {"say": result})
    ob = cropped(studio, tmp_path / "a.ply")
    inside = in_box(ob, positions(ob))
    assert 3 < inside.sum() < 497
    assert "(Train Region)" in drawn(RegionPanel)
    studio.gscore.sky = "on"  # which a region cannot represent

    assert bpy.ops.gscore.train_region() == {"FINISHED"}
    job = train_region.job_of(studio)
    assert job.output == tmp_path / "out_region_1"
    until(lambda: job.progress is not None)
    assert "are frozen" in drawn(RegionPanel) and "Step 10" in drawn(RegionPanel)
    with pytest.raises(RuntimeError, match="trained already"):
        bpy.ops.gscore.train_region()
    words = json.loads(reported.read_text())
    given = {flag: words[words.index(flag) + 1] for flag in ("--start-splats", "--region")}
    start = read_splats(given["--start-splats"])
    before = read_splats(tmp_path / "a.ply")
    assert start.means.tobytes() == before.means.tobytes()
    assert start.shN.tobytes() == before.shN.tobytes()
    box = np.array(json.loads(Path(given["--region"]).read_text())["box"])
    local = (start.means - box[:3, 3]) @ np.linalg.inv(box[:3, :3]).T
    assert ((np.abs(local).max(axis=1) <= 1) == inside).all()
    assert words[words.index("--iterations") + 1] == "2000" and "--sky" not in words

    job._process.send("go")
    until(lambda: job.ended and not job.awaits_import)
    assert len(ob.data.vertices) == 700
    assert np.array_equal(positions(ob), read_splats(tmp_path / "b.ply").means)
    assert read_marks(ob.data) is None  # else it would be tinted as selected
    assert "The region is trained" in drawn(RegionPanel)


def test_undo_brings_the_earlier_splats_back(
    studio: bpy.types.Scene, tmp_path: Path, play: Play
) -> None:
    """Oracle: the splats of the object before, after the training, after undo and after redo."""
    write_splats(tmp_path / "a.ply", splats(50))
    write_splats(tmp_path / "b.ply", splats(70, seed=1))
    play({"say": STARTED}, {"say": done(40, "finished", str(tmp_path / "b.ply"))})
    name = cropped(studio, tmp_path / "a.ply").name
    before = positions(bpy.data.objects[name])
    bpy.ops.ed.undo_push(message="start")
    bpy.ops.gscore.train_region(wait=True)
    after = positions(bpy.data.objects[name])
    assert len(after) == 70
    bpy.ops.ed.undo()
    assert np.array_equal(positions(bpy.data.objects[name]), before)
    bpy.ops.ed.redo()
    assert np.array_equal(positions(bpy.data.objects[name]), after)


def test_the_exposures_of_the_run_are_beside_the_start_splats(
    studio: bpy.types.Scene, tmp_path: Path, play: Play
) -> None:
    """Oracle: the file of the run of the splats."""
    run = tmp_path / "run"
    write_splats(run / "a.ply", splats(50))
    (run / "exposure.json").write_text("{}")
    ob = cropped(studio, run / "a.ply")
    stored_paths.write(ob, stored_paths.RUN, run)
    play({"say": STARTED}, {"say": done(40, "finished", str(run / "a.ply"))})
    bpy.ops.gscore.train_region(wait=True)
    assert (tmp_path / "out_region_1" / "start" / "exposure.json").read_text() == "{}"


def test_a_moved_object_stays_where_it_is_seen(
    studio: bpy.types.Scene, tmp_path: Path, play: Play
) -> None:
    """Oracle: positions of splats and box in Blender's world, for a result equal to the start."""
    write_splats(tmp_path / "a.ply", splats(50))
    ob = cropped(studio, tmp_path / "a.ply")
    ob.location, ob.rotation_euler, ob.scale = (1, 2, 3), (0.5, 0, 0.3), (1.5, 1.5, 1.5)
    bpy.context.view_layer.update()
    start = tmp_path / "out_region_1" / "start" / "start.ply"
    play({"say": STARTED}, {"say": done(40, "finished", str(start))})
    placed = [ob.matrix_world @ v.co for v in ob.data.vertices]
    box = ob.gscore.crop_object.matrix_world.copy()
    bpy.ops.gscore.train_region(wait=True)
    bpy.context.view_layer.update()
    after = [ob.matrix_world @ v.co for v in ob.data.vertices]
    assert np.allclose(placed, after, atol=1e-5)
    assert np.allclose(box, ob.gscore.crop_object.matrix_world, atol=1e-5)


def test_splats_that_were_edited_meanwhile_are_kept(
    studio: bpy.types.Scene, tmp_path: Path, play: Play
) -> None:
    """Oracle: the edited mesh, a second object, and a warning."""
    write_splats(tmp_path / "a.ply", splats(50))
    write_splats(tmp_path / "b.ply", splats(70))
    play({"await": "go"}, {"say": done(40, "finished", str(tmp_path / "b.ply"))})
    ob = cropped(studio, tmp_path / "a.ply")
    bpy.ops.gscore.train_region()
    ob.data.vertices[3].co.x += 1
    edited = positions(ob)
    job = train_region.job_of(studio)
    until(lambda: job._process is not None)
    job._process.send("go")
    until(lambda: job.ended and not job.awaits_import)
    assert np.array_equal(positions(ob), edited)
    start = read_splats(tmp_path / "out_region_1/start/start.ply")
    assert np.array_equal(start.means, read_splats(tmp_path / "a.ply").means)
    others = [o for o in studio.objects if objects.is_splats(o) and o != ob]
    assert [len(o.data.vertices) for o in others] == [70]
    assert f"{ob.name} was edited and is kept" in drawn(RegionPanel)


@pytest.mark.parametrize("with_what", ["shape keys", "NLA tracks"])
def test_result_without_a_target_names_its_folder(
    studio: bpy.types.Scene, tmp_path: Path, play: Play, with_what: str
) -> None:
    """Oracle: the unchanged mesh; the panel names the folder, the file, and the button that imports
    it, which then works."""
    write_splats(tmp_path / "a.ply", splats(50))
    output = tmp_path / "out_region_1"
    play({"await": "go"}, {"say": done(40, "finished", str(output / "point_cloud.ply"))})
    ob = cropped(studio, tmp_path / "a.ply")
    meshes = set(bpy.data.meshes)
    bpy.ops.gscore.train_region()
    job = train_region.job_of(studio)
    until(lambda: job._process is not None)
    write_splats(output / "point_cloud.ply", splats(70))
    if with_what == "shape keys":
        ob.shape_key_add(name="Basis")
    else:
        action = bpy.data.actions.new("moves")
        ob.data.animation_data_create().nla_tracks.new().strips.new("moves", 1, action)
    job._process.send("go")
    until(lambda: job.ended and not job.awaits_import)
    assert len(ob.data.vertices) == 50 and set(bpy.data.meshes) == meshes
    assert f"has {with_what}" in job.warnings[-1] and f"is in {output};" in job.warnings[-1]
    assert "Result > Import adds point_cloud.ply" in drawn(RegionPanel)
    assert bpy.ops.gscore.import_splats(filepath=str(output / "point_cloud.ply")) == {"FINISHED"}
    assert len(bpy.context.object.data.vertices) == 70


def test_stopping_leaves_all_as_it_was(studio: bpy.types.Scene, tmp_path: Path, play: Play) -> None:
    """Oracle: the splats of the object."""
    write_splats(tmp_path / "a.ply", splats(50))
    play({"say": STARTED}, {"follow": 600})
    ob = cropped(studio, tmp_path / "a.ply")
    before = positions(ob)
    bpy.ops.gscore.train_region()
    job = train_region.job_of(studio)
    until(lambda: job.progress is not None)
    assert bpy.ops.gscore.stop_region() == {"FINISHED"}
    until(lambda: job.ended)
    assert job.status == verb_job.CANCELLED and not job.awaits_import
    assert np.array_equal(positions(ob), before)
    assert "stay as they were" in drawn(RegionPanel)


def test_no_step_of_the_start_is_long(
    studio: bpy.types.Scene, tmp_path: Path, play: Play, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the attributes read per call, none by the button press itself; the thread that
    writes; the splats at the button press, byte by byte, although all were painted over
    meanwhile."""
    write_splats(tmp_path / "a.ply", splats(50))
    play({"say": STARTED}, {"follow": 600})
    ob = cropped(studio, tmp_path / "a.ply")
    matrix = splat_files.source_matrix_of_data(ob)
    expected = objects.moved(objects.read(ob), matrix, ob.name)
    read, writers, meshes = [], [], len(bpy.data.meshes)
    copy, write = point_attributes.copy_values, train_region.write_splat_file
    monkeypatch.setattr(read_chunked, "BUDGET", 0.0)
    monkeypatch.setattr(
        point_attributes, "copy_values", lambda *a: (read.append(a[1]), copy(*a))[1]
    )
    monkeypatch.setattr(
        train_region,
        "write_splat_file",
        lambda *a, **k: (writers.append(threading.current_thread()), write(*a, **k))[1],
    )
    bpy.ops.gscore.train_region()
    assert not read and not (tmp_path / "out_region_1").exists()
    assert "Writing the splats" in drawn(RegionPanel)
    ob.data.attributes["radiance:base"].data.foreach_set("color", np.zeros(200, np.float32))
    job = train_region.job_of(studio)
    while job._process is None:
        before = len(read)
        poll_timer.poll()
        assert len(read) <= before + 1
    assert len(read) == 7 and writers != [threading.main_thread()]
    assert len(bpy.data.meshes) == meshes
    found = read_splats(tmp_path / "out_region_1/start/start.ply")
    for name in ("means", "quats", "scales", "opacities", "sh0", "shN"):
        assert getattr(found, name).tobytes() == getattr(expected, name).tobytes()


def test_stopping_before_the_start(studio: bpy.types.Scene, tmp_path: Path, play: Play) -> None:
    """Oracle: no file, mesh or process is left, and the next one may begin."""
    write_splats(tmp_path / "a.ply", splats(50))
    reported = play({"say": STARTED}, {"follow": 600})
    cropped(studio, tmp_path / "a.ply")
    meshes = len(bpy.data.meshes)
    bpy.ops.gscore.train_region()
    job = train_region.job_of(studio)
    assert bpy.ops.gscore.stop_region() == {"FINISHED"}
    assert job.status == verb_job.CANCELLED
    poll_timer.poll()
    assert job.preparing is None and len(bpy.data.meshes) == meshes
    assert not reported.exists() and not (tmp_path / "out_region_1").exists()
    assert bpy.ops.gscore.train_region() == {"FINISHED"}


def test_a_start_that_cannot_be_written(
    studio: bpy.types.Scene, tmp_path: Path, play: Play
) -> None:
    """Oracle: an error in the panel that names the file, or the missing splats."""
    write_splats(tmp_path / "a.ply", splats(50))
    play({"say": STARTED}, {"follow": 600})
    cropped(studio, tmp_path / "a.ply")
    (tmp_path / "full").write_text("a file where a folder should be")
    studio.gscore.output_path = str(tmp_path / "full" / "out")
    bpy.ops.gscore.train_region()
    job = train_region.job_of(studio)
    until(lambda: job.ended)
    assert job.status == verb_job.FAILED and "full" in job.sentence
    assert "a part of its path is a file" in drawn(RegionPanel)
    studio.gscore.output_path = str(tmp_path / "out")
    bpy.ops.gscore.train_region()
    bpy.data.meshes.remove(next(m for m in bpy.data.meshes if "gs_temporary" in m))
    job = train_region.job_of(studio)
    until(lambda: job.ended)
    assert job.status == verb_job.FAILED and "was removed" in job.sentence


@pytest.mark.parametrize("error", [MemoryError, OSError("no space left")])
def test_a_start_that_fails_begins_nothing(
    studio: bpy.types.Scene,
    tmp_path: Path,
    play: Play,
    monkeypatch: pytest.MonkeyPatch,
    error: Exception,
) -> None:
    """Oracle: an error in the panel, and no started process."""
    write_splats(tmp_path / "a.ply", splats(50))
    play({"say": STARTED}, {"follow": 600})
    cropped(studio, tmp_path / "a.ply")

    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(train_region, "write_region", fail)
    bpy.ops.gscore.train_region()
    job = train_region.job_of(studio)
    until(lambda: job.ended)
    for _ in range(3):
        poll_timer.poll()
    assert job.status == verb_job.FAILED and job._process is None
    assert job.sentence in ("MemoryError", "no space left")


def test_invalid_regions_are_refused(studio: bpy.types.Scene, tmp_path: Path, play: Play) -> None:
    """Oracle: an error for each, and that nothing was written."""
    write_splats(tmp_path / "a.ply", splats(50))
    play({"exit": 1})
    ob = cropped(studio, tmp_path / "a.ply")
    ob.shape_key_add(name="Basis")  # which the result cannot keep
    with pytest.raises(RuntimeError, match="has shape keys"):
        bpy.ops.gscore.train_region()
    ob.shape_key_clear()
    ob.gscore.crop_invert = True
    with pytest.raises(RuntimeError, match="Box, not inverted"):
        bpy.ops.gscore.train_region()
    ob.gscore.crop_invert = False
    ob.gscore.crop_object.scale.x = 0
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="has no volume"):
        bpy.ops.gscore.train_region()
    ob.gscore.crop_object = None
    with pytest.raises(RuntimeError, match="add a crop box"):
        bpy.ops.gscore.train_region()
    assert not (tmp_path / "out_region_1").exists()
    studio.gscore.capture_path = ""
    with pytest.raises(RuntimeError, match="Capture is empty"):
        bpy.ops.gscore.train_region()


@needs_trainer
def test_a_real_training_of_a_region(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: bytes of the splats outside of the box, of the object and of the PLY."""
    preferences.get().python_path = REAL
    studio.gscore.preset, studio.gscore.resolution = "preview", "4"
    means = positions(next(ob for ob in studio.objects if ob.get("gs_kind") == "points"))
    write_splats(tmp_path / "a.ply", replace(splats(len(means)), means=means))
    ob = cropped(studio, tmp_path / "a.ply")
    before = objects.read(ob)
    outside = ~in_box(ob, before.means)
    count = int(outside.sum())
    assert 0 < count < len(before)
    studio.gscore_steer.region_steps = 60
    assert bpy.ops.gscore.train_region(wait=True) == {"FINISHED"}
    after = objects.read(ob)
    start, whole = (read_splats(tmp_path / f"out_region_1/{name}.ply") for name in FILES)
    for name in ("means", "quats", "scales", "opacities", "sh0", "shN"):
        kept, new = getattr(whole, name)[:count], getattr(after, name)
        rest = getattr(start, name)[outside]
        assert kept.tobytes() == rest.tobytes()
        # Blender stores standard deviations, not their logarithms, and unit quaternions.
        assert np.allclose(new[:count], getattr(before, name)[outside], rtol=1e-5, atol=1e-6)
    assert after.means[:count].tobytes() == before.means[outside].tobytes()
    assert after.means[count:].tobytes() != before.means[~outside].tobytes()


def test_the_region_of_what_was_added(studio: bpy.types.Scene, tmp_path: Path, play: Play) -> None:
    """Oracle: by Blender's own matrices, the box holds the marked splats and a tenth around them;
    the start has all splats. Without a crop box; refused without marked splats."""
    write_splats(tmp_path / "a.ply", splats(500))
    reported = play({"say": STARTED}, {"follow": 600})
    root = next(ob for ob in studio.objects if ob.get("gs_kind") == "capture")
    ob = import_splats(bpy.context, tmp_path / "a.ply", parent=root)
    bpy.context.view_layer.objects.active = ob
    ob.location = (1, 2, 3)
    bpy.context.view_layer.update()
    assert not bpy.ops.gscore.train_healed.poll()
    assert "Train Healed Region" not in drawn(RegionPanel)
    marks = ob.data.attributes.new(attributes.HEALED, "BOOLEAN", "POINT")
    with pytest.raises(RuntimeError, match="no splats that Heal or Clone added"):
        bpy.ops.gscore.train_healed()
    places = positions(ob)
    chosen = np.linalg.norm(places - places[7], axis=1) < np.ptp(places, axis=0).max() / 4
    marks.data.foreach_set("value", chosen)
    assert "Train Healed Region" in drawn(RegionPanel)
    assert bpy.ops.gscore.train_healed() == {"FINISHED"}
    until(reported.exists)
    words = json.loads(reported.read_text())
    given = {flag: words[words.index(flag) + 1] for flag in ("--start-splats", "--region")}
    start = read_splats(given["--start-splats"])
    assert len(start) == 500
    box = np.array(json.loads(Path(given["--region"]).read_text())["box"])
    local = (start.means - box[:3, 3]) @ np.linalg.inv(box[:3, :3]).T
    assert 3 < chosen.sum() < 400
    np.testing.assert_allclose(np.abs(local[chosen]).max(axis=0), 1 / 1.1, rtol=1e-4)
