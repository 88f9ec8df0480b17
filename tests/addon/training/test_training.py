"""Oracle: the scene after a scripted trainer, and the real trainer's files."""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Quaternion, Vector

from addon import preferences
from addon import training as job_api
from addon.core import write_splats
from addon.panels.progress import RunningWorkPanel, bar_text
from addon.paths import output_folder
from addon.process import poll_timer
from addon.splats import write_chunked
from addon.stored_paths import RUN
from addon.training import display, registry, run_state, start_training
from addon.training.training_job import Job
from tests.addon.calls import import_capture
from tests.addon.drawn import drawn
from tests.addon.fake_trainer import CONFIG, STARTED, fake_python, finish, step
from tests.addon.splat_scenes import error_of
from tests.addon.trainings import positions, splats, until

ROOT = Path(__file__).parents[3]
STUDIO = ROOT / "examples" / "studio"
REAL = os.environ.get("GSCORE_TRAINER_PYTHON", "")
needs_trainer = pytest.mark.skipif(not REAL, reason="GSCORE_TRAINER_PYTHON names no Python")
Play = Callable[..., Path]


def test_snapshots_then_the_result_reach_one_object(
    studio: bpy.types.Scene, play: Play, tmp_path: Path
) -> None:
    """Oracle: the splats in the files; the preview is thinned out, the result is not."""
    snapshot, result = splats(3000, 1), splats(2000, 2)
    write_splats(tmp_path / "s.ply", snapshot)
    write_splats(tmp_path / "out" / "point_cloud.ply", result)
    event = {"event": "snapshot", "step": 5, "path": str(tmp_path / "s.ply"), "splats": 3000}
    play({"say": STARTED}, {"say": event}, {"await": "go"}, finish())
    preferences.get().live_most = 1000
    job = start_training.train(studio, overwrite=True)
    until(lambda: studio.gscore.result is not None)
    ob = studio.gscore.result
    np.testing.assert_array_equal(positions(ob), snapshot.means[::3])
    assert ob[RUN] == str(tmp_path / "out")
    job._process.send("go")
    assert start_training.wait_for(job, timeout=60)
    assert studio.gscore.result is ob
    np.testing.assert_array_equal(positions(ob), result.means)
    assert len([a for a in ob.data.attributes if a.name.startswith("radiance:sh_")]) == 3


