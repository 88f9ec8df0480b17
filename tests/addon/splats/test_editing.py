"""Selection, grading, separation and joining of splats. Oracles: numpy on the written attributes,
Blender's undo, and pictures of the rasterizer."""

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest

from addon import attributes
from addon.attributes import BASE, SCALE
from addon.core import Splats, join_splats, render, sh0_to_rgb
from addon.panels import edit as edit_panel
from addon.panels.edit import EditPanel
from addon.process.incremental_tasks import run_blocking
from addon.splats import edit_operators, filters, objects
from addon.splats import select_operators as choose_splats
from tests.addon import splat_scenes as lab
from tests.addon.calls import read_world
from tests.addon.drawn import drawn
from tools.measure.windowless import windowless

Make = Callable[..., Splats]
COUNT = 400
ROOT = Path(__file__).resolve().parents[3]
IN_THE_NEXT_FILE = """
import os
import sys
import bpy
import addon_utils
sys.path.insert(0, {root!r})
addon_utils.enable("addon")
from addon.region_training.mask_operators import use_brush
from tests.addon import splat_scenes as lab
for _ in range(2):
    bpy.ops.wm.read_homefile(use_empty=True)
    assert bpy.context.window.id_data in (None, bpy.context.window_manager)
    bpy.context.view_layer.objects.active = lab.add(bpy.context.scene, lab.blob(20))
    bpy.ops.gscore.select_by_opacity(low=0.0, high=1.0)
    bpy.ops.object.mode_set(mode="OBJECT")
    use_brush(bpy.context, hides=True)
print("whole")
sys.stdout.flush()
os._exit(0)  # bpy 4.2 crashes with any add-on at its end
"""
FIELDS = ("means", "quats", "scales", "opacities", "sh0", "shN")


@pytest.fixture
def ob(scene: bpy.types.Scene, make_splats: Make) -> bpy.types.Object:
    """Active, selected splats without selected vertices."""
    made = lab.add(scene, make_splats(COUNT))
    activate(made)
    choose(made, np.zeros(COUNT, bool))
    return made


def activate(ob: bpy.types.Object, *more: bpy.types.Object) -> None:
    """Select some objects; the first is active."""
    for other in bpy.context.selected_objects:
        other.select_set(False)
    for other in (ob, *more):
        other.select_set(True)
    bpy.context.view_layer.objects.active = ob


def choose(ob: bpy.types.Object, chosen: np.ndarray) -> None:
    """Select vertices."""
    ob.data.vertices.foreach_set("select", chosen)


def chosen(ob: bpy.types.Object) -> np.ndarray:
    """Selected vertices, after leaving Edit Mode, which selection operators enter."""
    assert ob.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    found = np.zeros(len(ob.data.vertices), bool)
    ob.data.vertices.foreach_get("select", found)
    return found


def color_of(ob: bpy.types.Object) -> np.ndarray:
    """[N, 3] sRGB values."""
    return np.maximum(sh0_to_rgb(attributes.column(ob.data, BASE)[:, :3]), 0)


def test_selections_are_those_of_vertices(scene: bpy.types.Scene) -> None:
    """Oracle: the vertices' own flags, with and without a selection attribute."""
    ob = lab.add(scene, lab.blob(50))
    wanted, found = np.arange(50) % 3 == 0, np.ones(50, bool)
    assert not attributes.selected(ob.data).any()
    for chosen in (wanted, ~wanted):
        attributes.select(ob.data, chosen)
        ob.data.vertices.foreach_get("select", found)
        assert np.array_equal(found, chosen)
        assert np.array_equal(attributes.selected(ob.data), chosen)


def test_by_opacity_and_size(ob: bpy.types.Object) -> None:
    """Oracle: the attributes; modes are set operations."""
    opacities = attributes.column(ob.data, BASE)[:, 3]
    bpy.ops.gscore.select_by_opacity(low=0.2, high=0.7)
    faint = (opacities >= 0.2) & (opacities <= 0.7)
    np.testing.assert_array_equal(chosen(ob), faint)
    large = attributes.column(ob.data, SCALE).max(axis=1) >= 0.05
    assert 0 < (faint & large).sum() < (faint | large).sum() < COUNT
    none = np.zeros(COUNT, bool)
    wanted = {"COMMON": faint & large, "ADD": large, "TAKE": none, "SET": large}
    for mode, mask in wanted.items():
        bpy.ops.gscore.select_by_size(low=0.05, high=0.0, mode=mode)
        np.testing.assert_array_equal(chosen(ob), mask, mode)


