"""Edits replayed on new splats of the same capture. Oracle, unless stated otherwise: numpy on the
splats' positions and colors."""

from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from addon import attributes, stored_paths
from addon.core import Splats, write_splats
from addon.panels.edit import EditPanel
from addon.splats import objects, replay
from addon.splats.edit_operators import Grade, graded
from gscore.config_file import config_json
from gscore.presets import PRESETS
from tests.addon import splat_scenes as lab
from tests.addon.drawn import drawn
from tests.addon.trainings import positions


def two_walls(seed: int) -> Splats:
    """Two crossing walls; other seeds shift the splats by up to their distance."""
    rng = np.random.default_rng(seed)
    flat, upright = lab.wall(0.0, (0.6, 0.5, 0.4), along=61), lab.wall(0.0, (0.3, 0.5, 0.7))
    upright.means[:] = upright.means[:, [0, 2, 1]] + np.float32([0, 0, 1.2])
    means = np.concatenate([flat.means, upright.means])
    both = [np.concatenate([getattr(one, name) for one in (flat, upright)]) for name in FIELDS]
    splats = Splats(means=means, **dict(zip(FIELDS, both, strict=True)))
    splats.means[:] += rng.uniform(-0.02, 0.02, means.shape).astype(np.float32)
    splats.sh0[:] += rng.uniform(-0.1, 0.1, splats.sh0.shape).astype(np.float32)
    return splats


FIELDS = ("quats", "scales", "opacities", "sh0", "shN")


@pytest.fixture
def pair(scene: bpy.types.Scene) -> tuple[bpy.types.Object, bpy.types.Object]:
    """Splats of two trainings of one capture."""
    made = [lab.add(scene, two_walls(seed), f"training {seed}") for seed in (1, 2)]
    for ob in made:
        stored_paths.write(ob, stored_paths.SOURCE, Path("/captures/walls"))
    return tuple(made)


def activate(ob: bpy.types.Object, chosen: np.ndarray | None = None) -> None:
    """Make an object active and select some of its splats."""
    for other in bpy.context.view_layer.objects:
        other.select_set(other == ob)
    bpy.context.view_layer.objects.active = ob
    if chosen is not None:
        attributes.select(ob.data, chosen)


def test_erased_and_graded_volumes_stay(pair) -> None:
    """Nothing of the new upright wall's top is left, and the flat wall is as dense as before but
    for the border; its right half is graded by the same function, its left one is as trained."""
    old, new = pair
    before = positions(new)
    colors = attributes.column(new.data, attributes.BASE)
    activate(old, positions(old)[:, 2] > 0.5)
    assert bpy.ops.gscore.erase_splats() == {"FINISHED"}
    assert positions(old)[:, 2].max() < 0.6
    activate(old, positions(old)[:, 0] > 0)
    assert bpy.ops.gscore.grade_splats(gain=(1.5, 0.5, 1), only_selected=True) == {"FINISHED"}
    old.hide_set(True)
    activate(new, np.zeros(len(before), bool))
    assert bpy.ops.gscore.replay_edits() == {"FINISHED"}
    left = positions(new)
    assert left[:, 2].max() < 0.6
    kept = np.isin(before.view("V12"), left.view("V12"))[:, 0]
    assert kept[before[:, 2] < 0.4].all()
    base = attributes.column(new.data, attributes.BASE)
    wanted = graded(colors, Grade(gain=(1.5, 0.5, 1)))[kept]
    right, other = left[:, 0] > 0.1, left[:, 0] < -0.1
    np.testing.assert_array_equal(base[right], wanted[right])
    np.testing.assert_array_equal(base[other], colors[kept][other])
    assert len(replay.edits_of(new)) == 2


