"""Detection, report and repair of shapes after Blender's Apply, and report of its Join.

Oracle of most: the engine's picture before Apply.
"""

from pathlib import Path

import bmesh
import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix

from addon import attributes
from addon.panels import result
from addon.render import unsupported_settings
from addon.splats import lag, objects
from tests.addon import splat_scenes as lab
from tests.addon.drawn import Layout
from tests.addon.points import keep as keep_points

BUTTON, KEEP = "(Update Shapes and Colors)", "(Keep as It Is)"


@pytest.fixture
def ob(scene: bpy.types.Scene) -> bpy.types.Object:
    """Active, rotated splats in front of a camera."""
    lab.prepare(scene)
    made = lab.add(scene, lab.blob())
    place(made, (0.3, -0.2, 0.4), (0.4, 1.1, -2.0), 1.5)
    activate(made)
    return made


def place(
    ob: bpy.types.Object,
    location: tuple[float, ...],
    turn: tuple[float, ...],
    scale: float | tuple[float, ...],
) -> None:
    """Move an object."""
    ob.location, ob.rotation_euler = location, turn
    ob.scale = scale if isinstance(scale, tuple) else (scale,) * 3


def activate(ob: bpy.types.Object, *more: bpy.types.Object) -> None:
    """Select some objects; the first is active."""
    bpy.context.view_layer.update()
    for other in bpy.context.selected_objects:
        other.select_set(False)
    for other in (ob, *more):
        other.select_set(True)
    bpy.context.view_layer.objects.active = ob


def apply(**which: bool) -> None:
    """Blender's own Apply."""
    wanted = {"location": True, "rotation": True, "scale": True} | which
    assert bpy.ops.object.transform_apply(**wanted) == {"FINISHED"}


def reported() -> str:
    """Warnings of a render about shapes."""
    context = bpy.context
    shown = unsupported_settings.Shown(
        scene=context.scene, layer=context.view_layer, camera=context.scene.camera
    )
    return " ".join(unsupported_settings.without_effect(shown))


def is_said(button: str = BUTTON) -> bool:
    """Whether panel and render report the same."""
    layout = Layout()
    result.draw_outdated(layout, bpy.context)
    panel = button in layout.text
    assert panel == ({BUTTON: BUTTON[1:-1], KEEP: "Blender's Join added"}[button] in reported())
    return panel


def step(name: str) -> None:
    """An undo step."""
    bpy.ops.ed.undo_push(message=name)


@pytest.mark.parametrize(
    "which",
    [{}, {"location": False, "scale": False}, {"rotation": False}, {"location": False}],
    ids=["all", "rotation", "scale", "both"],
)
@pytest.mark.parametrize("scale", [1.5, -0.7])
def test_apply_is_mended(
    ob: bpy.types.Object, tmp_path: Path, scale: float, which: dict[str, bool]
) -> None:
    """Oracle: the picture before Apply, which changed it; positions are those made by Apply, to the
    bit. The object has a rotated parent."""
    root = bpy.data.objects.new("root", None)
    bpy.context.scene.collection.objects.link(root)
    place(root, (0.1, 0, 0), (0.3, 0, 0.5), 0.9)
    ob.parent, ob.scale = root, (scale,) * 3
    activate(ob)
    before = lab.render_exr(tmp_path, "before")
    assert not is_said()
    apply(**which)
    assert is_said()
    places = attributes.column(ob.data, attributes.POSITION)
    assert np.abs(lab.render_exr(tmp_path, "wrong") - before).max() > 0.1
    bpy.ops.gscore.mend_splats()
    bpy.context.view_layer.update()
    np.testing.assert_allclose(lab.render_exr(tmp_path, "mended"), before, atol=2e-3)
    np.testing.assert_array_equal(attributes.column(ob.data, attributes.POSITION), places)
    assert not is_said()
    assert not bpy.ops.gscore.mend_splats.poll()