def test_the_context_owns_what_it_did(run_blender: Callable[..., str]) -> None:
    """Oracle: the scene of the window in the next file; with a removed scene, Blender 4.2 crashes
    sooner or later."""
    assert "whole" in run_blender(IN_THE_NEXT_FILE.format(root=str(ROOT)))


def test_by_color(ob: bpy.types.Object) -> None:
    """Oracle: distances from the mean of selected splats, or from the chosen colour."""
    with pytest.raises(RuntimeError, match="Select one or more splats"):
        bpy.ops.gscore.select_by_color()
    seeds = np.arange(COUNT) < 2
    choose(ob, seeds)
    colors = color_of(ob)
    bpy.ops.gscore.select_by_color(tolerance=0.3)
    apart = np.linalg.norm(colors - colors[seeds].mean(axis=0), axis=1)
    np.testing.assert_array_equal(chosen(ob), apart <= 0.3)
    bpy.ops.gscore.select_by_color(picked=True, color=(1, 0.5, 0.25), tolerance=0.4)
    wanted = np.linalg.norm(colors - [1, 0.5, 0.25], axis=1) <= 0.4
    assert 0 < wanted.sum() < COUNT
    np.testing.assert_array_equal(chosen(ob), wanted)


def test_in_the_crop(ob: bpy.types.Object) -> None:
    """Oracle: the mask of the filters, and a refusal without a crop object."""
    with pytest.raises(RuntimeError, match="Add Crop Box"):
        bpy.ops.gscore.select_in_crop()
    bpy.ops.gscore.add_crop_box()
    ob.gscore.crop_object.scale *= 0.5
    bpy.context.view_layer.update()
    for shape in ("BOX", "SPHERE"):
        ob.gscore.crop_shape = shape
        bpy.ops.gscore.select_in_crop()
        inside = chosen(ob)
        np.testing.assert_array_equal(inside, filters.visible_mask(ob))
        assert 0 < inside.sum() < COUNT


def test_flood_and_floaters(scene: bpy.types.Scene) -> None:
    """Oracle: the construction: two balls, a few splats far from both, and one of the second ball
    in a colour that no other has."""
    balls = [lab.blob(300, size=1.0), lab.blob(300, center=(9, 0, 0), size=1.0)]
    splats = join_splats([*balls, lab.blob(5, center=(50, 0, 0), size=0.1)])
    splats.sh0[300:600], splats.sh0[400] = 0, 5
    ob = lab.add(scene, splats)
    activate(ob)
    which = np.repeat([0, 1, 2], [300, 300, 5])
    bpy.ops.gscore.select_floaters(few=50, gap=0.5)
    np.testing.assert_array_equal(chosen(ob), which == 2)
    choose(ob, np.arange(605) == 303)
    bpy.ops.gscore.select_flood(gap=1.0)
    np.testing.assert_array_equal(chosen(ob), which == 1)
    choose(ob, np.arange(605) == 303)
    bpy.ops.gscore.select_flood(gap=1.0, tolerance=0.2)
    np.testing.assert_array_equal(chosen(ob), (which == 1) & (np.arange(605) != 400))