def test_splats_show_though_each_beat_finds_lines(
    studio: bpy.types.Scene, play: Play, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the splats of the snapshot. This happens when Blender redraws a view continuously."""
    snapshot = splats(3000, 1)
    write_splats(tmp_path / "s.ply", snapshot)
    event = {"event": "snapshot", "step": 5, "path": str(tmp_path / "s.ply"), "splats": 3000}
    play({"say": STARTED}, {"say": event}, {"await": "go"}, finish())
    poll = Job.poll
    monkeypatch.setattr(Job, "poll", lambda job: poll(job) or True)
    start_training.train(studio, overwrite=True)
    until(lambda: studio.gscore.result is not None)
    np.testing.assert_array_equal(positions(studio.gscore.result), snapshot.means)


@pytest.mark.parametrize("discarded", [False, True])
def test_points_make_room_for_splats(
    studio: bpy.types.Scene, play: Play, tmp_path: Path, discarded: bool
) -> None:
    """Oracle: they are hidden with the first splats; if shown again, they stay visible; discarding
    the training shows them again."""
    points = import_capture(bpy.context.scene, STUDIO, photos=False).points
    write_splats(tmp_path / "a.ply", splats(10))
    write_splats(tmp_path / "out" / "point_cloud.ply", splats(10))
    event = {"event": "snapshot", "step": 1, "path": str(tmp_path / "a.ply"), "splats": 10}
    after = ({"sleep": 600},) if discarded else ({"await": "go"}, finish())
    play({"say": STARTED}, {"say": event}, *after)
    job = start_training.train(studio, overwrite=True)
    assert points.visible_get()
    until(lambda: studio.gscore.result is not None)
    assert not points.visible_get()
    if discarded:
        assert bpy.ops.gscore.discard_training() == {"FINISHED"}
        until(lambda: job.state.ended and studio.gscore.result is None)
    else:
        points.hide_set(False)
        job._process.send("go")
        assert start_training.wait_for(job, timeout=60)
    assert points.visible_get()


def test_the_display_is_built_bit_by_bit(
    built_anew: None, studio: bpy.types.Scene, play: Play, tmp_path: Path
) -> None:
    """Oracle: the datablocks of the file: at most one more per poll, all before they are used."""
    play({"say": STARTED}, {"await": "go"}, finish())
    job = start_training.train(studio, overwrite=True)
    count = lambda: len(bpy.data.node_groups) + len(bpy.data.materials)  # noqa: E731
    assert count() == 0
    counts = [0]
    until(lambda: counts.append(count()) or not job.preparations)
    assert max(np.diff(counts)) == 1
    built = set(bpy.data.node_groups)
    job._process.send("go")
    write_splats(tmp_path / "out" / "point_cloud.ply", splats(10))
    assert start_training.wait_for(job, timeout=60) and studio.gscore.result is not None
    assert set(bpy.data.node_groups) == built and len(built) == 9


@pytest.mark.parametrize("stated", [False, True])
def test_the_result_stands_upright(
    studio: bpy.types.Scene, play: Play, tmp_path: Path, stated: bool
) -> None:
    """Oracle: the up axis of a ring of level cameras in an arbitrarily rotated world; for cameras
    on their sides, the axis stated by the run."""
    world = Quaternion((0.3, -0.5, 0.7, 0.4)).normalized().to_matrix()
    entries = []
    for angle in np.linspace(0, 2 * np.pi, 12, endpoint=False):
        back = Vector((np.cos(angle), np.sin(angle), 0))
        right = Vector((0, 0, 1)).cross(back)
        axes = Matrix((right, Vector((0, 0, -1)), -back)).transposed()
        if stated:
            axes = axes @ Matrix.Rotation(1.2, 3, "Z")
        pose = {"position": list(world @ (4 * back)), "rotation": [*map(list, world @ axes)]}
        size = {"width": 64, "height": 48, "fx": 50.0, "fy": 50.0}
        entries.append({"id": len(entries), "img_name": f"{angle:.2f}.png", **pose, **size})
    if stated:
        entries[0]["up"] = list(world @ Vector((0, 0, 1)))
    write_splats(tmp_path / "out" / "point_cloud.ply", splats(300, 1))
    (tmp_path / "out" / "cameras.json").write_text(json.dumps(entries))
    play({"say": STARTED}, finish())
    start_training.train(studio, overwrite=True, wait=True)
    up = studio.gscore.result.matrix_world.to_3x3() @ (world @ Vector((0, 0, 1)))
    np.testing.assert_allclose(up, (0, 0, 1), atol=1e-4)


def test_cameras_say_how_far_they_were_moved(
    studio: bpy.types.Scene, play: Play, tmp_path: Path
) -> None:
    """Oracle: the poses.json of the run; cameras that it does not name have no value, also those
    that an earlier run had moved."""
    made = import_capture(bpy.context.scene, STUDIO, photos=False, points=False)
    first, second = made.cameras[:2]
    second["gs_turned_degrees"] = 7.0
    facts = {"degrees": 0.25, "distance": 0.5, "viewmat": np.eye(4).tolist()}
    write_splats(tmp_path / "out" / "point_cloud.ply", splats(30, 1))
    (tmp_path / "out" / "poses.json").write_text(json.dumps({first["gs_image"]: facts}))
    play({"say": STARTED}, finish())
    start_training.train(studio, overwrite=True, wait=True)
    assert (first["gs_turned_degrees"], first["gs_moved"]) == (0.25, 0.5)
    assert not any(key in second for key in ("gs_turned_degrees", "gs_moved"))


def test_the_trainer_gets_the_settings(studio: bpy.types.Scene, play: Play) -> None:
    """Oracle: the command line that the fake received."""
    python = play({"say": STARTED}, {"exit": 0})
    studio.gscore.iterations = 77
    start_training.train(studio, wait=True)
    arguments = json.loads((python.parent / "script.args").read_text())
    assert arguments[:5] == ["-u", "-m", "gscore", "train", str(STUDIO)]
    assert arguments[arguments.index("--iterations") + 1] == "77"
    assert arguments[arguments.index("--events") + 1] == "jsonl"


def test_a_test_view_becomes_an_image(studio: bpy.types.Scene, play: Play, tmp_path: Path) -> None:
    """Oracle: pixels of the two pictures, in one image."""
    events = []
    for number, color in enumerate(((1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0))):
        image = bpy.data.images.new("source", 4, 4)
        image.pixels.foreach_set(np.tile(np.float32(color), 16))
        image.filepath_raw = str(tmp_path / f"{number}.png")
        image.file_format = "PNG"
        image.save()
        bpy.data.images.remove(image)
        events.append({"event": "preview", "step": number, "view": "a.jpg"})
        events[-1]["path"] = str(tmp_path / f"{number}.png")
    play({"say": STARTED}, {"say": events[0]}, {"await": "go"}, {"say": events[1]}, {"exit": 0})
    job = start_training.train(studio)
    until(lambda: studio.gscore.preview is not None)
    image = studio.gscore.preview
    assert tuple(image.pixels[:4]) == (1.0, 0.0, 0.0, 1.0)
    job._process.send("go")
    start_training.wait_for(job, timeout=60)
    until(lambda: job.preview_shown.endswith("1.png"))
    assert studio.gscore.preview is image
    assert tuple(image.pixels[:4]) == (0.0, 0.0, 1.0, 1.0)
    assert len(bpy.data.images) == 1


def test_an_edited_object_is_left_alone(
    studio: bpy.types.Scene, play: Play, tmp_path: Path
) -> None:
    """Oracle: in Edit Mode nothing changes; afterwards the result arrives."""
    for name, count in (("a", 10), ("b", 20)):
        write_splats(tmp_path / f"{name}.ply", splats(count))
    say = [
        {"say": {"event": "snapshot", "step": 1, "path": str(tmp_path / f"{n}.ply"), "splats": 1}}
        for n in "ab"
    ]
    play({"say": STARTED}, say[0], {"await": "go"}, say[1], finish(str(tmp_path / "b.ply")))
    job = start_training.train(studio)
    until(lambda: studio.gscore.result is not None)
    ob = studio.gscore.result
    bpy.context.view_layer.objects.active = ob
    bpy.ops.object.mode_set(mode="EDIT")
    job._process.send("go")
    until(lambda: job.state.ended)
    for _ in range(30):
        poll_timer.poll()
        time.sleep(0.01)
    bpy.ops.object.mode_set(mode="OBJECT")
    assert len(ob.data.vertices) == 10
    assert start_training.wait_for(job, timeout=60)
    assert len(ob.data.vertices) == 20


def test_an_edited_result_is_kept_when_the_run_goes_on(
    studio: bpy.types.Scene, play: Play, tmp_path: Path
) -> None:
    """Oracle: the edited object, a new one next to it, and a warning."""
    write_splats(tmp_path / "out" / "point_cloud.ply", splats(300, 3))
    play({"say": STARTED}, finish())
    assert start_training.wait_for(start_training.train(studio, overwrite=True), timeout=60)
    edited = studio.gscore.result
    job = start_training.train(studio, overwrite=True)
    assert start_training.wait_for(job, timeout=60)
    assert studio.gscore.result is edited, "an untouched one is filled again"
    edited.data.attributes["position"].data[7].vector = (9, 9, 9)
    kept = positions(edited)
    job = start_training.train(studio, overwrite=True)
    assert start_training.wait_for(job, timeout=60)
    assert studio.gscore.result is not edited
    np.testing.assert_array_equal(positions(edited), kept)
    assert any("was edited and is kept" in text for text in job.state.warnings)


def test_undo_of_the_next_step_keeps_the_result(
    studio: bpy.types.Scene, play: Play, tmp_path: Path
) -> None:
    """Oracle: the undo removes the user's own object; the splats are those in the file."""
    snapshot, result = splats(30, 1), splats(20, 2)
    write_splats(tmp_path / "s.ply", snapshot)
    write_splats(tmp_path / "out" / "point_cloud.ply", result)
    event = {"event": "snapshot", "step": 5, "path": str(tmp_path / "s.ply"), "splats": 30}
    play({"say": STARTED}, {"say": event}, {"await": "go"}, finish())
    bpy.ops.ed.undo_push(message="start")
    job = start_training.train(studio, overwrite=True)
    until(lambda: studio.gscore.result is not None)
    for expected in (snapshot, result):
        bpy.ops.object.empty_add()
        bpy.ops.ed.undo_push(message="empty")
        bpy.ops.ed.undo()
        (ob,) = bpy.context.scene.objects
        assert ob == bpy.context.scene.gscore.result
        np.testing.assert_array_equal(positions(ob), expected.means)
        job._process.send("go")
        assert start_training.wait_for(job, timeout=60)


def test_results_of_other_runs_stay(studio: bpy.types.Scene, play: Play, tmp_path: Path) -> None:
    """Oracle: a second run into another folder makes a second object."""
    write_splats(tmp_path / "a.ply", splats(10))
    write_splats(tmp_path / "b.ply", splats(20))
    play({"say": STARTED}, finish(str(tmp_path / "a.ply")))
    start_training.train(studio, wait=True)
    first = studio.gscore.result
    studio.gscore.output_path = str(tmp_path / "second")
    play({"say": STARTED}, finish(str(tmp_path / "b.ply")), name="python2")
    start_training.train(studio, wait=True)
    assert studio.gscore.result is not first
    assert (len(first.data.vertices), len(studio.gscore.result.data.vertices)) == (10, 20)


def test_a_deleted_or_broken_result_is_a_sentence(
    studio: bpy.types.Scene, play: Play, tmp_path: Path
) -> None:
    """Oracle: no object, no exception, the file is named."""
    (tmp_path / "cut.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\nelement ver")
    for name in ("missing.ply", "cut.ply"):
        play({"say": STARTED}, finish(str(tmp_path / name)))
        job = start_training.train(studio, overwrite=True, wait=True)
        assert name in job.state.warnings[-1]
        assert "could not be shown" in job.state.sentence
        assert studio.gscore.result is None
        assert len(bpy.data.objects) == 0


def test_a_job_outlives_the_file(studio: bpy.types.Scene, play: Play, tmp_path: Path) -> None:
    """Oracle: another file shows nothing; the file of the run shows the job and its result."""
    write_splats(tmp_path / "r.ply", splats(30))
    play({"say": STARTED}, step(1), {"await": "go"}, finish(str(tmp_path / "r.ply")))
    output = tmp_path / "out"
    job = start_training.train(studio)
    until(lambda: job.state.step == 1)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"))
    bpy.ops.wm.read_homefile(use_empty=True)
    other = bpy.context.scene
    assert job_api.job_of(other) is None
    job._process.send("go")
    assert start_training.wait_for(job, timeout=60)
    assert job.state.status == run_state.FINISHED
    assert len(bpy.data.objects) == 0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "mine.blend"))
    mine = bpy.context.scene
    assert job_api.job_of(mine) is job and output_folder(mine) == output
    assert start_training.wait_for(job, timeout=60)
    assert len(mine.gscore.result.data.vertices) == 30