def test_replayed_once_and_beside_own_edits(pair) -> None:
    """The new splats keep the record of their own edits; the same edits do nothing again; a later
    one of the first splats is replayed alone."""
    old, new = pair
    activate(new, positions(new)[:, 0] > 1)
    assert bpy.ops.gscore.erase_splats() == {"FINISHED"}
    activate(old)
    assert bpy.ops.gscore.grade_splats(gain=(0.5, 0.5, 0.5)) == {"FINISHED"}
    activate(new)
    assert bpy.ops.gscore.replay_edits() == {"FINISHED"}
    assert ["erased" in one for one in replay.edits_of(new)] == [True, False]
    before = attributes.column(new.data, attributes.BASE)
    old.select_set(True)
    assert "already" in lab.error_of(bpy.ops.gscore.replay_edits)
    activate(old)
    assert bpy.ops.gscore.grade_splats(gain=(1, 1, 0.5)) == {"FINISHED"}
    activate(new)
    old.select_set(True)
    assert bpy.ops.gscore.replay_edits() == {"FINISHED"}
    wanted = graded(before, Grade(gain=(1, 1, 0.5)))
    np.testing.assert_array_equal(attributes.column(new.data, attributes.BASE), wanted)
    assert len(replay.edits_of(new)) == 3


def test_deleted_by_filters(pair, tmp_path) -> None:
    """A crop, by its place in the capture, though the box has moved since; through a saved file."""
    old, new = pair
    activate(old)
    assert bpy.ops.gscore.add_crop_box() == {"FINISHED"}
    box = old.gscore.crop_object
    box.location, box.scale = (0.5, 0, 0.5), (0.5, 2, 2)
    bpy.context.view_layer.update()
    assert bpy.ops.gscore.apply_filters() == {"FINISHED"}
    assert positions(old)[:, 0].min() >= 0
    box.location.x = 9
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    new = bpy.data.objects["training 2"]
    activate(new)
    before = positions(new)
    assert bpy.ops.gscore.replay_edits() == {"FINISHED"}
    np.testing.assert_array_equal(positions(new), before[(before[:, 0] >= 0) & (before[:, 0] <= 1)])


def test_which_edits(pair, scene) -> None:
    """None, one of the capture, and of two the selected one; another capture's only if selected;
    nothing changes if all would be erased."""
    old, new = pair
    activate(new)
    replay.note_replaced(new)
    assert not bpy.ops.gscore.replay_edits.poll()
    assert "Replay Edits" in drawn(EditPanel)
    activate(old)
    assert bpy.ops.gscore.grade_splats(gain=(0.5, 0.5, 0.5)) == {"FINISHED"}
    activate(new)
    assert bpy.ops.gscore.replay_edits.poll()
    third = lab.add(scene, two_walls(3), "third")
    stored_paths.write(third, stored_paths.SOURCE, Path("/captures/other"))
    activate(third)
    assert not bpy.ops.gscore.replay_edits.poll()
    old.select_set(True)
    assert bpy.ops.gscore.replay_edits.poll()
    replay.record_filters(old, replay.Filters(opacity_min=1.0))
    count = len(third.data.vertices)
    assert "would erase all" in lab.error_of(bpy.ops.gscore.replay_edits)
    assert len(third.data.vertices) == count
    third[replay.KEY] = "broken"
    assert replay.edits_of(third) == []


def test_erasing_none_is_refused(pair) -> None:
    """None or all selected: a sentence, nothing recorded."""
    old, _ = pair
    for chosen in (False, True):
        activate(old, np.full(len(old.data.vertices), chosen))
        assert "of them are" in lab.error_of(bpy.ops.gscore.erase_splats)
    assert replay.KEY not in old


def test_a_training_into_the_same_object(pair) -> None:
    """Splats that were only graded are replaced in place: their own grade is replayed, once."""
    old, new = pair
    bpy.data.objects.remove(new)
    activate(old)
    assert bpy.ops.gscore.grade_splats(gain=(0.5, 0.5, 0.5)) == {"FINISHED"}
    assert not bpy.ops.gscore.replay_edits.poll()
    objects.refresh(old, two_walls(5))
    replay.note_replaced(old)
    before = attributes.column(old.data, attributes.BASE)
    assert bpy.ops.gscore.replay_edits() == {"FINISHED"}
    wanted = graded(before, Grade(gain=(0.5, 0.5, 0.5)))
    np.testing.assert_array_equal(attributes.column(old.data, attributes.BASE), wanted)
    assert not bpy.ops.gscore.replay_edits.poll()