def test_applied_twice(ob: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the earlier picture, after two applied rotations with splats deleted in between and
    afterwards; applied and rotated back, nothing is left to repair."""
    ob.data.vertices.foreach_set("select", np.zeros(400, bool))
    apply()
    ob.rotation_euler = (0, 0.7, 0.1)
    keep = np.arange(400) % 7 != 0
    keep_points(ob.data, keep)
    ob.data.update()
    bpy.context.view_layer.update()
    apply(location=False)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="DESELECT")
    bpy.ops.object.mode_set(mode="OBJECT")
    flags = np.arange(keep.sum()) % 5 == 0
    ob.data.vertices.foreach_set("select", flags)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.delete(type="VERT")
    bpy.ops.object.mode_set(mode="OBJECT")
    assert is_said()
    bpy.ops.gscore.mend_splats()
    turn = Euler((0, 0.7, 0.1)).to_matrix().to_4x4()
    first = Matrix.LocRotScale((0.3, -0.2, 0.4), Euler((0.4, 1.1, -2.0)), (1.5,) * 3)
    want = lab.blob().subset(keep).subset(~flags)
    want = objects.moved(want, np.array(turn @ first), "want")
    got = lab.render_exr(tmp_path, "got")
    bpy.data.objects.remove(ob)
    lab.add(bpy.context.scene, want)
    np.testing.assert_allclose(lab.render_exr(tmp_path, "want"), got, atol=2e-3)


def test_no_warning_without_defect(ob: bpy.types.Object) -> None:
    """Oracle: pictures need no repair after moves, the add-on's Apply, also of an inversion, edits
    of single points, and a rotation that was applied and reverted."""
    apply(rotation=False, scale=False)
    assert not is_said()
    for scale in (1.5, -1.0):
        place(ob, (0, 1, 0), (0, 0, 0) if scale < 0 else (0.5, 0.2, 0), scale)
        bpy.context.view_layer.update()
        bpy.ops.gscore.apply_splat_transform()
        bpy.context.view_layer.update()
        assert not is_said(), scale
    places = attributes.column(ob.data, attributes.POSITION)
    places[::3] += 0.5
    attributes.fill(ob.data, attributes.POSITION, "FLOAT_VECTOR", places.ravel())
    ob.data.update()
    bpy.context.view_layer.update()
    assert not is_said()
    ob.rotation_euler = (0, 0, 1)
    apply()
    assert is_said()
    ob.rotation_euler = (0, 0, -1)
    apply()
    assert not is_said()


def test_points_turned_in_edit_mode(ob: bpy.types.Object) -> None:
    """Oracle: their own rotation, detected when Edit Mode ends."""
    turn = Matrix.Rotation(0.8, 4, "X")
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.context.view_layer.update()
    edited = bmesh.from_edit_mesh(ob.data)
    bmesh.ops.transform(edited, matrix=turn, verts=edited.verts)
    bmesh.update_edit_mesh(ob.data)
    bpy.ops.object.mode_set(mode="OBJECT")
    assert is_said()
    np.testing.assert_allclose(lag.of(ob.data), np.array(turn)[:3, :3], atol=1e-6)


def test_undo_takes_the_mark_along(ob: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the picture shows which states are wrong; each path through undo and redo has the
    same marks, and repairs after them are right."""
    name, before = ob.name, lab.render_exr(tmp_path, "before")
    step("start")
    apply()
    step("applied")
    bpy.context.scene.frame_end = 99
    step("something else")
    bpy.ops.gscore.mend_splats()
    step("mended")
    marks = [bool(lag.problem(bpy.data.objects[name].data))]
    for move in "uuururrruuurr":
        (bpy.ops.ed.undo if move == "u" else bpy.ops.ed.redo)()
        bpy.context.view_layer.update()
        picture = lab.render_exr(tmp_path, "now")
        wrong = np.abs(picture - before).max() > 0.1
        marks.append(bool(lag.problem(bpy.data.objects[name].data)))
        assert marks[-1] == wrong, f"{move} {marks}"
    assert True in marks and False in marks
    if not marks[-1]:
        bpy.ops.ed.undo()
    activate(bpy.data.objects[name])
    bpy.ops.gscore.mend_splats()
    bpy.context.view_layer.update()
    np.testing.assert_allclose(lab.render_exr(tmp_path, "mended"), before, atol=2e-3)


def test_a_file_keeps_the_mark(ob: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the saved and opened file; a copy of the mesh has it too."""
    apply()
    copy = ob.copy()
    copy.data = ob.data.copy()
    assert lag.problem(copy.data)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert is_said()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    np.testing.assert_allclose(
        lag.of(bpy.context.object.data) / 1.5 @ np.ones(3) @ np.ones(3),
        np.array(Euler((0.4, 1.1, -2.0)).to_matrix()).sum(),
        atol=1e-5,
    )


def test_linked_splats_are_not_mended(ob: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the error of all operators on linked data, and unchanged positions and shapes."""
    apply()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "a.blend"), link=True) as (_, wanted):
        wanted.objects = ["splats"]
    linked = wanted.objects[0]
    bpy.context.scene.collection.objects.link(linked)
    activate(linked)
    before = attributes.column(linked.data, attributes.ROTATION)
    assert "is linked from a.blend" in lab.error_of(bpy.ops.gscore.mend_splats)
    np.testing.assert_array_equal(attributes.column(linked.data, attributes.ROTATION), before)