def test_grade(ob: bpy.types.Object) -> None:
    """Oracle: the formulas in numpy; SH, opacity and unselected splats to the bit; undo."""
    before, name = objects.read(ob), ob.name
    some = np.arange(COUNT) % 3 == 0
    choose(ob, some)
    bpy.ops.ed.undo_push(message="before")
    how = {"lift": (0.1, 0, 0), "gamma": (1, 2, 1), "gain": (1, 1, 0.5), "saturation": 0.7}
    bpy.ops.gscore.grade_splats(**how, only_selected=True)
    after = objects.read(ob)
    for field in ("means", "quats", "scales", "opacities", "shN"):
        np.testing.assert_array_equal(getattr(after, field), getattr(before, field))
    np.testing.assert_array_equal(after.sh0[~some], before.sh0[~some])
    want = sh0_to_rgb(before.sh0[some, 0].astype(np.float64))
    want[:, 0] = 0.1 + 0.9 * want[:, 0]
    want[:, 1] = np.sign(want[:, 1]) * np.sqrt(np.abs(want[:, 1]))
    want[:, 2] *= 0.5
    grey = want @ [[0.2126], [0.7152], [0.0722]]
    want = grey + 0.7 * (want - grey)
    np.testing.assert_allclose(sh0_to_rgb(after.sh0[some, 0]), want, atol=2e-6)
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    again = objects.read(bpy.data.objects[name])
    np.testing.assert_array_equal(again.sh0, before.sh0)


@pytest.mark.parametrize("mode", ["OBJECT", "EDIT"])
@pytest.mark.parametrize("share", [0, 3])
def test_the_button_grades_what_is_selected(ob: bpy.types.Object, mode: str, share: int) -> None:
    """Oracle: the changed rows: selected ones, or all if none is selected; a script grades all by
    default, and so does the button without Only Selected."""
    sh0 = objects.read(ob).sh0
    some = np.arange(COUNT) % share == 0 if share else np.zeros(COUNT, bool)
    choose(ob, some)
    bpy.ops.object.mode_set(mode=mode)

    def changed() -> np.ndarray:
        nonlocal sh0
        bpy.ops.object.mode_set(mode="OBJECT")
        before, sh0 = sh0, objects.read(ob).sh0
        bpy.ops.object.mode_set(mode=mode)
        return (sh0 != before).any(axis=(1, 2))

    run_blocking(windowless("grade_splats", saturation=0.5).steps(bpy.context))
    np.testing.assert_array_equal(changed(), some if share else True)
    run_blocking(
        windowless("grade_splats", gain=(0.5,) * 3, only_selected=False).steps(bpy.context)
    )
    assert changed().all()
    bpy.ops.gscore.grade_splats(gain=(0.5,) * 3)
    assert changed().all()


def test_many_are_graded_and_compared_as_few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the same numbers when all splats are processed in one block."""
    base = np.random.default_rng(0).normal(size=(1000, 4)).astype(np.float32)
    grade = edit_operators.Grade(lift=(0.1, 0, -0.1), gamma=(1.2, 1, 0.9), saturation=0.5)
    color = np.array([0.6, 0.5, 0.5])
    wanted = edit_operators.graded(base, grade), choose_splats.similar_color(base, color, 0.3)
    assert 0 < wanted[1].sum() < 1000
    for module in (edit_operators, choose_splats):
        monkeypatch.setattr(module, "_BLOCK", 64)
    np.testing.assert_allclose(edit_operators.graded(base, grade), wanted[0], rtol=1e-6)
    np.testing.assert_array_equal(choose_splats.similar_color(base, color, 0.3), wanted[1])


def test_no_grade_changes_nothing(ob: bpy.types.Object) -> None:
    """Oracle: the attribute to the bit."""
    before = attributes.column(ob.data, BASE)
    bpy.ops.gscore.grade_splats()
    np.testing.assert_array_equal(attributes.column(ob.data, BASE), before)


def test_separate_keeps_everything(ob: bpy.types.Object) -> None:
    """Oracle: rows of the earlier data, including a user's attribute; from Edit Mode too."""
    own = ob.data.attributes.new("mine", "INT", "POINT")
    own.data.foreach_set("value", np.arange(COUNT, dtype=np.int32))
    ob.gscore.size_max, ob.gscore.display = 0.7, "ELLIPSOIDS"
    before, some = objects.read(ob), np.arange(COUNT) < 90
    with pytest.raises(RuntimeError, match="none of them"):
        bpy.ops.gscore.separate_splats()
    choose(ob, some)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.gscore.separate_splats()
    assert ob.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    part = bpy.data.objects[f"{ob.name} part"]
    for one, mask in ((ob, ~some), (part, some)):
        got = objects.read(one)
        for field in FIELDS:
            np.testing.assert_array_equal(getattr(got, field), getattr(before, field)[mask])
        values = np.empty(mask.sum(), np.int32)
        one.data.attributes["mine"].data.foreach_get("value", values)
        np.testing.assert_array_equal(values, np.flatnonzero(mask))
    assert (part.gscore.size_max, part.gscore.display) == (ob.gscore.size_max, "ELLIPSOIDS")


