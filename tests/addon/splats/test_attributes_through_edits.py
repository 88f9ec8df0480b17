"""Attributes, groups and other data of splats and objects through edits. Oracles: the data
added."""

import gc

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from addon import attributes
from addon.splats import point_attributes, vertex_groups
from tests.addon import splat_scenes as lab
from tests.addon.calls import read_world

COUNT = 300
BEFORE = {"head": (1, 2, 3), "locked": (4, 5, 6)}
"""Indices modulo ten of the splats in each group."""

_TYPES = bpy.types.Attribute.bl_rna.properties["data_type"].enum_items
KINDS = {item.identifier for item in _TYPES}
"""All data types that attributes have in this Blender."""


def add(name: str, groups: dict[str, tuple[int, ...]], seed: int = 0) -> bpy.types.Object:
    """A splat object with every tenth splat hidden, and groups with different, equal, or zero
    weights."""
    ob = lab.add(bpy.context.scene, lab.blob(COUNT, seed=seed), name)
    hidden = ob.data.attributes.new(".hide_vert", "BOOLEAN", "POINT")
    hidden.data.foreach_set("value", np.arange(COUNT) % 10 == 0)
    for called, digits in groups.items():
        group = ob.vertex_groups.new(name=called)
        group.lock_weight = called == "locked"
        for digit in digits:
            for row in range(digit, COUNT, 10):
                group.add([row], {1: 0.0, 2: 0.5}.get(digit, row / COUNT), "REPLACE")
    ob.vertex_groups.active_index = 0
    return ob


def carried(ob: bpy.types.Object) -> dict[str, dict[int, float]]:
    """Weights of each group, by the index of the splat."""
    names = [group.name for group in ob.vertex_groups]
    found: dict[str, dict[int, float]] = {name: {} for name in names}
    for row, vertex in enumerate(ob.data.vertices):
        for entry in vertex.groups:
            found[names[entry.group]][row] = entry.weight
    return found


def hidden(ob: bpy.types.Object) -> np.ndarray:
    """[N] bool."""
    found = np.zeros(len(ob.data.vertices), bool)
    if (attribute := ob.data.attributes.get(".hide_vert")) is not None:
        attribute.data.foreach_get("value", found)
    return found


def rows_of(before: dict[str, dict[int, float]], rows: np.ndarray) -> dict[str, dict[int, float]]:
    """The weights of a subset of splats."""
    places = {int(row): at for at, row in enumerate(rows)}
    return {
        name: {places[row]: weight for row, weight in values.items() if row in places}
        for name, values in before.items()
    }


@pytest.fixture
def ob(scene: bpy.types.Scene) -> bpy.types.Object:
    """Active splats with vertex groups."""
    made = add("splats", BEFORE)
    bpy.context.view_layer.objects.active = made
    made.select_set(True)
    bpy.context.view_layer.update()
    return made


def give_all(ob: bpy.types.Object) -> None:
    """Add attributes of all data types, with values that identify the splat, long and empty
    texts."""
    for kind in sorted(KINDS):
        name = f"of {kind}"
        ob.data.attributes.new(name, kind, "POINT")
        if kind == "STRING":
            for row, text in enumerate(ob.data.attributes[name].data):
                text.value = (b"", b"\xc3\xa9 %d" % row, b"\xff%d" % row + b"-" * 250)[row % 3]
            continue
        values = point_attributes.empty_values(kind, COUNT)
        numbers = np.arange(values.size).reshape(values.shape) % 100
        values[:] = numbers / 255 if kind == "BYTE_COLOR" else numbers
        attributes.fill(ob.data, name, kind, values.reshape(-1))


def others_of(ob: bpy.types.Object) -> dict[str, list[object]]:
    """Values of `give_all`, point by point, as Blender returns them."""
    found: dict[str, list[object]] = {}
    for kind in sorted(KINDS):
        attribute = ob.data.attributes.get(f"of {kind}")
        if attribute is not None:
            assert (attribute.data_type, attribute.domain) == (kind, "POINT")
            key = attribute.data[0].bl_rna.properties[-1].identifier
            values = [getattr(one, key) for one in attribute.data]
            found[kind] = [v if isinstance(v, bytes) else np.array(v).tolist() for v in values]
    return found


