"""Oracle: events of a scripted measurement, the map that it wrote, and the scene before and
after."""

import json
import os
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from addon import attributes, preferences, stored_paths
from addon.cameras.objects import cameras_of
from addon.core import colorize, write_splats
from addon.error_maps import measure_errors
from addon.panels.result import ErrorsPanel
from addon.process.incremental_tasks import run_blocking
from addon.region_training.train_region import train_region
from addon.render import compare
from addon.render.compare import PSNR
from addon.splats import objects
from addon.splats.error_maps import drop_maps
from addon.training import lookups, verb_job
from addon.training.verb_jobs import JOBS
from tests.addon.calls import import_splats
from tests.addon.captures import STUDIO
from tests.addon.drawn import drawn
from tests.addon.fake_trainer import fake_python
from tests.addon.trainings import splats, until
from tests.light_changes import encode

REAL = os.environ.get("GSCORE_TRAINER_PYTHON", "")
needs_trainer = pytest.mark.skipif(not REAL, reason="GSCORE_TRAINER_PYTHON names no Python")


@pytest.fixture
def result(studio: bpy.types.Scene, tmp_path: Path) -> bpy.types.Object:
    """Active, moved splats of a run of the studio, with its cameras."""
    bpy.ops.gscore.import_cameras()
    root = next(ob for ob in studio.objects if ob.get("gs_kind") == "capture")
    run = tmp_path / "run"
    (run / "errors").mkdir(parents=True)
    write_splats(run / "point_cloud.ply", splats(50))
    ob = import_splats(bpy.context, run / "point_cloud.ply", parent=root)
    stored_paths.write(ob, stored_paths.RUN, run)
    stored_paths.write(ob, stored_paths.SOURCE, STUDIO)
    ob.location, ob.rotation_euler = (0.3, 0.1, -0.2), (0.1, 0.2, 0.3)
    bpy.context.view_layer.objects.active = ob
    bpy.context.view_layer.update()
    return ob


def play(tmp_path: Path, ob: bpy.types.Object, views: dict[str, float | None]) -> Path:
    """Replace the preferences' Python by a fake that measures; return the file of its arguments."""
    path = measure_errors.run_of(ob) / "errors" / "errors.ply"
    write_splats(path, replace(splats(50), shN=np.zeros((50, 0, 3), np.float32)))
    figures = [{"name": name, "psnr": psnr} for name, psnr in views.items()]
    (path.parent / "metrics.json").write_text(json.dumps({"views": figures}))
    done = {"event": "evaluated", "split": "all", "path": str(path.parent), "views": views}
    script = [
        {"say": {"event": "eval_progress", "done": 1, "total": 2, "view": "a: 20 dB", "eta_s": 1}},
        {"say": done | {"error_map": str(path), "error_bright": 0.08}},
    ]
    preferences.get().python_path = str(fake_python(tmp_path / "python", script))
    return tmp_path / "python" / "script.args"


