"""Incremental edits. Oracle: the same operator called by a script, on an equal object."""

import re
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from addon import attributes
from addon.core import Splats, join_splats
from addon.interface import incremental_operator
from addon.process.incremental_tasks import TaskRunner, run_blocking
from addon.splats import objects, point_attributes, read_chunked, write_chunked
from addon.splats.mesh_buffers import points_of
from tests.addon import splat_scenes as lab
from tools.measure.windowless import windowless

COUNT = 400
EDITS: list[tuple[str, dict[str, Any]]] = [
    ("select_by_color", {"tolerance": 0.4}),
    ("select_by_opacity", {"low": 0.2, "high": 0.7}),
    ("select_by_size", {"low": 0.05, "mode": "ADD"}),
    ("select_in_crop", {"mode": "TAKE"}),
    ("select_flood", {"gap": 0.3, "tolerance": 1.0}),
    ("select_floaters", {"few": 50, "gap": 0.5}),
    ("select_splats", {"which": "VISIBLE"}),
    ("grade_splats", {"saturation": 0.25, "only_selected": True}),
    ("separate_splats", {}),
    ("join_splats", {}),
    ("apply_filters", {}),
    ("apply_splat_transform", {}),
    ("mend_splats", {}),
    ("decimate_splats", {"count": 150}),
]
IDS = [name for name, _ in EDITS]


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """One attribute per step."""
    monkeypatch.setattr(read_chunked, "BUDGET", 0.0)
    monkeypatch.setattr(write_chunked, "BUDGET", 0.0)


FILES: list[Path] = []
"""Folder of the files of `prepare`."""


@pytest.fixture(scope="module", autouse=True)
def file_folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    """A folder for `FILES`."""
    FILES[:] = [tmp_path_factory.mktemp("edits")]


def prepare(name: str) -> bpy.types.Object:
    """A file with the operator's target as active object, made once for each operator."""
    path = FILES[0] / f"{name}.blend"
    if not path.exists():
        made(name)
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    return bpy.context.view_layer.objects.active


def made(name: str) -> None:
    """Make the operator's target in an empty file."""
    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    far = lab.blob(20, center=(30, 0, 0), size=0.1)
    ob = lab.add(scene, join_splats([lab.blob(COUNT - 20), far]), "splats")
    own = ob.data.attributes.new("mine", "INT", "POINT")
    own.data.foreach_set("value", np.arange(COUNT, dtype=np.int32))
    attributes.select(ob.data, np.arange(COUNT) % 3 == 0)
    bpy.context.view_layer.objects.active = ob
    ob.select_set(True)
    if name == "join_splats":
        other = lab.add(scene, lab.blob(50, seed=3), "other")
        other.rotation_euler = (0.3, 0.2, 0.1)
        other.select_set(True)
    elif name == "select_in_crop":
        bpy.ops.gscore.add_crop_box()
        bpy.context.view_layer.objects.active = ob
    elif name in {"apply_filters", "select_splats"}:
        ob.gscore.opacity_min = 0.5
    elif name == "apply_splat_transform":
        ob.location, ob.rotation_euler = (1, 2, 3), (0.1, 0.2, 0.3)
    elif name == "mend_splats":
        ob.rotation_euler = (0.1, 0.2, 0.3)
        bpy.context.view_layer.update()
        bpy.ops.object.transform_apply()
    bpy.context.view_layer.update()


def state() -> dict[str, Any]:
    """All data that edits may change: each object's points to the bit, matrix, mode and users."""
    found: dict[str, Any] = {}
    for ob in bpy.context.scene.objects:
        if not objects.is_splats(ob):
            continue
        mode = ob.mode
        if mode == "EDIT":
            ob.update_from_editmode()
        mesh = ob.data.copy()  # attributes cannot be read in Edit Mode
        for name, kind in point_attributes.kinds(mesh).items():
            values = point_attributes.empty_values(kind, len(mesh.vertices))
            point_attributes.copy_values(mesh, name, values)
            found[f"{ob.name} {name}"] = values.tobytes()
        found[f"{ob.name} selected"] = attributes.selected(mesh).tobytes()
        bpy.data.meshes.remove(mesh)
        found[ob.name] = mode, ob.data.name, [tuple(row) for row in ob.matrix_basis]
    found["meshes"] = sorted(mesh.name for mesh in bpy.data.meshes)
    found["active"] = bpy.context.view_layer.objects.active.name
    return found