@pytest.mark.parametrize(
    "edit", ["separate_splats", "decimate_splats", "apply_filters", "apply_splat_transform"]
)
def test_attributes_of_all_types_follow(
    ob: bpy.types.Object, edit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the earlier values of each point, identified by its index."""
    monkeypatch.setattr(point_attributes, "BLOCK", 7)
    give_all(ob)
    ids = ob.data.attributes.new("id", "INT", "POINT")
    ids.data.foreach_set("value", np.arange(COUNT, dtype=np.int32))
    before = others_of(ob)
    assert before.keys() == KINDS and set(before["STRING"]) > {b"", b"\xc3\xa9 1"}
    attributes.select(ob.data, np.arange(COUNT) % 7 == 3)
    ob.gscore.opacity_min, ob.location = 0.5, (1, 2, 3)
    bpy.context.view_layer.update()
    getattr(bpy.ops.gscore, edit)(**({"count": 100} if edit == "decimate_splats" else {}))
    for one in bpy.data.objects:
        rows = [value.value for value in one.data.attributes["id"].data]
        assert (0 < len(rows) < COUNT) == (edit != "apply_splat_transform")
        kept = {kind: [values[row] for row in rows] for kind, values in before.items()}
        assert others_of(one) == kept
    assert len(bpy.data.objects) == (2 if edit == "separate_splats" else 1)


def test_attributes_of_all_types_are_joined(ob: bpy.types.Object) -> None:
    """Oracle: the earlier values of each point; missing ones are 0, or an empty text; undo restores
    all."""
    other = add("other", {}, seed=3)
    give_all(other)
    before = others_of(other)
    other.select_set(True)
    bpy.context.view_layer.update()
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.gscore.join_splats()
    bpy.ops.ed.undo_push(message="joined")
    joined = others_of(ob)
    assert joined.keys() == KINDS
    for kind, values in joined.items():
        assert values[COUNT:] == before[kind], kind
        lacking = values[0]
        assert lacking == b"" or not np.any(lacking)  # numpy 1 cannot convert bytes to bool
        assert values[:COUNT] == [lacking] * COUNT
    bpy.ops.ed.undo()
    assert others_of(bpy.data.objects["other"]) == before


def test_unsupported_data_is_named(ob: bpy.types.Object, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the error, and nothing is lost; moving keeps the data and is allowed."""
    give_all(ob)
    before = others_of(ob)
    monkeypatch.delitem(point_attributes.FORMATS, "FLOAT2")  # like a type of a later Blender
    attributes.select(ob.data, np.arange(COUNT) % 7 == 3)
    with pytest.raises(RuntimeError, match=r"has the type \w+, which this add-on cannot keep"):
        bpy.ops.gscore.separate_splats()
    assert others_of(ob) == before and len(bpy.data.objects) == len(bpy.data.meshes) == 1
    ob.location = (1, 2, 3)
    bpy.context.view_layer.update()
    bpy.ops.gscore.apply_splat_transform()
    assert others_of(ob) == before and not ob.location[0]


def check(ob: bpy.types.Object, before: dict[str, dict[int, float]], rows: np.ndarray) -> None:
    """Compare groups, their settings, and hidden splats."""
    assert carried(ob) == rows_of(before, rows)
    assert [(g.name, g.lock_weight) for g in ob.vertex_groups] == [
        ("head", False),
        ("locked", True),
    ]
    assert ob.vertex_groups.active_index == 0
    np.testing.assert_array_equal(hidden(ob), rows % 10 == 0)


def test_numbers_are_as_blender_keeps_them(ob: bpy.types.Object) -> None:
    """Oracle: the stride between points in Blender's memory. Numbers of another size are converted
    one by one, which blocks Blender for 0.1 s with a million splats."""
    for kind in sorted(KINDS - {"STRING", "BYTE_COLOR"}):  # which is read as floats
        data = ob.data.attributes.new(kind, kind, "POINT").data
        stride = data[1].as_pointer() - data[0].as_pointer()
        assert point_attributes.empty_values(kind, 2).strides[0] == stride, kind


@pytest.mark.parametrize("what", ["groups", "text"])
def test_reading_starts_no_garbage_collection(scene: bpy.types.Scene, what: str) -> None:
    """Oracle: Python's own callbacks. In a Blender with add-ons each collection takes 0.05 s."""
    mesh = lab.add(scene, lab.blob(2 * vertex_groups.BLOCK)).data
    group = scene.objects[0].vertex_groups.new(name="all")
    group.add(list(range(len(mesh.vertices))), 1.0, "REPLACE")
    mesh.attributes.new("tag", "STRING", "POINT").data[5000].value = b"some"
    begun: list[str] = []
    gc.collect()
    gc.callbacks.append(note := lambda phase, info: begun.append(phase))
    try:
        if what == "groups":
            values = vertex_groups.made(["all"], len(mesh.vertices))
            vertex_groups.read(mesh, vertex_groups.BLOCK, values)
        else:
            values = point_attributes.empty_values("STRING", len(mesh.vertices))
            point_attributes.read_texts(mesh, "tag", point_attributes.BLOCK, values, {})
    finally:
        gc.callbacks.remove(note)
    assert not begun
    assert values.reshape(-1)[5000] == (1.0 if what == "groups" else b"some")


@pytest.mark.parametrize("edited", [False, True])
def test_separated(ob: bpy.types.Object, edited: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: rows of the earlier data, in both parts, from Edit Mode too; also incrementally."""
    monkeypatch.setattr(vertex_groups, "BLOCK", 7)
    monkeypatch.setattr(point_attributes, "BLOCK", 7)
    before, some = carried(ob), np.arange(COUNT) % 7 == 3
    assert len(before["head"]) == len(before["locked"]) == 90
    attributes.select(ob.data, some & ~hidden(ob))
    some = attributes.selected(ob.data)
    if edited:
        bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.gscore.separate_splats()
    if edited:
        bpy.ops.object.mode_set(mode="OBJECT")
    check(ob, before, np.flatnonzero(~some))
    check(bpy.data.objects["splats part"], before, np.flatnonzero(some))
    assert len(bpy.data.objects) == 2


@pytest.mark.parametrize("how", ["decimated", "filtered"])
def test_deleted(ob: bpy.types.Object, how: str) -> None:
    """Oracle: rows of the earlier data, including selected ones."""
    ids = ob.data.attributes.new("id", "INT", "POINT")
    ids.data.foreach_set("value", np.arange(COUNT, dtype=np.int32))
    before, some = carried(ob), np.arange(COUNT) % 4 == 0
    attributes.select(ob.data, some)
    if how == "decimated":
        bpy.ops.gscore.decimate_splats(count=100)
    else:
        ob.gscore.opacity_min = 0.5
        bpy.ops.gscore.apply_filters()
    rows = np.empty(len(ob.data.vertices), np.int32)
    assert 0 < len(rows) < COUNT
    ob.data.attributes["id"].data.foreach_get("value", rows)
    check(ob, before, rows)
    np.testing.assert_array_equal(attributes.selected(ob.data), some[rows])


def test_turned(ob: bpy.types.Object) -> None:
    """Oracle: what was there."""
    before = carried(ob)
    ob.rotation_euler, ob.scale = (0.1, 0.2, 0.3), (2, 2, 2)
    bpy.context.view_layer.update()
    bpy.ops.gscore.apply_splat_transform()
    check(ob, before, np.arange(COUNT))


def test_joined(ob: bpy.types.Object) -> None:
    """Oracle: the data of each object, with groups of the same name merged; undo restores all."""
    other, third = add("other", {"tail": (7,), "head": (2, 8)}), add("third", {})
    box = bpy.data.objects.new("box", None)
    bpy.context.scene.collection.objects.link(box)
    box.parent = other
    before, theirs = carried(ob), carried(other)
    for one in (other, third):
        one.select_set(True)
    bpy.context.view_layer.update()
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.gscore.join_splats()
    bpy.ops.ed.undo_push(message="joined")
    got = carried(ob)
    assert list(got) == ["head", "locked", "tail"]
    shifted = {
        name: {row + COUNT: weight for row, weight in values.items()}
        for name, values in theirs.items()
    }
    assert got["head"] == {**before["head"], **shifted["head"]}
    assert (got["locked"], got["tail"]) == (before["locked"], shifted["tail"])
    assert [g.lock_weight for g in ob.vertex_groups] == [False, True, False]
    assert ob.vertex_groups.active_index == 0
    np.testing.assert_array_equal(hidden(ob), np.arange(3 * COUNT) % 10 == 0)
    assert set(bpy.data.objects) == {ob, box} and len(bpy.data.meshes) == 1
    bpy.ops.ed.undo()
    ob, other = bpy.data.objects["splats"], bpy.data.objects["other"]
    assert (carried(ob), carried(other)) == (before, theirs)
    assert bpy.data.objects["box"].parent == other and len(bpy.data.meshes) == 3
    bpy.ops.ed.redo()
    assert carried(bpy.data.objects["splats"]) == got


def test_one_without_groups_takes_them_in(scene: bpy.types.Scene) -> None:
    """Oracle: the data of the other object."""
    one, other = add("one", {}), add("other", BEFORE)
    theirs = carried(other)
    bpy.context.view_layer.objects.active = one
    bpy.context.view_layer.update()
    for each in (one, other):
        each.select_set(True)
    bpy.ops.gscore.join_splats()
    assert carried(one) == {
        name: {row + COUNT: weight for row, weight in values.items()}
        for name, values in theirs.items()
    }


def test_a_group_may_be_called_as_an_attribute(ob: bpy.types.Object) -> None:
    """Oracle: positions and weights as before."""
    ob.vertex_groups["head"].name = "scale"
    if ob.vertex_groups[0].name != "scale":
        pytest.skip("this Blender does not allow it")
    before, scales = carried(ob), attributes.column(ob.data, attributes.SCALE)
    attributes.select(ob.data, np.arange(COUNT) >= 100)
    bpy.ops.gscore.separate_splats()
    assert carried(ob) == rows_of(before, np.arange(100))
    np.testing.assert_array_equal(attributes.column(ob.data, attributes.SCALE), scales[:100])


@pytest.mark.parametrize("below", [False, True])
def test_children_of_joined_objects_stay(ob: bpy.types.Object, below: bool) -> None:
    """Oracle: world matrices before, also of the object itself if its parent is joined into it."""
    other, box = add("other", {}), bpy.data.objects.new("box", None)
    root, between = (bpy.data.objects.new(name, None) for name in ("root", "between"))
    for one in (box, root, between):
        bpy.context.scene.collection.objects.link(one)
    root.rotation_euler, other.parent = (0.3, 0.1, 0), root
    other.location, other.rotation_euler, other.scale = (1, 2, 3), (0.5, 1, 0), (2, 2, 2)
    ob.location, ob.rotation_euler = (0, 1, 0), (0, 0, 1)
    box.parent, box.location, box.scale = other, (0.2, 0.3, 0.4), (1, 2, 3)
    box.matrix_parent_inverse = Matrix.Translation((1, 0, 0))
    if below:
        between.parent, ob.parent, between.location = other, between, (0, 0, 2)
    other.select_set(True)
    bpy.context.view_layer.update()
    stay = [one for one in (ob, box, between) if below or one != between]
    before = {one.name: np.array(one.matrix_world) for one in stay}
    splats = np.vstack([read_world(one).means for one in (ob, other)])
    bpy.ops.gscore.join_splats()
    bpy.context.view_layer.update()
    for name, matrix in before.items():
        got = np.array(bpy.data.objects[name].matrix_world)
        np.testing.assert_allclose(got, matrix, atol=1e-5, err_msg=name)
    assert box.parent == ob and between.parent == (root if below else None)
    np.testing.assert_allclose(read_world(ob).means, splats, atol=1e-4)
