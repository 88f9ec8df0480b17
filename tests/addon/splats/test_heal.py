"""Heal, clone, their removal and replay. Oracle: a wall with a hole, and numpy on its splats."""

from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix, Vector

from addon import attributes, stored_paths
from addon.core import Splats, transform_splats
from addon.panels.edit import EditPanel
from addon.splats import lag, objects, replay
from tests.addon import splat_scenes as lab
from tests.addon.drawn import drawn
from tests.addon.trainings import positions


def wall(seed: int = 0) -> Splats:
    """A wall across z; other seeds shift its splats."""
    splats = lab.wall(0.0, (0.6, 0.5, 0.4), along=61)
    splats.means[:, :2] += np.random.default_rng(seed).uniform(-0.01, 0.01, (61 * 61, 2))
    return splats


@pytest.fixture
def ob(scene: bpy.types.Scene) -> bpy.types.Object:
    """Active splats of a wall, moved and turned, with all of a disc of radius 0.3 selected."""
    made = lab.add(scene, wall(), "wall")
    made.location, made.rotation_euler, made.scale = (1, 2, 3), (0.4, 0, 0.3), (2, 2, 2)
    bpy.context.view_layer.update()
    activate(made, np.linalg.norm(positions(made), axis=1) < 0.3)
    return made


def activate(ob: bpy.types.Object, chosen: np.ndarray | None = None) -> None:
    """Make an object the only selected one, and select some of its splats."""
    for other in bpy.context.view_layer.objects:
        other.select_set(other == ob)
    bpy.context.view_layer.objects.active = ob
    if chosen is not None:
        attributes.select(ob.data, chosen)


def marks(ob: bpy.types.Object) -> np.ndarray:
    """Splats that were added, [N] bool."""
    found = np.zeros(len(ob.data.vertices), bool)
    ob.data.attributes[attributes.HEALED].data.foreach_get("value", found)
    return found


def test_what_was_erased_is_filled_and_removed_again(ob) -> None:
    """New splats are in the disc, on the wall and selected; the others are the same bits, also
    after Remove Healing, which forgets the record."""
    assert bpy.ops.gscore.erase_splats() == {"FINISHED"}
    left = objects.read(ob)
    assert "Remove Healing" not in drawn(EditPanel)
    assert bpy.ops.gscore.heal_splats() == {"FINISHED"}
    assert "Remove Healing" in drawn(EditPanel)
    added, now = marks(ob), objects.read(ob)
    assert added.sum() > 200 and not added[: len(left)].any() and added[len(left) :].all()
    for name in ("means", "quats", "scales", "opacities", "sh0", "shN"):
        np.testing.assert_array_equal(getattr(now, name)[: len(left)], getattr(left, name))
    assert np.abs(now.means[added][:, 2]).max() < 0.02
    assert np.linalg.norm(now.means[added], axis=1).max() < 0.4
    np.testing.assert_allclose(now.sh0[added], left.sh0[: added.sum()], atol=0.05)
    np.testing.assert_array_equal(attributes.selected(ob.data), added)
    assert ["healed" in one for one in replay.edits_of(ob)] == [False, True]
    assert bpy.ops.gscore.remove_healing() == {"FINISHED"}
    np.testing.assert_array_equal(objects.read(ob).means, left.means)
    assert attributes.HEALED not in ob.data.attributes
    assert ["healed" in one for one in replay.edits_of(ob)] == [False]
    assert not bpy.ops.gscore.remove_healing.poll()


