"""Splats of an earlier run in a file that lacks them; oracles: the file and the capture's axes."""

import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest

from addon import stored_paths
from addon.core import MIP_COMMENT, PRESETS
from addon.panels.train import TrainPanel
from addon.splats.objects import ANTIALIAS
from addon.training import facts, lookups, results
from gscore.config_file import config_json
from gscore.io.ply.splats import write_splats
from tests.addon.calls import import_capture
from tests.addon.captures import STUDIO
from tests.addon.drawn import drawn
from tests.addon.splat_scenes import error_of
from tests.addon.trainings import positions, splats, until


def refresh(scene: bpy.types.Scene) -> None:
    """Refresh the panel's facts about the run."""

    def idle() -> bool:
        return not (lookups.collect() or lookups.busy())

    until(idle)  # what was begun before may be of before
    lookups.runs.expire()
    facts.run(scene)
    until(idle)


@pytest.fixture
def run(scene: bpy.types.Scene, tmp_path: Path) -> Path:
    """The folder of a finished run of the studio, chosen in the scene."""
    out = tmp_path / "out"
    (out / "checkpoints").mkdir(parents=True)
    (out / "checkpoints" / "step_00001000.safetensors").write_bytes(b"")
    (out / "config.json").write_text(config_json(*PRESETS["preview"](STUDIO)))
    write_splats(out / "point_cloud.ply", splats(70))
    scene.gscore.capture_path, scene.gscore.output_path = str(STUDIO), str(out)
    facts.refresh(scene)
    until(lambda: facts.run(scene)[0] is not None)
    return out


def test_a_finished_run_comes_into_another_file(scene: bpy.types.Scene, run: Path) -> None:
    """Oracle: the PLY, the capture's empty, and that it becomes the training's own object."""
    root = import_capture(bpy.context.scene, STUDIO).root
    assert "Show Trained Splats" in drawn(TrainPanel)
    assert bpy.ops.gscore.import_result() == {"FINISHED"}
    ob = scene.gscore.result
    assert ob == bpy.context.object and ob.parent == root and ob.name == f"{STUDIO.name} splats"
    assert ob.users_collection == root.users_collection
    np.testing.assert_array_equal(positions(ob), splats(70).means)
    assert Path(stored_paths.read(ob, stored_paths.RUN)) == run and not results.was_edited(ob)
    assert "Show Trained Splats" not in drawn(TrainPanel)


def test_it_needs_no_cameras(scene: bpy.types.Scene, run: Path) -> None:
    """Oracle: the PLY; there is no empty as parent."""
    assert bpy.ops.gscore.import_result() == {"FINISHED"}
    assert scene.gscore.result.parent is None
    np.testing.assert_array_equal(positions(scene.gscore.result), splats(70).means)


def test_missing_result_is_an_error(scene: bpy.types.Scene, run: Path) -> None:
    """Oracle: nothing is imported, with an error."""
    (run / "point_cloud.ply").unlink()
    assert "contains no splats yet" in error_of(bpy.ops.gscore.import_result)
    shutil.rmtree(run)
    assert "contains no run" in error_of(bpy.ops.gscore.import_result)
    assert scene.gscore.result is None


def test_run_continued_elsewhere_updates_the_object(
    scene: bpy.types.Scene, run: Path, tmp_path: Path
) -> None:
    """Oracle: the PLY. The existing object keeps its transform and display and gets the splats;
    copies of the folder are the same run."""
    bpy.ops.gscore.import_result()
    ob = scene.gscore.result
    ob.location.x, ob.gscore.opacity_min = 3.0, 0.25
    shutil.copytree(run, tmp_path / "copy")
    scene.gscore.output_path = str(tmp_path / "copy")
    shutil.rmtree(run)
    (tmp_path / "copy").rename(run)
    scene.gscore.output_path = str(run)
    refresh(scene)
    assert "has earlier splats" not in drawn(TrainPanel)
    write_splats(run / "point_cloud.ply", splats(71))
    refresh(scene)
    reported = drawn(TrainPanel)
    assert f"{ob.name} has earlier splats of this run." in reported
    assert bpy.ops.gscore.import_result() == {"FINISHED"}
    assert scene.gscore.result == ob and bpy.data.objects[:] == [ob] and len(bpy.data.meshes) == 1
    np.testing.assert_array_equal(positions(ob), splats(71).means)
    assert (ob.location.x, ob.gscore.opacity_min) == (3.0, 0.25)
    refresh(scene)
    assert "Show Trained Splats" not in drawn(TrainPanel)


def test_edited_splats_stay_hidden_beside_it(scene: bpy.types.Scene, run: Path) -> None:
    """Oracle: the hidden edited object, and a new one that is the result."""
    bpy.ops.gscore.import_result()
    edited = scene.gscore.result
    edited.data.vertices[0].co.x += 1.0
    kept = positions(edited)
    write_splats(run / "point_cloud.ply", splats(71))
    assert bpy.ops.gscore.import_result() == {"FINISHED"}
    ob = scene.gscore.result
    assert ob != edited and len(ob.data.vertices) == 71
    np.testing.assert_array_equal(positions(edited), kept)
    assert edited.hide_get() and edited.hide_render and stored_paths.RUN not in edited
    assert ob.visible_get() and not ob.hide_render


def test_a_result_in_edit_mode_is_a_sentence(scene: bpy.types.Scene, run: Path) -> None:
    """Oracle: the unchanged object, and no other; outside of Edit Mode it works, and adopts the
    settings with which the new splats were trained."""
    bpy.ops.gscore.import_result()
    ob = scene.gscore.result
    write_splats(run / "point_cloud.ply", splats(71), comments=(MIP_COMMENT,))
    bpy.context.view_layer.objects.active = ob
    bpy.ops.object.mode_set(mode="EDIT")
    assert "is in Edit Mode" in error_of(bpy.ops.gscore.import_result)
    bpy.ops.object.mode_set(mode="OBJECT")
    assert bpy.data.objects[:] == [ob] and len(ob.data.vertices) == 70
    assert ANTIALIAS not in ob
    assert bpy.ops.gscore.import_result() == {"FINISHED"}
    assert len(ob.data.vertices) == 71 and ob[ANTIALIAS]