def test_join_shows_what_was_seen(scene: bpy.types.Scene) -> None:
    """Oracle: the rasterizer's picture of both in the world before, rotated and scaled, with
    different SH degrees. An attribute of only one of them is 0 in the other. Data of the first stay
    equal to the bit, which would not survive exponentials and logarithms."""
    one, other = lab.add(scene, lab.blob(200)), lab.add(scene, lab.wall(0.4, (0.9, 0.2, 0.1)))
    one.location, one.scale = (0.2, 0, 0), (2, 2, 2)
    other.rotation_euler, other.scale = (0.5, 0.2, 1), (0.5, 0.5, 0.5)
    mine = other.data.attributes.new("mine", "FLOAT", "POINT")
    mine.data.foreach_set("value", np.full(len(other.data.vertices), 7, np.float32))
    bpy.context.view_layer.update()
    own = attributes.column(one.data, BASE), attributes.column(one.data, SCALE)
    activate(one)
    with pytest.raises(RuntimeError, match="two or more"):
        bpy.ops.gscore.join_splats()
    want = picture(join_splats([read_world(o) for o in (one, other)]))
    activate(one, other)
    bpy.ops.gscore.join_splats()
    bpy.context.view_layer.update()
    assert [o for o in scene.objects if objects.is_splats(o)] == [one]
    assert np.ptp(want) > 0.5
    np.testing.assert_allclose(picture(read_world(one)), want, atol=1e-3)
    values = np.empty(len(one.data.vertices), np.float32)
    one.data.attributes["mine"].data.foreach_get("value", values)
    np.testing.assert_array_equal(values, np.repeat([0, 7], [200, 41 * 41]))
    np.testing.assert_array_equal(attributes.column(one.data, BASE)[:200], own[0])
    np.testing.assert_array_equal(attributes.column(one.data, SCALE)[:200], own[1])


def picture(splats: Splats) -> np.ndarray:
    """[64, 96, 3] from above."""
    viewmat = np.diag([1.0, -1, -1, 1])
    viewmat[2, 3] = 4
    return render(splats, np.array([[90.0, 0, 48], [0, 90, 32], [0, 0, 1]]), viewmat, 96, 64).rgb


def test_attributes_of_two_types_are_not_joined(scene: bpy.types.Scene) -> None:
    """Oracle: an error that names the attribute, and the counts."""
    one, other = (lab.add(scene, lab.blob(20), name) for name in ("one", "other"))
    one.data.attributes.new("mine", "FLOAT", "POINT")
    other.data.attributes.new("mine", "INT", "POINT")
    activate(one, other)
    with pytest.raises(RuntimeError, match="mine has another type"):
        bpy.ops.gscore.join_splats()
    assert len(one.data.vertices) == len(other.data.vertices) == 20


def test_a_refused_join_changes_nothing(scene: bpy.types.Scene) -> None:
    """Oracle: counts, and an error that names the object."""
    one, other = (lab.add(scene, lab.blob(20), name) for name in ("one", "other"))
    other.scale = (1, 2, 3)
    activate(one, other)
    with pytest.raises(RuntimeError, match="other cannot be transformed"):
        bpy.ops.gscore.join_splats()
    assert len(one.data.vertices) == len(other.data.vertices) == 20


def test_the_panel_leads_to_a_display_that_follows(
    ob: bpy.types.Object, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: live splats follow edits of small objects; other displays those of large ones."""
    ob.gscore.display = "SPLATS"
    bpy.ops.gscore.select_by_opacity()
    assert "Show Edits" not in drawn(EditPanel)
    monkeypatch.setattr(edit_panel, "EDITED_AT_ONCE", len(ob.data.vertices) - 1)
    assert "(Show Edits Live)" in drawn(EditPanel)
    ob.gscore.display = "POINTS"
    assert "Show Edits" not in drawn(EditPanel)
    bpy.ops.object.mode_set(mode="OBJECT")