def test_a_training_is_followed_in_another_file(
    studio: bpy.types.Scene, play: Play, tmp_path: Path
) -> None:
    """Oracle: the progress bar in the other file, and the splats imported into it after that."""
    write_splats(tmp_path / "r.ply", splats(30))
    play({"say": STARTED}, step(1), {"await": "go"}, finish(str(tmp_path / "r.ply")))
    job = start_training.train(studio)
    until(lambda: job.state.step == 1)
    assert "Training: " in drawn(RunningWorkPanel)
    bpy.ops.wm.read_homefile(use_empty=True)
    assert f"{STUDIO.name}: {bar_text(job.state)}" in drawn(RunningWorkPanel)
    assert bpy.ops.gscore.follow_training(job_id=job.id) == {"FINISHED"}
    other = bpy.context.scene
    assert job_api.job_of(other) is job and "Training: " in drawn(RunningWorkPanel)
    job._process.send("go")
    assert start_training.wait_for(job, timeout=60)
    np.testing.assert_array_equal(positions(other.gscore.result), splats(30).means)
    assert drawn(RunningWorkPanel) == ""
    registry.remove(job)
    assert "was removed" in error_of(lambda: bpy.ops.gscore.follow_training(job_id=job.id))


def test_two_scenes_train_at_once(studio: bpy.types.Scene, play: Play, tmp_path: Path) -> None:
    """Oracle: each scene gets its own splats; a third into a used folder is refused."""
    second = bpy.data.scenes.new("second")
    second.gscore.capture_path = str(STUDIO)
    second.gscore.output_path = str(tmp_path / "second")
    jobs = []
    for scene, count in ((studio, 10), (second, 20)):
        write_splats(tmp_path / f"{count}.ply", splats(count))
        path = str(tmp_path / f"{count}.ply")
        play({"say": STARTED}, {"await": "go"}, finish(path), name=f"p{count}")
        jobs.append(start_training.train(scene))
    with pytest.raises(ValueError, match="is running; stop it first"):
        start_training.train(studio, overwrite=True)
    for job in jobs:
        job._process.send("go")
    assert all(start_training.wait_for(job, timeout=60) for job in jobs)
    counts = [len(scene.gscore.result.data.vertices) for scene in (studio, second)]
    assert counts == [10, 20]
    assert second.objects[0] is second.gscore.result