def test_restored_splats_stay_through_filters(scene, tmp_path) -> None:
    """What Delete Hidden Splats removed, and Restore brought back, is not removed again; splats
    outside of it are."""
    imported(tmp_path, two_walls(1))
    ob = bpy.context.object
    assert bpy.ops.gscore.add_crop_box() == {"FINISHED"}
    box = ob.gscore.crop_object
    box.location, box.scale = (-9, 0, 0), (9, 9, 9)
    bpy.context.view_layer.update()
    activate(ob)
    assert bpy.ops.gscore.apply_filters() == {"FINISHED"}
    box.location, box.scale = (0.75, 0, 0), (0.25, 9, 9)
    ob.gscore.crop_object = box
    bpy.context.view_layer.update()
    assert bpy.ops.gscore.restore_splats() == {"FINISHED"}
    assert positions(ob)[:, 0].max() > 0.9
    new = lab.add(scene, two_walls(2), "new")
    stored_paths.write(new, stored_paths.SOURCE, stored_paths.read(ob, stored_paths.SOURCE))
    activate(new)
    ob.select_set(True)
    before = positions(new)[:, 0]
    assert bpy.ops.gscore.replay_edits() == {"FINISHED"}
    left = positions(new)[:, 0]
    for low, high in ((-9, 0), (0.55, 0.95)):
        inside = [((one > low) & (one < high)).sum() for one in (before, left)]
        assert inside[0] == inside[1] > 0
    assert not ((left > 0.1) & (left < 0.35)).any()


def imported(folder: Path, splats: Splats) -> Path:
    """Import splats of a run; returns its folder."""
    run = folder / "run"
    run.mkdir()
    write_splats(run / "point_cloud.ply", splats)
    (run / "config.json").write_text(config_json(*PRESETS["preview"](folder)))
    assert bpy.ops.gscore.import_splats(filepath=str(run / "point_cloud.ply")) == {"FINISHED"}
    return run


def test_deleted_splats_are_restored(scene, tmp_path) -> None:
    """Oracle: the file's splats, inside the crop, with a graded neighbour as it was; a second time
    nothing; the recorded volume does not erase them again; of another training nothing."""
    splats = two_walls(1)
    run = imported(tmp_path, splats)
    ob = bpy.context.object
    activate(ob, positions(ob)[:, 0] > 0)
    assert bpy.ops.gscore.grade_splats(gain=(0.5, 1, 1), only_selected=True) == {"FINISHED"}
    activate(ob, positions(ob)[:, 2] > 0.5)
    assert bpy.ops.gscore.erase_splats() == {"FINISHED"}
    kept = attributes.column(ob.data, attributes.BASE)
    count = len(kept)
    assert bpy.ops.gscore.add_crop_box() == {"FINISHED"}
    box = ob.gscore.crop_object
    box.matrix_world = ob.matrix_world @ Matrix.Translation((1, 0, 1.5)) @ Matrix.Scale(1, 4)
    bpy.context.view_layer.update()
    activate(ob)
    assert bpy.ops.gscore.restore_splats() == {"FINISHED"}
    erased = splats.means[:, 2] > 0.5
    inside = erased & (splats.means[:, 0] > 0)
    assert len(ob.data.vertices) == count + inside.sum()
    rows = positions(ob)[count:]
    assert {tuple(row) for row in rows} == {tuple(row) for row in splats.means[inside]}
    np.testing.assert_array_equal(attributes.column(ob.data, attributes.BASE)[:count], kept)
    assert len([one for one in scene.objects if objects.is_splats(one)]) == 1
    assert bpy.ops.gscore.restore_splats() == {"FINISHED"}
    assert len(ob.data.vertices) == count + inside.sum()
    (erase,) = (one["erased"] for one in replay.edits_of(ob) if "erased" in one)
    volume = replay.Volume.read(erase)
    assert not volume.contains(rows).any()
    left = splats.means[erased & (splats.means[:, 0] < -0.2)]
    assert volume.contains(left).all()
    write_splats(run / "point_cloud.ply", two_walls(9))
    assert "trained again" in lab.error_of(bpy.ops.gscore.restore_splats)