def begun(name: str, settings: dict[str, Any]) -> TaskRunner:
    """The operator after its first step."""
    going = TaskRunner(windowless(name, **settings).steps(bpy.context))
    assert not going.step()
    return going


def until(going: TaskRunner, ends: Callable[[], bool]) -> bool:
    """Run steps until a condition is true, or all are done; return whether it is true."""
    for _ in range(10_000):
        if ends():
            return False
        if going.step():
            return True
        threading.Event().wait(0.0005)
    raise AssertionError("it never ends")


@pytest.mark.parametrize(("name", "settings"), EDITS, ids=IDS)
def test_bit_by_bit_as_at_once(name: str, settings: dict[str, Any], capfd: Any) -> None:
    """Equal to the bit, with the same report."""
    prepare(name)
    assert getattr(bpy.ops.gscore, name)(**settings) == {"FINISHED"}
    wanted, said = state(), capfd.readouterr().out
    prepare(name)
    before = state()
    going = begun(name, settings)
    sentences = set()
    assert until(going, lambda: sentences.add(going.sentence) is not None)
    assert state() == wanted != before
    assert len(sentences) > 1 and (going.result or "") in said


@pytest.mark.parametrize(("name", "settings"), EDITS, ids=IDS)
@pytest.mark.parametrize("doing", ["Reading", "Writing"])
def test_cancelled_leaves_all_as_it_was(name: str, settings: dict[str, Any], doing: str) -> None:
    """In each phase that an operator has: no new datablock, no changed value, the same
    selection."""
    prepare(name)
    before, selected = state(), bpy.context.selected_objects[:]
    going = begun(name, settings)
    replaces = not name.startswith(("select", "grade"))
    done = until(going, lambda: going.sentence.startswith(doing))
    assert done == (doing == "Writing" and not replaces)
    if not done:
        going.cancel()
        assert state() == before and bpy.context.selected_objects[:] == selected


@pytest.mark.parametrize(("name", "settings"), EDITS, ids=IDS)
@pytest.mark.parametrize("what", ["edited", "deleted", "undone", "another mode"])
def test_changes_during_an_edit_are_kept(name: str, settings: dict[str, Any], what: str) -> None:
    """An error; the other changes are kept, and nothing else is done."""
    ob = prepare(name)
    bpy.ops.ed.undo_push(message="before")
    ob.gscore.point_size *= 2
    bpy.ops.ed.undo_push(message="after")
    going = begun(name, settings)
    if what == "edited":
        ob.data.vertices[0].co.x += 1
        ob.data.update()
    elif what == "deleted":
        bpy.data.objects.remove(ob)
        other = bpy.data.objects.new("something", None)
        bpy.context.scene.collection.objects.link(other)
        bpy.context.view_layer.objects.active = other
    elif what == "undone":
        bpy.ops.ed.undo()
    else:
        mesh = bpy.data.meshes.new("cube")
        cube = bpy.data.objects.new("cube", mesh)
        bpy.context.scene.collection.objects.link(cube)
        bpy.context.view_layer.objects.active = cube
        bpy.ops.object.mode_set(mode="EDIT")
    bpy.context.view_layer.update()
    before = state()
    before["meshes"] = [m for m in before["meshes"] if not m.startswith("splats.")]
    with pytest.raises(ValueError, match="try again"):
        until(going, lambda: False)
    assert state() == before
    if what == "another mode":
        bpy.ops.object.mode_set(mode="OBJECT")