def test_undo_of_heal(ob) -> None:
    """Oracle: the splats, marks, selection and record of edits before; Heal then adds the same
    splats again."""
    assert bpy.ops.gscore.erase_splats() == {"FINISHED"}
    left, edits = objects.read(ob), replay.edits_of(ob)
    bpy.ops.ed.undo_push(message="erased")
    assert bpy.ops.gscore.heal_splats() == {"FINISHED"}
    healed = positions(ob)
    bpy.ops.ed.undo_push(message="healed")
    bpy.ops.ed.undo()
    ob = bpy.data.objects["wall"]
    for name in ("means", "quats", "scales", "opacities", "sh0", "shN"):
        np.testing.assert_array_equal(getattr(objects.read(ob), name), getattr(left, name))
    assert attributes.HEALED not in ob.data.attributes and replay.edits_of(ob) == edits
    assert not attributes.selected(ob.data).any() and "Remove Healing" not in drawn(EditPanel)
    assert len(bpy.data.objects) == 1
    activate(ob)
    assert bpy.ops.gscore.heal_splats() == {"FINISHED"}
    np.testing.assert_array_equal(positions(bpy.data.objects["wall"]), healed)


def test_healing_can_be_separated_and_removed(ob) -> None:
    """What was separated is deleted as an object; what it was taken from forgets the record."""
    assert bpy.ops.gscore.erase_splats() == {"FINISHED"}
    left = objects.read(ob)
    assert bpy.ops.gscore.heal_splats() == {"FINISHED"}
    assert bpy.ops.gscore.separate_splats() == {"FINISHED"}
    part = next(one for one in bpy.context.scene.objects if one.name == "wall part")
    assert marks(part).all()
    activate(part)
    with pytest.raises(RuntimeError, match="has only added splats: delete the object"):
        bpy.ops.gscore.remove_healing()
    activate(ob)
    mesh = ob.data.session_uid
    assert bpy.ops.gscore.remove_healing() == {"FINISHED"}
    assert ob.data.session_uid == mesh  # nothing was written
    np.testing.assert_array_equal(objects.read(ob).means, left.means)
    assert attributes.HEALED not in ob.data.attributes
    assert ["healed" in one for one in replay.edits_of(ob)] == [False]


def test_what_fills_a_hole_can_be_relit(ob) -> None:
    """With the normal of the wall and the captured light of the place, of which a tenth of the
    splats, such as restored ones, know nothing."""
    count = len(ob.data.vertices)
    known = np.arange(count) % 10 > 0
    light = np.outer(0.5 + 0.2 * positions(ob)[:, 0], [1, 0.8, 0.6]) * known[:, None]
    normals = np.outer(known, [0, 0, 1])
    for name, values in ((attributes.NORMAL, normals), (attributes.CAPTURED, light)):
        attributes.declare(ob.data, name, "FLOAT_VECTOR")
        values = np.ascontiguousarray(values, np.float32).ravel()
        attributes.fill(ob.data, name, "FLOAT_VECTOR", values)
    assert bpy.ops.gscore.erase_splats() == {"FINISHED"}
    assert bpy.ops.gscore.heal_splats() == {"FINISHED"}
    added = marks(ob)
    found = [attributes.column(ob.data, n)[added] for n in (attributes.NORMAL, attributes.CAPTURED)]
    np.testing.assert_allclose(found[0], np.tile([0, 0, 1], (len(found[0]), 1)), atol=1e-5)
    wanted = np.outer(0.5 + 0.2 * positions(ob)[added, 0], [1, 0.8, 0.6])
    np.testing.assert_allclose(found[1], wanted, atol=0.01)


def test_the_hole_in_a_crop(ob) -> None:
    """An ellipsoid around a part of the disc: only that is filled, in the object's own space; in
    Edit Mode too; inverted and flat crops are refused."""
    assert bpy.ops.gscore.erase_splats() == {"FINISHED"}
    left = len(ob.data.vertices)
    assert bpy.ops.gscore.add_crop_box() == {"FINISHED"}
    box = ob.gscore.crop_object
    box.matrix_world = ob.matrix_world @ Matrix.Translation((0.3, 0, 0)) @ Matrix.Scale(0.25, 4)
    bpy.context.view_layer.update()
    activate(ob)
    ob.gscore.crop_shape = "SPHERE"
    ob.gscore.crop_invert = True
    assert "turn Invert" in lab.error_of(bpy.ops.gscore.heal_splats)
    ob.gscore.crop_invert = False
    bpy.ops.object.mode_set(mode="EDIT")
    assert bpy.ops.gscore.heal_splats() == {"FINISHED"}
    assert ob.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    new = positions(ob)[left:]
    assert len(new) > 20
    assert np.linalg.norm(new - [0.3, 0, 0], axis=1).max() < 0.32
    assert new[:, 0].max() < 0.37 and new[:, 0].min() > 0