def test_splats_on_their_way_survive_what_blender_does(
    studio: bpy.types.Scene, play: Play, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the result is complete and no mesh is left over, although the file was loaded
    again."""
    monkeypatch.setattr(write_chunked, "BUDGET", 0.0)
    result = splats(5000)
    write_splats(tmp_path / "r.ply", result)
    play({"say": STARTED}, finish(str(tmp_path / "r.ply")))
    job = start_training.train(studio)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    until(lambda: job.filling is not None)
    poll_timer.poll()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    mine = bpy.context.scene
    beats, end = 0, time.monotonic() + 60
    while mine.gscore.result is None:
        poll_timer.poll()
        beats += 1
        assert time.monotonic() < end
    assert beats >= len(mine.gscore.result.data.attributes) - 3
    assert start_training.wait_for(job, timeout=60)
    np.testing.assert_array_equal(positions(mine.gscore.result), result.means)
    assert [mesh.users for mesh in bpy.data.meshes] == [1]
    assert not display.is_importing()


def test_materials_and_duplicates_stay(studio: bpy.types.Scene, play: Play, tmp_path: Path) -> None:
    """Oracle: the user's material, and a linked duplicate that shows the new splats as well."""
    write_splats(tmp_path / "a.ply", splats(10))
    write_splats(tmp_path / "b.ply", splats(20))
    event = {"event": "snapshot", "step": 1, "path": str(tmp_path / "a.ply"), "splats": 10}
    play({"say": STARTED}, {"say": event}, {"await": "go"}, finish(str(tmp_path / "b.ply")))
    job = start_training.train(studio)
    until(lambda: studio.gscore.result is not None and not display.is_importing())
    ob = studio.gscore.result
    ob.data.materials.append(bpy.data.materials.new("mine"))
    copy = ob.copy()
    studio.collection.objects.link(copy)
    name = ob.data.name
    job._process.send("go")
    assert start_training.wait_for(job, timeout=60)
    assert copy.data == ob.data and len(copy.data.vertices) == 20
    assert (ob.data.name, [m.name for m in ob.data.materials]) == (name, ["mine"])


def test_discard_takes_live_splats_back(
    studio: bpy.types.Scene, play: Play, tmp_path: Path
) -> None:
    """Oracle: neither object nor mesh nor folder is left."""
    write_splats(tmp_path / "a.ply", splats(10))
    event = {"event": "snapshot", "step": 1, "path": str(tmp_path / "a.ply"), "splats": 10}
    write = {"write": ["$out/checkpoints/step_00000001.safetensors", "x"]}
    play(CONFIG, write, {"say": STARTED}, {"say": event}, {"sleep": 600})
    job = start_training.train(studio)
    until(lambda: studio.gscore.result is not None)
    assert bpy.ops.gscore.discard_training() == {"FINISHED"}
    until(lambda: job.state.ended and studio.gscore.result is None)
    assert (len(bpy.data.objects), len(bpy.data.meshes)) == (0, 0)
    assert not (tmp_path / "out").exists()


def _error(call: Callable[[], object]) -> str:
    with pytest.raises(RuntimeError) as caught:
        call()
    return str(caught.value)


def test_bad_input_is_a_sentence(studio: bpy.types.Scene, play: Play, tmp_path: Path) -> None:
    """Oracle: an error with the remedy, and no job and no folder afterwards."""
    settings, train = studio.gscore, bpy.ops.gscore.train
    play({"exit": 0})
    settings.capture_path = str(tmp_path / "nowhere")
    assert "There is no capture" in _error(train)
    settings.capture_path = str(tmp_path)
    assert str(tmp_path) in _error(train)
    settings.capture_path = ""
    assert "Capture is empty; choose a folder." in _error(train)
    settings.capture_path = "//capture"
    assert "which is not saved" in _error(train)
    settings.capture_path = str(STUDIO)
    preferences.get().python_path = str(tmp_path / "no-python")
    assert "There is no Python" in _error(train)
    (tmp_path / "plain.txt").write_text("no program")
    preferences.get().python_path = str(tmp_path / "plain.txt")
    assert "cannot be run" in _error(train)
    preferences.get().lpips_path = str(tmp_path / "no.onnx")
    assert "There is no LPIPS network" in _error(train)
    preferences.get().lpips_path = ""
    assert "contains no checkpoint to resume" in _error(bpy.ops.gscore.resume_training)
    assert registry.jobs() == []
    assert not (tmp_path / "out").exists()
    for name in ("pause_training", "stop_training", "discard_training"):
        assert "in a state that allows this" in _error(getattr(bpy.ops.gscore, name))


def test_resume_needs_the_capture_of_the_run(
    studio: bpy.types.Scene, play: Play, tmp_path: Path
) -> None:
    """Oracle: the error names the missing folder; a chosen one is passed on. The curve continues
    from the checkpoint."""
    from addon.core import PRESETS
    from gscore.config_file import config_json

    out, capture, gone = tmp_path / "out", tmp_path / "moved", tmp_path / "gone"
    (out / "checkpoints").mkdir(parents=True)
    rows = [{"step": 5 * k, "loss": 1.0 / k, "psnr": 20.0 + k} for k in (1, 2)]
    stated = json.dumps({"session": {"meter": {"history": rows}}})
    header = json.dumps({"__metadata__": {"gscore": stated}}).encode()
    raw = len(header).to_bytes(8, "little") + header
    (out / "checkpoints" / "step_00000010.safetensors").write_bytes(raw)
    (out / "config.json").write_text(config_json(*PRESETS["preview"](gone)))
    python = play({"say": STARTED | {"step": 10}}, step(15), {"exit": 0})
    shutil.copytree(STUDIO, gone)
    studio.gscore.capture_path = str(gone)
    studio.gscore.output_path = str(out)
    gone.rename(capture)
    studio.gscore.capture_path = ""
    assert "is missing; choose its folder" in _error(bpy.ops.gscore.resume_training)
    studio.gscore.capture_path = str(capture / "sparse" / "0")
    job = start_training.resume(studio, wait=True)
    assert job.state.curve.steps == [5, 10, 15]
    assert job.state.curve.losses[:2] == [1.0, 0.5] and job.state.curve.psnrs[:2] == [21.0, 22.0]
    arguments = json.loads((python.parent / "script.args").read_text())
    assert arguments[4:8] == [str(capture), "-o", str(out), "--resume"]


@pytest.mark.parametrize(
    "end", ["addon_utils.disable('addon'); os._exit(0)", "os._exit(0)"], ids=["quit", "crash"]
)
def test_leaving_blender_leaves_a_checkpoint(
    run_blender: Callable[..., str], tmp_path: Path, end: str
) -> None:
    """Oracle: the checkpoint that the trainer writes after Blender has ended, in either way.

    Blender disables its add-ons when it quits, but not when it crashes. (The interpreter itself
    must not end: bpy 4.2 as a module crashes then, for any property with an update function.)
    """
    python = fake_python(tmp_path / "p", [{"say": STARTED}, {"follow": 600}])
    out = run_blender(
        f"import sys; sys.path.insert(0, {str(ROOT)!r})\n"
        "import os, time, bpy, addon_utils\n"
        "addon_utils.enable('addon', default_set=True, persistent=True)\n"
        "from addon import preferences, training\n"
        "from addon.process import poll_timer\n"
        f"preferences.get().python_path = {str(python)!r}\n"
        "s = bpy.context.scene.gscore\n"
        f"s.capture_path, s.output_path = {str(STUDIO)!r}, {str(tmp_path / 'out')!r}\n"
        "j = training.train(bpy.context.scene)\n"
        "while j.state.step < 3: poll_timer.poll(); time.sleep(0.01)\n"
        f"print('pid', j.pid, flush=True)\n{end}\n"
    )
    pid = int(out.split("pid")[1].split()[0])
    until = time.monotonic() + 60
    while time.monotonic() < until and Path(f"/proc/{pid}").exists():
        time.sleep(0.05)
    assert not Path(f"/proc/{pid}").exists()
    assert list((tmp_path / "out" / "checkpoints").glob("step_*.safetensors"))


@needs_trainer
def test_the_real_trainer_from_start_to_resume(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: files of the trainer, read by gscore itself."""
    from addon.core import read_splats

    preferences.get().python_path = REAL
    preferences.get().live_seconds = 1.0
    preferences.get().preview_seconds = 1.0
    studio.gscore.iterations, studio.gscore.resolution = 100_000, "4"
    job = start_training.train(studio)

    def follow(condition: Callable[[], bool], timeout: float = 120.0) -> None:
        end = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < end, (job.state.status, job.state.sentence)
            poll_timer.poll()
            time.sleep(0.02)

    follow(lambda: studio.gscore.result is not None and studio.gscore.preview is not None)
    assert job.state.status == run_state.RUNNING and job.state.loss is not None
    job.pause()
    follow(lambda: job.state.status == run_state.PAUSED)
    step_then = job.state.step
    time.sleep(0.5)
    poll_timer.poll()
    assert job.state.step == step_then
    job.unpause()
    follow(lambda: job.state.step > step_then)
    job.stop()
    follow(lambda: job.state.ended)
    assert job.state.status == run_state.STOPPED, job.state.sentence
    assert start_training.wait_for(job, timeout=60)
    result = read_splats(tmp_path / "out" / "point_cloud.ply")
    np.testing.assert_array_equal(positions(studio.gscore.result), result.means)
    stopped_at = job.state.step
    again = start_training.resume(studio)
    follow(lambda: again.state.step > stopped_at)
    assert again.state.started is not None and again.state.started.step == stopped_at
    again.stop()
    follow(lambda: again.state.ended)
    assert again.state.status == run_state.STOPPED, again.state.sentence


@needs_trainer
@pytest.mark.slow
def test_the_real_trainer_is_killed(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: an error; training can be resumed from the earlier checkpoint."""
    preferences.get().python_path = REAL
    studio.gscore.iterations, studio.gscore.resolution = 100_000, "4"
    studio.gscore.max_splats = 10_000
    job = start_training.train(studio)
    until(lambda: job.state.step > 5, timeout=120)
    assert isinstance(job, Job)
    os.kill(job.pid, 9)
    until(lambda: job.state.ended)
    assert job.state.status == run_state.FAILED and "signal 9" in job.state.sentence


def test_the_modules_need_no_bpy() -> None:
    """Oracle: a fresh interpreter in which bpy cannot be imported."""
    names = "training.training_job training.run_state training.curve training.options"
    names += " training.loader training.registry training.lookups training.existing_run"
    names += " trainer_python.environment trainer_python.installer"
    names += " process.background_task interface.lookup"
    code = "import sys; sys.modules['bpy'] = None\n"
    code += "".join(f"import addon.{name}\n" for name in names.split())
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)