@pytest.mark.parametrize(
    ("name", "moved"),
    [("apply_splat_transform", "splats"), ("join_splats", "splats"), ("join_splats", "other")],
)
def test_moves_during_an_edit_are_kept(name: str, moved: str) -> None:
    """An error. Oracle: the state right after the move."""
    prepare(name)
    going = begun(name, {})
    bpy.data.objects[moved].location.x += 4
    bpy.context.view_layer.update()
    before = state()
    before["meshes"] = [m for m in before["meshes"] if not re.fullmatch(r"(splats|other)\.\d+", m)]
    with pytest.raises(ValueError, match=f"{moved} was moved"):
        until(going, lambda: False)
    assert state() == before


def test_lacking_memory_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the earlier splats, and a message with the remedy."""
    prepare("decimate_splats")
    before = state()

    def lacks(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(point_attributes, "picked", lacks)
    with pytest.raises(RuntimeError, match="close other programs"):
        bpy.ops.gscore.decimate_splats(count=150)
    assert state() == before


def test_of_two_at_once_one_is_done() -> None:
    """The one that ends later reports that the splats have changed."""
    ob = prepare("decimate_splats")
    first = begun("decimate_splats", {"count": 150})
    second = begun("separate_splats", {})
    assert until(first, lambda: False)
    with pytest.raises(ValueError, match="try again"):
        until(second, lambda: False)
    assert len(ob.data.vertices) == 150 and "splats part" not in bpy.data.objects


@pytest.mark.parametrize("of", ["the first", "each other"])
def test_those_that_share_splats_are_joined(of: str) -> None:
    """Oracle: world positions by Blender's own matrices; no mesh is left."""
    ob = prepare("join_splats")
    other = bpy.data.objects["other"]
    copy = (ob if of == "the first" else other).copy()
    bpy.context.scene.collection.objects.link(copy)
    copy.location = (5, 0, 0)
    copy.select_set(True)
    bpy.context.view_layer.update()
    wanted = np.concatenate([_places(one) for one in (ob, other, copy)])
    bpy.ops.gscore.join_splats()
    got = _places(ob)
    assert sorted(map(tuple, got.round(4))) == sorted(map(tuple, wanted.round(4)))
    assert list(bpy.context.scene.objects) == [ob] and list(bpy.data.meshes) == [ob.data]


def _places(ob: bpy.types.Object) -> np.ndarray:
    found = np.array([ob.matrix_world @ vertex.co for vertex in ob.data.vertices])
    return found + 0.0  # no negative zeros


def test_shared_data_is_not_moved() -> None:
    """Oracle: the earlier matrix and splats, and the object named in the error."""
    ob = prepare("apply_splat_transform")
    other = ob.copy()
    bpy.context.scene.collection.objects.link(other)
    before = state()
    with pytest.raises(RuntimeError, match=f"shares its splats with {other.name}"):
        bpy.ops.gscore.apply_splat_transform()
    assert state() == before


def test_undo_brings_no_copy_back() -> None:
    """Undo to a step made while splats were read, and redo from there."""
    prepare("grade_splats")
    bpy.ops.ed.undo_push(message="before")
    going = begun("grade_splats", {"saturation": 0.0})
    assert len(bpy.data.meshes) == 2
    bpy.ops.ed.undo_push(message="meanwhile")
    assert until(going, lambda: False)
    bpy.ops.ed.undo_push(message="after")
    for step in (bpy.ops.ed.undo, bpy.ops.ed.undo, bpy.ops.ed.redo, bpy.ops.ed.redo):
        step()
        assert [mesh.name for mesh in bpy.data.meshes] == ["splats"]


def test_undo_takes_what_is_half_filled() -> None:
    """Undo to a step at which fewer attributes were filled. Oracle: all of them, in the end."""
    ob = prepare("decimate_splats")
    made = write_chunked.ChunkedWrite(points_of(run_blocking(read_chunked.ChunkedRead(ob).table())))
    bpy.ops.ed.undo_push(message="before")
    for message in ("begun", "further"):
        for _ in range(3):
            assert not made.fill()
        bpy.ops.ed.undo_push(message=message)
    bpy.ops.ed.undo()
    while not made.fill():
        pass
    mesh = made.take()
    for name, kind, values in made.loaded.columns:
        found = point_attributes.empty_values(kind, COUNT)
        point_attributes.copy_values(mesh, name, found)
        np.testing.assert_array_equal(found.reshape(-1), values)
    assert len(bpy.data.meshes) == 2