def test_adjusted_apply_is_repaired_again(ob: bpy.types.Object) -> None:
    """Oracle: the rotation of each Apply, with undo in between, as when its settings are adjusted:
    the mark of the first does not apply to the second."""
    name = ob.name
    step("start")
    for turn in ((0.4, 1.1, -2.0), (0.1, 0, 0.5)):
        bpy.data.objects[name].rotation_euler = turn
        activate(bpy.data.objects[name])
        step("turned")
        apply()
        step("applied")
        found = lag.of(bpy.data.objects[name].data) / 1.5
        np.testing.assert_allclose(found, np.array(Euler(turn).to_matrix()), atol=1e-5)
        bpy.ops.ed.undo()
        bpy.context.view_layer.update()
        assert not lag.problem(bpy.data.objects[name].data)


def test_a_look_is_rare(ob: bpy.types.Object, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the number of mesh checks, each of which copies the splats: none when objects are
    rotated or meshes change, but one when an object is rotated after its mesh has changed."""
    ob.rotation_euler.x = 0.1  # the last check of new meshes
    bpy.context.view_layer.update()
    looks = []
    monkeypatch.setattr(lag, "follow", lambda mesh, **_: looks.append(mesh.name))
    for turn in (0.5, 1.0):
        ob.rotation_euler.x = turn
        bpy.context.view_layer.update()
    bpy.ops.gscore.grade_splats(saturation=0.5)
    for _ in range(3):
        ob.data.update()
        bpy.context.view_layer.update()
    assert not looks
    for turn in (0.5, 1.5):
        ob.rotation_euler.x = turn
        bpy.context.view_layer.update()
    assert len(looks) == 1
    ob.data.vertices.add(1)
    ob.data.update()
    bpy.context.view_layer.update()
    assert len(looks) == 2


def test_join_is_reported(scene: bpy.types.Scene) -> None:
    """Oracle: the numbers of splats: Blender's Join adds some with unknown rotation, which neither
    the add-on's Join takes nor a later Apply makes right; duplicates made in Edit Mode are right.
    The button keeps them and detects an Apply after it."""
    lab.prepare(scene)
    a, b, c = (lab.add(scene, lab.blob(100 + k, seed=k), "abc"[k]) for k in range(3))
    b.rotation_euler.x = 0.5
    activate(c)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.duplicate()
    bpy.ops.object.mode_set(mode="OBJECT")
    assert len(c.data.vertices) == 204 and not is_said() and not is_said(KEEP)
    activate(a, b)
    assert bpy.ops.object.join() == {"FINISHED"}
    assert len(a.data.vertices) == 201 and is_said(KEEP) and not is_said()
    a.rotation_euler.x = 1
    activate(a)
    apply()
    assert is_said(KEEP)
    activate(c, a)
    assert "a do not match" in lab.error_of(bpy.ops.gscore.join_splats)
    activate(a)
    shapes = attributes.column(a.data, attributes.ROTATION)
    bpy.ops.gscore.mend_splats()
    bpy.context.view_layer.update()
    np.testing.assert_array_equal(attributes.column(a.data, attributes.ROTATION), shapes)
    assert not is_said(KEEP)
    a.rotation_euler.x = 1
    apply()
    assert is_said()


def test_a_file_of_joined_parts_opens(ob: bpy.types.Object) -> None:
    """Oracle: the state that earlier versions stored: lags of each joined part, and their
    numbers."""
    ob.data[lag.KEY] = {
        "count": 400,
        "shapes": "0" * 32,
        "places": ob.data[lag.KEY]["places"].to_list(),
        "lags": [*np.eye(3).ravel(), *(2 * np.eye(3)).ravel()],
    }
    assert is_said(KEEP)
    bpy.ops.gscore.mend_splats()
    bpy.context.view_layer.update()
    assert not is_said(KEEP)


def test_the_addon_joins_what_is_mended(scene: bpy.types.Scene) -> None:
    """Oracle: no report of splats that the add-on joined, and its error names the object that needs
    repair, which a panel of another active object reports too."""
    lab.prepare(scene)
    obs = [lab.add(scene, lab.blob(100 + k, seed=k), f"o{k}") for k in range(2)]
    obs[1].matrix_basis = Matrix.Rotation(0.3, 4, "Z") @ Matrix.Scale(-1, 4)
    activate(*obs)
    bpy.ops.gscore.join_splats()
    bpy.context.view_layer.update()
    assert not is_said() and not is_said(KEEP)
    last = lab.add(scene, lab.blob(60, seed=4), "last")
    activate(last)
    last.rotation_euler = (1, 0, 0)
    apply()
    activate(obs[0], last)
    assert "last" in lab.error_of(bpy.ops.gscore.join_splats)
    assert is_said()  # of a selected one


def test_stretching_becomes_uniform(ob: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the picture with the uniform scale of the same volume, around the same center."""
    ob.scale = (1, 2, 0.5)
    activate(ob)
    places = attributes.column(ob.data, attributes.POSITION)
    center = np.array(ob.matrix_world @ Matrix.Translation(places.mean(0)))[:3, 3]
    apply()
    assert is_said()
    bpy.ops.gscore.mend_splats()
    bpy.context.view_layer.update()
    assert not is_said()
    got = attributes.column(ob.data, attributes.POSITION)
    turn = np.array(Euler((0.4, 1.1, -2.0)).to_matrix())
    np.testing.assert_allclose(got - center, (places - places.mean(0)) @ turn.T, atol=1e-5)
    picture = lab.render_exr(tmp_path, "mended")
    made = objects.moved(lab.blob(), np.array(Matrix(turn.tolist()).to_4x4()), "want")
    bpy.data.objects.remove(ob)
    want = lab.add(bpy.context.scene, made)
    want.location = center - turn @ places.mean(0)
    np.testing.assert_allclose(lab.render_exr(tmp_path, "want"), picture, atol=2e-3)


def test_flattened_splats_are_undone(ob: bpy.types.Object) -> None:
    """Oracle: the error, and nothing is changed."""
    ob.scale = (1, 1, 0)
    activate(ob)
    apply()
    places = attributes.column(ob.data, attributes.POSITION)
    assert "undo" in lab.error_of(bpy.ops.gscore.mend_splats)
    np.testing.assert_array_equal(attributes.column(ob.data, attributes.POSITION), places)


def test_our_apply_keeps_a_lag(ob: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the picture before Blender's Apply, with the add-on's between it and the repair."""
    before = lab.render_exr(tmp_path, "before")
    apply()
    turn = Matrix.Rotation(1, 4, "Y") @ Matrix.Scale(0.5, 4)
    ob.matrix_basis = turn
    bpy.context.view_layer.update()
    bpy.ops.gscore.apply_splat_transform()
    ob.matrix_basis = turn.inverted()
    bpy.context.view_layer.update()
    assert is_said()
    bpy.ops.gscore.mend_splats()
    bpy.context.view_layer.update()
    np.testing.assert_allclose(lab.render_exr(tmp_path, "mended"), before, atol=2e-3)


def test_other_splats_have_no_lag(ob: bpy.types.Object) -> None:
    """Oracle: a training or a sequence that replaces them by as many, or more."""
    for count in (400, 500):
        ob.rotation_euler = (1, 0, 0)
        apply()
        assert is_said()
        objects.refresh(ob, lab.blob(count, seed=8))
        bpy.context.view_layer.update()
        assert not is_said()


RNG = np.random.default_rng(5)
CLOUD = RNG.normal(size=(40, 3)) * (1, 3, 0.2) + (500, 0, 0)
TURN = np.array(Euler((0.3, 1, -2)).to_matrix(), np.float64)


@pytest.mark.parametrize(
    ("points", "turn"),
    [
        (CLOUD, TURN * 3),
        (CLOUD, -TURN),
        (CLOUD, TURN * (1, 2, 1)),
        (CLOUD * (1, 1, 0), TURN),
        (CLOUD * (1, 1, 1e-5), TURN * 1.001),
        (np.r_[CLOUD[:30], 1e5 * CLOUD[30:]], TURN * 2),
    ],
    ids=["even", "mirror", "uneven", "plane", "thin", "outliers"],
)
def test_a_turn_is_found(points: np.ndarray, turn: np.ndarray) -> None:
    """Oracle: the actual rotation, in float32 as in Blender."""
    old = points.astype(np.float32)
    new = old @ turn.T.astype(np.float32) + np.float32(7)
    found = lag.turn_between(old.astype(np.float64), new.astype(np.float64))
    np.testing.assert_allclose(found, turn, atol=2e-4)


def test_no_turn_is_found() -> None:
    """Oracle: points on a line do not determine a rotation, single moved points are none, and a
    translation is the identity."""
    line = np.arange(20)[:, None] * np.array([1.0, 2, 3])
    assert lag.turn_between(line, line @ TURN.T) is None
    some = CLOUD.copy()
    some[3] += 0.1
    assert lag.turn_between(CLOUD, some) is None
    assert np.array_equal(lag.turn_between(CLOUD, CLOUD + 3), np.eye(3))