def test_refusals(ob) -> None:
    """A sentence; nothing is changed."""
    count = len(ob.data.vertices)
    assert "Where is the hole of wall?" in lab.error_of(bpy.ops.gscore.heal_splats)
    assert bpy.ops.gscore.add_crop_box() == {"FINISHED"}
    activate(ob, np.zeros(count, bool))
    assert "There is no hole" in lab.error_of(bpy.ops.gscore.heal_splats)
    ob.gscore.crop_object.location.z += 50
    bpy.context.view_layer.update()
    assert "around the hole" in lab.error_of(bpy.ops.gscore.heal_splats)
    assert "select the splats to clone" in lab.error_of(bpy.ops.gscore.clone_splats)
    assert len(ob.data.vertices) == count and attributes.HEALED not in ob.data.attributes
    assert replay.KEY not in ob


def test_clones_at_the_cursor(ob, scene) -> None:
    """Copies are those of `transform_splats` in the world, with their middle at the cursor; other
    attributes follow; the first ones stay the same bits; undo."""
    weight = ob.data.attributes.new("weight", "FLOAT", "POINT")
    weight.data.foreach_set("value", np.arange(len(ob.data.vertices), dtype=np.float32))
    chosen = attributes.selected(ob.data)
    before, count = objects.read(ob), len(chosen)
    world = np.array(ob.matrix_world, np.float64)
    scene.cursor.location = (3, -1, 2)
    turn = Euler((0.5, 0.2, -1.0))
    bpy.ops.ed.undo_push(message="start")
    assert bpy.ops.gscore.clone_splats(rotation=turn, scale=0.5) == {"FINISHED"}
    ob = bpy.data.objects["wall"]
    now = objects.read(ob)
    for name in ("means", "quats", "scales", "opacities", "sh0", "shN"):
        np.testing.assert_array_equal(getattr(now, name)[:count], getattr(before, name))
    copies = now.subset(slice(count, None))
    middle = Vector(np.median(copies.means, axis=0).tolist())
    np.testing.assert_allclose(ob.matrix_world @ middle, (3, -1, 2), atol=0.05)
    linear = 0.5 * np.array(turn.to_matrix(), np.float64)
    source = transform_splats(before.subset(chosen), world)
    there = np.eye(4)
    there[:3, :3] = linear
    center = world[:3, :3] @ np.median(before.means[chosen], axis=0) + world[:3, 3]
    there[:3, 3] = np.array([3, -1, 2]) - linear @ center
    wanted = transform_splats(source, there)
    placed = transform_splats(copies, world)
    np.testing.assert_allclose(placed.means, wanted.means, atol=1e-4)
    np.testing.assert_allclose(placed.scales, wanted.scales, atol=1e-4)
    np.testing.assert_allclose(placed.shN, wanted.shN, atol=1e-4)
    agree = np.abs((placed.quats * wanted.quats).sum(axis=1))
    lengths = np.linalg.norm(placed.quats, axis=1) * np.linalg.norm(wanted.quats, axis=1)
    np.testing.assert_allclose(agree, lengths, rtol=1e-5)
    values = np.empty(len(ob.data.vertices), np.float32)
    ob.data.attributes["weight"].data.foreach_get("value", values)
    np.testing.assert_array_equal(values[count:], np.flatnonzero(chosen))
    np.testing.assert_array_equal(attributes.selected(ob.data), marks(ob))
    bpy.ops.ed.undo_push(message="cloned")
    bpy.ops.ed.undo()
    assert len(bpy.data.objects["wall"].data.vertices) == count