def test_disabling_the_add_on_cancels_edits() -> None:
    """Oracle: the earlier datablocks and values, although Blender does not notify operators."""
    prepare("decimate_splats")
    before = state()
    going = begun("decimate_splats", {"count": 150})
    waiting = _Reports()
    incremental_operator._ModalRun(going, waiting)  # as the operator does in a window
    incremental_operator.on_unregister()
    assert state() == before and waiting.ended
    incremental_operator.on_unregister()


class _Reports:
    """Fake of a timer and a status bar."""

    ended = False

    def end(self) -> None:
        assert not self.ended
        self.ended = True


def test_all_that_numbers_tell_follows() -> None:
    """Oracle: the written values, of remaining and of joined points; 0 without a value."""
    ob = prepare("join_splats")
    kinds = {"FLOAT4X4": 16, "BYTE_COLOR": 4, "INT8": 1, "INT32_2D": 2}
    for kind, width in kinds.items():
        ob.data.attributes.new(kind, kind, "POINT")
        values = point_attributes.empty_values(kind, COUNT)
        values[:] = (np.arange(COUNT * width) % 100).reshape(COUNT, width) / (
            255 if kind == "BYTE_COLOR" else 1
        )
        attributes.fill(ob.data, kind, kind, values.reshape(-1))
    bpy.ops.gscore.join_splats()
    for kind in kinds:
        values = point_attributes.empty_values(kind, COUNT + 50)
        point_attributes.copy_values(ob.data, kind, values)
        wanted = np.arange(values[:COUNT].size) % 100 / (255 if kind == "BYTE_COLOR" else 1)
        np.testing.assert_array_equal(values[:COUNT].reshape(-1), wanted.astype(values.dtype))
        assert not values[COUNT:].any()


def test_edit_mode_is_entered_again() -> None:
    """After the edit, and after its cancellation."""
    ob = prepare("grade_splats")
    bpy.ops.object.mode_set(mode="EDIT")
    going = begun("grade_splats", {"saturation": 0.0})
    assert ob.mode == "OBJECT"
    going.cancel()
    assert ob.mode == "EDIT"
    going = begun("grade_splats", {"saturation": 0.0})
    assert until(going, lambda: False) and ob.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")


@pytest.mark.parametrize("name", ["separate_splats", "join_splats", "decimate_splats"])
def test_undo_takes_an_edit_back(name: str) -> None:
    """With the earlier mesh, although it was replaced; redo works too."""
    prepare(name)
    bpy.ops.ed.undo_push(message="before")
    before = state()
    settings = dict(EDITS)[name]
    getattr(bpy.ops.gscore, name)(**settings)
    bpy.ops.ed.undo_push(message="after")
    after = state()
    bpy.ops.ed.undo()
    assert state() == before
    bpy.ops.ed.redo()
    assert state() == after != before


def test_all_users_of_a_mesh_follow(scene: bpy.types.Scene, make_splats: Callable[..., Splats]):
    """Oracle: Blender's own sharing of meshes; materials and a fake user stay."""
    one = lab.add(scene, make_splats(COUNT))
    other = one.copy()
    scene.collection.objects.link(other)
    one.data.use_fake_user = True
    one.data.materials.append(bpy.data.materials.new("paint"))
    materials, name = list(one.data.materials), one.data.name
    bpy.context.view_layer.objects.active = one
    bpy.ops.gscore.decimate_splats(count=100)
    assert one.data == other.data and one.data.name == name and one.data.use_fake_user
    assert len(other.data.vertices) == 100 and list(one.data.materials) == materials
