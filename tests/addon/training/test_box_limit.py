"""The object that limits a training; oracle: Blender's own matrices and the trainer's file."""

import json
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix, Vector

from addon.panels.train import TrainPanel
from addon.training import registry
from gscore.io.region_file import read_region
from tests.addon.calls import import_capture
from tests.addon.captures import STUDIO
from tests.addon.drawn import drawn
from tests.addon.fake_trainer import STARTED, finish
from tests.addon.trainings import until


@pytest.fixture(autouse=True)
def ends_at_once(play: Callable[..., Path]) -> None:
    """The fake trainer ends immediately."""
    play({"say": STARTED}, finish())


def around(scene: bpy.types.Scene, scale: tuple[float, float, float]) -> bpy.types.Object:
    """A rotated empty that limits the training."""
    ob = bpy.data.objects.new("subject", None)
    scene.collection.objects.link(ob)
    turn = Euler((0.2, 0.5, 0.1)).to_matrix().to_4x4()
    ob.matrix_world = Matrix.Translation((1, 2, 3)) @ turn @ Matrix.Diagonal((*scale, 1))
    scene.gscore.train_within = ob
    bpy.context.view_layer.update()
    return ob


def reported(tmp_path: Path) -> list[str]:
    """Command line of an ended training."""
    (job,) = registry.jobs()
    until(lambda: job.state.ended)
    return json.loads((tmp_path / "python" / "script.args").read_text())


def test_training_receives_the_box(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: points of the object by Blender's matrices, compared with the box in the file."""
    root = import_capture(bpy.context.scene, STUDIO).root
    root.matrix_world = Matrix.Rotation(0.4, 4, "X") @ Matrix.Scale(2.0, 4) @ root.matrix_world
    ob = around(studio, (0.5, 1.0, 2.0))
    assert bpy.ops.gscore.train() == {"FINISHED"}
    line = reported(tmp_path)
    box = read_region(line[line.index("--region") + 1])
    local = np.random.default_rng(0).normal(size=(500, 3))
    place = root.matrix_world.inverted() @ ob.matrix_world
    points = np.array([place @ Vector(point.tolist()) for point in local])
    there = np.column_stack([points, np.ones(500)]) @ np.linalg.inv(box).T
    np.testing.assert_allclose(there[:, :3], local, atol=1e-4)


def test_ineffective_boxes_are_refused(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: the errors; no training begins, and nothing is written."""
    ob = around(studio, (1, 1, 0))
    with pytest.raises(RuntimeError, match="press Import Cameras first"):
        bpy.ops.gscore.train()
    import_capture(bpy.context.scene, STUDIO)
    with pytest.raises(RuntimeError, match="subject has no volume"):
        bpy.ops.gscore.train()
    assert not registry.jobs() and not (tmp_path / "out").exists()
    studio.gscore.train_within = None
    assert ob.name in bpy.data.objects and bpy.ops.gscore.train() == {"FINISHED"}
    line = reported(tmp_path)
    assert "--region" not in line


def test_there_is_no_sky_within_an_object(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: the error in the panel and of the operator, with the panel's labels; no training
    begins, and nothing is written."""
    import_capture(bpy.context.scene, STUDIO)
    around(studio, (1, 1, 1))
    said = "inside of subject is trained, so there is no sky: set Sky to Automatic, or clear"
    assert said not in drawn(TrainPanel)
    studio.gscore.sky = "on"
    assert said in drawn(TrainPanel)
    with pytest.raises(RuntimeError, match=said):
        bpy.ops.gscore.train()
    assert not registry.jobs() and not (tmp_path / "out").exists()
    studio.gscore.train_within = None
    assert said not in drawn(TrainPanel) and bpy.ops.gscore.train() == {"FINISHED"}
    assert "--sky" in reported(tmp_path)


def test_masks_that_are_opacity_are_not_narrowed(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: the error in the panel and of the button, with the panel's labels."""
    around(studio, (1, 1, 1))
    studio.gscore.mask_mode = "composite"
    assert "set Mask Mode to Ignore Masked" in drawn(TrainPanel)
    with pytest.raises(RuntimeError, match="set Mask Mode to Ignore Masked"):
        bpy.ops.gscore.train()
    studio.gscore.mask_mode = "ignore"
    assert "Mask Mode" not in drawn(TrainPanel)


def test_it_belongs_to_its_capture(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: another capture has none, and choosing the first restores it."""
    ob = around(studio, (1, 1, 1))
    (tmp_path / "other" / "images").mkdir(parents=True)
    studio.gscore.capture_path = str(tmp_path / "other")
    assert studio.gscore.train_within is None
    studio.gscore.capture_path = str(STUDIO)
    assert studio.gscore.train_within == ob