def test_replayed_on_new_splats(ob, scene) -> None:
    """The new wall is erased, filled and has the copies, in this order; nothing is erased from it
    but the disc."""
    source = Path("/captures/wall")
    stored_paths.write(ob, stored_paths.SOURCE, source)
    activate(ob)
    assert bpy.ops.gscore.erase_splats() == {"FINISHED"}
    assert bpy.ops.gscore.heal_splats() == {"FINISHED"}
    added = int(marks(ob).sum())
    local = ob.matrix_world @ Vector((0, 0, 1))
    assert bpy.ops.gscore.clone_splats(place=local) == {"FINISHED"}
    new = lab.add(scene, wall(5), "new")
    stored_paths.write(new, stored_paths.SOURCE, source)
    before = positions(new)
    activate(new)
    assert bpy.ops.gscore.replay_edits() == {"FINISHED"}
    now, chosen = positions(new), marks(new)
    own = now[~chosen]
    assert np.isin(own.view("V12"), before.view("V12")).all()
    assert 0.8 < np.linalg.norm(own, axis=1).min() / 0.3 < 1.3
    flat = chosen & (np.abs(now[:, 2]) < 0.1)
    above = chosen & (np.abs(now[:, 2] - 1) < 0.1)
    assert (flat | above)[chosen].all()
    assert 0.8 < flat.sum() / added < 1.25 and 0.8 < above.sum() / added < 1.25
    assert len(replay.edits_of(new)) == 3


def test_a_hole_and_a_source_that_new_splats_lack(ob, scene) -> None:
    """Replayed without the filling and the copies; not on splats whose shapes lag behind, which
    would be copied wrongly."""
    stored_paths.write(ob, stored_paths.SOURCE, Path("/captures/wall"))
    replay.record_healed(ob, np.eye(4), sphere=True)
    beyond = replay.volume_of(np.full((1, 3), 9.0), np.ones(1, bool), np.full((1, 3), 0.01))
    replay.record_cloned(ob, np.eye(4), beyond)
    new = lab.add(scene, wall(5), "new")
    stored_paths.write(new, stored_paths.SOURCE, Path("/captures/wall"))
    count = len(new.data.vertices)
    activate(new)
    new.data.transform(Matrix.Rotation(0.5, 4, "Z"))
    assert lag.follow(new.data)
    assert "press Update Shapes" in lab.error_of(bpy.ops.gscore.replay_edits)
    new.data.transform(Matrix.Rotation(-0.5, 4, "Z"))
    assert lag.follow(new.data)
    assert bpy.ops.gscore.replay_edits() == {"FINISHED"}
    assert len(new.data.vertices) == count and attributes.HEALED not in new.data.attributes
    assert len(replay.edits_of(new)) == 2


def test_the_last_hole_of_which_anything_is_left(ob) -> None:
    """Not that of an Erase whose splats were all restored, as `replay.sparing` records it."""
    assert bpy.ops.gscore.erase_splats() == {"FINISHED"}
    (first,) = replay.edits_of(ob)
    activate(ob, np.linalg.norm(positions(ob) - [0.7, 0, 0], axis=1) < 0.2)
    assert bpy.ops.gscore.erase_splats() == {"FINISHED"}
    volume = replay.Volume.read(replay.edits_of(ob)[1]["erased"])
    restored = {"erased": replay.Volume(side=volume.side, keys=volume.keys[:0]).stored()}
    replay.store(ob, [restored])
    assert "Where is the hole of wall?" in lab.error_of(bpy.ops.gscore.heal_splats)
    replay.store(ob, [first, restored])
    assert bpy.ops.gscore.heal_splats() == {"FINISHED"}
    assert np.linalg.norm(positions(ob)[marks(ob)], axis=1).max() < 0.4