def test_errors_are_shown_and_taken_away(result: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the colour map at the PSNRs, the file's splats at the transform of the result; after
    removal colours, objects and visibility are as before."""
    cameras = cameras_of(result.parent)
    own = [tuple(camera.color) for camera in cameras]
    names = [camera["gs_image"] for camera in cameras]
    psnr = {name: 20.0 + i for i, name in enumerate(names[:-1])} | {names[1]: None}
    args = play(tmp_path, result, psnr)
    there = set(bpy.data.objects)
    assert bpy.ops.gscore.measure_errors(wait=True) == {"FINISHED"}
    line = json.loads(args.read_text())
    run = measure_errors.run_of(result)
    for words in ("eval", str(run), "--split all", f"--error-map {run / 'errors' / 'errors.ply'}"):
        assert words in " ".join(line)
    (shown,) = set(bpy.data.objects) - there
    assert not result.visible_get() and shown.visible_get() and result.hide_render
    assert np.allclose(shown.matrix_world, result.matrix_world, atol=1e-6)
    assert bpy.context.object == shown and len(shown.data.vertices) == 50
    assert attributes.sh_count(shown.data) == 0
    worst, best = 20.0, 20.0 + len(names) - 2
    for i, camera in enumerate(cameras[:-1]):
        place = 0.0 if i == 1 else (best - (20.0 + i)) / (best - worst)
        srgb = colorize(np.array(0.15 + 0.85 * place)) / 255
        np.testing.assert_allclose(encode(camera.color[:3]), srgb, atol=1e-3)
    assert tuple(cameras[-1].color) == own[-1]
    assert lookups.figures.wait(run)[0] is not None
    text = drawn(ErrorsPanel)
    assert "20.0 dB" in text and names[0] in text and "8%" in text
    JOBS._jobs.clear()  # as after restarting Blender
    assert "20.0 dB" in drawn(ErrorsPanel)
    bpy.ops.gscore.show_error_map(show=False)
    assert result.visible_get() and not shown.visible_get() and bpy.context.object == result
    bpy.ops.gscore.color_by_error(show=False)
    assert [tuple(camera.color) for camera in cameras] == own
    bpy.ops.gscore.color_by_error(show=True)
    assert measure_errors.are_colored(result.parent)
    os.utime(run / "errors" / "metrics.json", (1e9, 1e9))
    with pytest.raises(RuntimeError, match="not measured since"):
        bpy.ops.gscore.color_by_error(show=True)
    bpy.ops.gscore.remove_errors()
    assert set(bpy.data.objects) == there and result.visible_get() and not result.hide_render
    assert [tuple(camera.color) for camera in cameras] == own


def test_measured_again_into_the_same_object(result: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: one map after two measurements, from the map as from the splats."""
    play(tmp_path, result, {"a": 20.0})
    for _ in range(2):
        bpy.ops.gscore.measure_errors(wait=True)
    assert len(measure_errors.siblings(result)[1]) == 1 and measure_errors.is_map(
        bpy.context.object
    )


def test_splats_and_their_errors_never_overlie(result: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: which of both is visible, in the view and in renders; a map cannot train a region; a
    map without its splats is removed."""
    play(tmp_path, result, {"a": 20.0})
    bpy.ops.gscore.measure_errors(wait=True)
    shown = bpy.context.object
    with pytest.raises(ValueError, match="shows errors, not splats"):
        train_region(bpy.context.scene, shown)
    assert bpy.ops.gscore.show_splats() == {"FINISHED"}
    assert bpy.context.object == result and result.visible_get() and not result.hide_render
    assert not shown.visible_get() and shown.hide_render
    measure_errors.show_map(result, True)
    drop_maps(result)
    assert measure_errors.siblings(result) == ([result], []) and result.visible_get()


def test_photos_are_compared_with_splats_and_never_with_errors(
    result: bpy.types.Object, tmp_path: Path
) -> None:
    """Oracle: the PSNR without a map; which of both is visible, before and after."""
    camera = cameras_of(result.parent)[0]
    bpy.ops.gscore.compare_photo(camera=camera.name)
    before = camera[PSNR]
    play(tmp_path, result, {"a": 20.0})
    map_path = measure_errors.run_of(result) / "errors" / "errors.ply"
    other = splats(50)
    write_splats(map_path, replace(other, means=other.means + 0.3, shN=other.shN[:, :0]))
    bpy.ops.gscore.measure_errors(wait=True)
    shown = bpy.context.object
    depsgraph = bpy.context.evaluated_depsgraph_get()
    seen = run_blocking(compare.Comparing(bpy.context.scene, camera, depsgraph).compared())
    assert abs(seen.psnr - before) > 1e-3  # the map is another picture
    bpy.ops.gscore.compare_photo(camera=camera.name)
    assert camera[PSNR] == pytest.approx(before, abs=1e-6)
    assert shown.visible_get() and not result.visible_get()


def test_hidden_splats_are_not_edited(result: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the message says what to do, and the selection is as before."""
    result.hide_set(True)
    bpy.context.view_layer.objects.active = result
    before = attributes.selected(result.data)
    for verb in (bpy.ops.gscore.select_floaters, bpy.ops.gscore.select_by_opacity):
        with pytest.raises(RuntimeError, match=r"is hidden; show it, with its eye"):
            verb()
    assert (attributes.selected(result.data) == before).all() and bpy.context.mode == "OBJECT"


def test_splats_that_the_view_layer_excludes(result: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the map is made, and shown when the collection is included again."""
    play(tmp_path, result, {"a": 20.0})
    collection = bpy.data.collections.new("away")
    bpy.context.scene.collection.children.link(collection)
    for holder in result.users_collection:
        holder.objects.unlink(result)
    collection.objects.link(result)
    child = bpy.context.view_layer.layer_collection.children["away"]
    job = measure_errors.measure(result)
    child.exclude = True
    until(lambda: job.ended and not job.awaits_import)
    assert not job.warnings and len(measure_errors.siblings(result)[1]) == 1
    child.exclude = False
    bpy.context.view_layer.objects.active = result
    bpy.ops.gscore.show_error_map(show=True)
    assert not result.visible_get() and measure_errors.is_map(bpy.context.object)


def test_unmeasurable_objects_are_refused(result: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: error messages, and an unchanged scene."""
    (measure_errors.run_of(result) / "point_cloud.ply").unlink()
    with pytest.raises(RuntimeError, match="no finished training"):
        bpy.ops.gscore.measure_errors()
    del result[stored_paths.RUN]
    assert not bpy.ops.gscore.measure_errors.poll()
    with pytest.raises(ValueError, match="is not from a training"):
        measure_errors.measure(result)


def test_splats_that_are_gone(result: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the message names the map; no object is made."""
    play(tmp_path, result, {"a": 20.0})
    job = measure_errors.measure(result)
    bpy.data.objects.remove(result)
    until(lambda: job.ended and not job.awaits_import)
    assert "gone" in job.warnings[-1] and not any(map(measure_errors.is_map, bpy.data.objects))


@needs_trainer
def test_a_real_run(result: bpy.types.Object) -> None:
    """Oracle: a bad model: every camera has a PSNR, and the map has the splats' positions."""
    preferences.get().python_path = REAL
    run = measure_errors.run_of(result)
    config = {"gscore": "0.1.0", "data": {"source": str(STUDIO), "resolution": 4}, "train": {}}
    (run / "config.json").write_text(json.dumps(config))
    job = measure_errors.measure(result, wait=True)
    assert job.status == verb_job.FINISHED, job.sentence
    assert len(job.report.ranked) == 60 and measure_errors.are_colored(result.parent)
    (shown,) = measure_errors.siblings(result)[1]
    positions = (attributes.column(ob.data, attributes.POSITION) for ob in (shown, result))
    assert np.array_equal(*positions) and objects.is_splats(shown)
