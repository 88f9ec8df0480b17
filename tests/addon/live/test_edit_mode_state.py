"""Selection of large meshes in Edit Mode, as read for the live display."""

import bmesh
import bpy
import numpy as np
import pytest

from addon import attributes
from addon.live import edit_mode_state
from addon.render import viewport_copies
from addon.render.mesh_copies import HIDDEN, SELECTED
from addon.render.scene import sources
from tests.addon import splat_scenes as lab

COUNT = 500


@pytest.fixture
def ob(scene: bpy.types.Scene, monkeypatch: pytest.MonkeyPatch) -> bpy.types.Object:
    """An object that counts as large, with a third of it selected, in Object Mode."""
    monkeypatch.setattr(viewport_copies, "EDITED_AT_ONCE", COUNT - 1)
    monkeypatch.setattr(edit_mode_state, "PIECE", 200)
    ob = lab.add(scene, lab.blob(COUNT))
    attributes.select(ob.data, np.arange(COUNT) % 3 == 0)
    bpy.context.view_layer.objects.active = ob
    return ob


@pytest.fixture
def known(ob: bpy.types.Object) -> viewport_copies.Copies:
    """Its copy."""
    made = viewport_copies.Copies()
    _marks(made)
    return made


@pytest.fixture
def reader(known: viewport_copies.Copies) -> edit_mode_state.Reader:
    """The tested reader, with Edit Mode started at second 0."""
    made = edit_mode_state.Reader(known)

    def changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
        known.forget_changed(depsgraph)
        made.notice(depsgraph, 0.0)

    bpy.app.handlers.depsgraph_update_post.append(changed)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.context.view_layer.update()
    yield made
    if bpy.context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    bpy.app.handlers.depsgraph_update_post.remove(changed)
    made.clear()


def _marks(known: viewport_copies.Copies) -> np.ndarray:
    """Marks of the only copied object, [COUNT] uint8."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    placed, complete = known.copied(sources(depsgraph))
    while not placed and not complete:
        placed, complete = known.copied(sources(depsgraph))
    marks = placed[0].frozen.marks
    return np.zeros(COUNT, np.uint8) if marks is None else marks


def _read(reader: edit_mode_state.Reader) -> int:
    """Number of chunks read until views must be redrawn."""
    assert not reader.step(edit_mode_state.REST / 2)  # not while it does not rest
    for count in range(1, 20):
        if reader.step(1.0):
            return count
    raise AssertionError("nothing came")


def test_selections_and_hiding_follow_in_edit_mode(reader, known, ob) -> None:
    """Oracle: selection and visibility set by Blender's own operators."""
    assert reader.waits
    assert _read(reader) == 3 and not reader.waits
    assert ((_marks(known) & SELECTED) != 0).sum() == (COUNT + 2) // 3
    bpy.ops.mesh.select_all(action="INVERT")
    bpy.context.view_layer.update()
    assert _read(reader) == 3
    np.testing.assert_array_equal(_marks(known), SELECTED * (np.arange(COUNT) % 3 != 0))
    bpy.ops.mesh.hide()
    bpy.context.view_layer.update()
    _read(reader)
    np.testing.assert_array_equal(_marks(known), HIDDEN * (np.arange(COUNT) % 3 != 0))
    bpy.ops.mesh.reveal(select=False)
    bpy.context.view_layer.update()
    _read(reader)
    assert not _marks(known).any()


def test_a_selection_begins_again_what_was_being_read(reader, known, ob) -> None:
    """Oracle: the later selection only; half of the earlier one had been read."""
    reader.step(1.0)
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.context.view_layer.update()
    assert _read(reader) == 3
    assert (_marks(known) == SELECTED).all()


def test_other_splats_are_left_alone(reader, known, ob) -> None:
    """Oracle: the copy keeps its splats until Edit Mode ends, although the BMesh has others."""
    editor = bmesh.from_edit_mesh(ob.data)
    bmesh.ops.delete(editor, geom=editor.verts[:100], context="VERTS")
    bmesh.update_edit_mesh(ob.data)
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.context.view_layer.update()
    _read(reader)
    assert len(_marks(known)) == COUNT and (_marks(known) == SELECTED).sum() == (COUNT + 2) // 3


def test_bmesh_is_released_after_edit_mode(reader, known, ob) -> None:
    """Oracle: the BMesh is released, and nothing remains to be read."""
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.update()
    assert not reader.step(1.0) and not reader.waits


def test_small_objects_are_not_read(reader, known, ob, monkeypatch) -> None:
    """Oracle: they are copied directly elsewhere."""
    monkeypatch.setattr(viewport_copies, "EDITED_AT_ONCE", COUNT)
    reader.clear()
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.context.view_layer.update()
    assert not reader.waits
