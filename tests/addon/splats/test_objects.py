"""Splats as mesh objects. Oracle: the input values, to the bit where float32 allows it."""

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest

from addon.core import Splats, read_splats, transform_splats, write_splats
from addon.render.mesh_copies import read_marks
from addon.splats import objects
from tests.addon import points
from tests.addon.calls import read_world

Make = Callable[..., Splats]
RAW = ("means", "quats", "scales", "opacities", "sh0", "shN")


def equal(got: Splats, wanted: Splats) -> None:
    """Raise unless two models agree to float32."""
    for name in ("means", "sh0", "shN"):
        np.testing.assert_array_equal(getattr(got, name), getattr(wanted, name), name)
    np.testing.assert_array_max_ulp(got.scales, wanted.scales, maxulp=1)
    np.testing.assert_allclose(got.quats, wanted.quats, atol=2e-7)
    np.testing.assert_allclose(got.opacities, wanted.opacities, rtol=1e-7, atol=2e-5)


def raw_bytes(ob: bpy.types.Object) -> dict[str, bytes]:
    """Each splat attribute as bytes."""
    found = {}
    for name in (
        "position",
        "scale",
        "rotation",
        "radiance:base",
        *(f"radiance:sh_{k}" for k in range(15)),
    ):
        attribute = ob.data.attributes.get(name)
        if attribute is not None:
            key = {"FLOAT_VECTOR": "vector", "QUATERNION": "value", "FLOAT_COLOR": "color"}
            width = 3 if attribute.data_type == "FLOAT_VECTOR" else 4
            values = np.empty(len(attribute.data) * width, np.float32)
            attribute.data.foreach_get(key[attribute.data_type], values)
            found[name] = values.tobytes()
    return found


@pytest.mark.parametrize("rest", [0, 3, 8, 15, 24])
def test_round_trip(scene: bpy.types.Scene, make_splats: Make, rest: int) -> None:
    """Oracle: the given splats."""
    splats = make_splats(rest=rest)
    ob = objects.create(splats, "Splats")
    assert objects.is_splats(ob)
    assert ob.name in scene.collection.all_objects
    assert len(ob.data.vertices) == 500
    equal(objects.read(ob), splats)


def test_attributes_are_blenders(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: the names, types and meaning of Blender's own splats, computed by hand."""
    splats = make_splats(3)
    ob = objects.create(splats, "Splats")
    types = {a.name: a.data_type for a in ob.data.attributes if not a.name.startswith(".")}
    wanted = {f"radiance:sh_{k}": "FLOAT_VECTOR" for k in range(15)} | {
        "position": "FLOAT_VECTOR",
        "scale": "FLOAT_VECTOR",
        "rotation": "QUATERNION",
        "radiance:base": "FLOAT_COLOR",
    }
    assert types == wanted
    data = ob.data.attributes
    np.testing.assert_allclose(data["scale"].data[1].vector, np.exp(splats.scales[1]), rtol=1e-6)
    np.testing.assert_allclose(data["rotation"].data[2].value, splats.quats[2], rtol=1e-6)
    alpha = 1 / (1 + np.exp(-splats.opacities[0]))
    np.testing.assert_allclose(
        data["radiance:base"].data[0].color, [*splats.sh0[0, 0], alpha], rtol=1e-6
    )
    np.testing.assert_allclose(data["radiance:sh_4"].data[1].vector, splats.shN[1, 4], rtol=1e-6)


def test_quaternions_of_any_length(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: the same rotation, unit length."""
    splats = make_splats()
    long = Splats(**{n: getattr(splats, n) for n in RAW} | {"quats": splats.quats * 7})
    got = objects.read(objects.create(long, "Splats")).quats
    np.testing.assert_allclose(got, splats.quats, atol=2e-7)


def test_extreme_opacities(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: finite and the same opacity after a round trip; the documented limit at the top."""
    splats = make_splats(5)
    logits = np.array([-60, -20, 0, 12, 60], np.float32)
    splats = Splats(**{n: getattr(splats, n) for n in RAW} | {"opacities": logits})
    got = objects.read(objects.create(splats, "Splats")).opacities
    np.testing.assert_allclose(got[:3], logits[:3], rtol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-got[3:])), [1, 1], atol=1e-5)
    assert np.isfinite(got).all() and got[4] == pytest.approx(16.6, abs=0.1)


def test_save_and_load(scene: bpy.types.Scene, make_splats: Make, tmp_path: Path) -> None:
    """Oracle: the bytes of every attribute before saving."""
    ob = objects.create(make_splats(), "Splats")
    before = raw_bytes(ob)
    assert len(before) == 19
    path = str(tmp_path / "scene.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=path)
    again = bpy.data.objects["Splats"]
    assert objects.is_splats(again)
    assert raw_bytes(again) == before


@pytest.mark.parametrize("change", [(500, 15), (800, 15), (200, 15), (500, 3), (0, 0), (900, 0)])
def test_refresh(scene: bpy.types.Scene, make_splats: Make, change: tuple[int, int]) -> None:
    """Oracle: the new splats; unchanged transform, parent and settings."""
    parent = bpy.data.objects.new("Root", None)
    scene.collection.objects.link(parent)
    ob = objects.create(make_splats(), "Splats", parent=parent)
    ob.location = (1, 2, 3)
    new = make_splats(*change, seed=1)
    objects.refresh(ob, new)
    equal(objects.read(ob), new)
    assert ob.parent == parent and tuple(ob.location) == (1, 2, 3)
    objects.refresh(ob, make_splats(50))
    equal(objects.read(ob), make_splats(50))


def test_new_splats_are_not_selected(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: the marks with which the live viewport tints selected splats, after each way to add
    vertices; splats selected before a join stay selected."""
    ob = objects.create(make_splats(), "Splats")
    assert read_marks(ob.data) is None
    objects.refresh(ob, make_splats(count=40))
    assert len(ob.data.vertices) == 40 and read_marks(ob.data) is None
    points.keep(ob.data, np.arange(40) < 30)
    assert len(ob.data.vertices) == 30 and read_marks(ob.data) is None
    for count, chosen in ((35, []), (40, [7])):
        other = objects.create(make_splats(count=5), "Other")
        for vertex in chosen:
            ob.data.vertices[vertex].select = True
        bpy.context.view_layer.objects.active = ob
        for one in (ob, other):
            one.select_set(True)
        bpy.ops.gscore.join_splats()
        marks = read_marks(ob.data)
        assert len(ob.data.vertices) == count
        assert ([] if marks is None else np.flatnonzero(marks).tolist()) == chosen


def test_delete_in_edit_mode(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: the rows of unselected splats, and all rows after undo."""
    splats = make_splats()
    ob = objects.create(splats, "Splats")
    bpy.context.view_layer.objects.active = ob
    bpy.ops.ed.undo_push(message="before")
    chosen = splats.means[:, 0] > 0
    ob.data.vertices.foreach_set("select", chosen)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_mode(type="VERT")
    bpy.ops.mesh.delete(type="VERT")
    equal(objects.read(ob), splats.subset(~chosen))
    bpy.ops.object.mode_set(mode="OBJECT")
    equal(objects.read(ob), splats.subset(~chosen))
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    ob = bpy.data.objects["Splats"]
    if ob.mode == "EDIT":
        bpy.ops.object.mode_set(mode="OBJECT")
    equal(objects.read(ob), splats)


def test_vertex_added_by_hand(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: it is an invisible splat; the others stay."""
    splats = make_splats(4)
    ob = objects.create(splats, "Splats")
    ob.data.vertices.add(1)
    got = objects.read(ob)
    assert len(got) == 5
    equal(got.subset(np.arange(4)), splats)
    assert 1 / (1 + np.exp(-np.float64(got.opacities[4]))) < 1e-30
    assert np.linalg.norm(got.quats[4]) == 1


def test_world(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: transform_splats with a matrix by hand."""
    splats = make_splats()
    parent = bpy.data.objects.new("Root", None)
    scene.collection.objects.link(parent)
    parent.rotation_euler = (0.3, -1.0, 2.0)
    parent.scale = (2.5,) * 3
    ob = objects.create(splats, "Splats", parent=parent)
    ob.location = (1, -2, 0.5)
    bpy.context.view_layer.update()
    matrix = np.array([tuple(r) for r in parent.matrix_world @ ob.matrix_local], np.float64)
    wanted = transform_splats(objects.read(ob), matrix)
    got = read_world(ob)
    for name in RAW:
        np.testing.assert_allclose(getattr(got, name), getattr(wanted, name), atol=3e-6)


def test_uneven_scale_is_refused(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: the message names the object and the reason."""
    ob = objects.create(make_splats(), "Chair")
    ob.scale = (1, 1, 2)
    bpy.context.view_layer.update()
    with pytest.raises(ValueError, match=r"Chair.*unevenly"):
        read_world(ob)


@pytest.mark.parametrize("name", ["scale", "rotation", "radiance:base", "radiance:sh_2"])
def test_missing_attribute(scene: bpy.types.Scene, make_splats: Make, name: str) -> None:
    """Oracle: the message names the attribute."""
    ob = objects.create(make_splats(), "Chair")
    ob.data.attributes.remove(ob.data.attributes[name])
    with pytest.raises(ValueError, match=name):
        objects.read(ob)


def test_not_finite(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: the message names count, attribute and the first index."""
    ob = objects.create(make_splats(), "Chair")
    ob.data.attributes["scale"].data[7].vector = (1, float("nan"), 1)
    with pytest.raises(ValueError, match=r"1 splat whose scale .* number 7"):
        objects.read(ob)


def test_converted_attribute(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: an error with the name; replacing the splats restores the right type."""
    ob = objects.create(make_splats(), "Chair")
    ob.data.attributes.remove(ob.data.attributes["scale"])
    ob.data.attributes.new("scale", "FLOAT", "POINT")
    with pytest.raises(ValueError, match=r"Chair.*'scale'"):
        objects.read(ob)
    objects.refresh(ob, make_splats(seed=1))
    equal(objects.read(ob), make_splats(seed=1))


def test_other_objects(scene: bpy.types.Scene) -> None:
    """Oracle: an empty and a plain mesh have no splats."""
    empty = bpy.data.objects.new("Empty", None)
    plain = bpy.data.objects.new("Plain", bpy.data.meshes.new("Plain"))
    assert not any(objects.is_splats(ob) for ob in (None, empty, plain))
    for ob in (empty, plain):
        with pytest.raises(ValueError, match=ob.name):
            objects.read(ob)


def test_refresh_refuses_edit_mode(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: the error, and unchanged splats."""
    ob = objects.create(make_splats(), "Chair")
    bpy.context.view_layer.objects.active = ob
    bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(ValueError, match="Edit Mode"):
        objects.refresh(ob, make_splats(3))
    bpy.ops.object.mode_set(mode="OBJECT")
    equal(objects.read(ob), make_splats())


def test_blenders_own_importer_agrees(
    scene: bpy.types.Scene, make_splats: Make, tmp_path: Path
) -> None:
    """Oracle: Blender's PLY importer, which imports the file's properties as attributes."""
    splats = make_splats()
    write_splats(tmp_path / "a.ply", splats)
    ob = objects.create(read_splats(tmp_path / "a.ply"), "Ours")
    bpy.ops.wm.ply_import(filepath=str(tmp_path / "a.ply"), import_attributes=True)
    theirs = next(o for o in scene.objects if o != ob)
    if theirs.type != "MESH":  # a Blender with native splats makes them itself
        equal(objects.read(theirs), splats)
        return
    got = objects.read(ob)

    def column(name: str) -> np.ndarray:
        values = np.empty(len(theirs.data.vertices), np.float32)
        theirs.data.attributes[name].data.foreach_get("value", values)
        return values

    np.testing.assert_array_equal(got.shN[:, 2, 1], column("f_rest_17"))
    np.testing.assert_array_equal(got.sh0[:, 0, 2], column("f_dc_2"))
    np.testing.assert_array_max_ulp(got.scales[:, 1], column("scale_1"), maxulp=1)
    np.testing.assert_allclose(got.quats[:, 0], column("rot_0"), atol=2e-7)
    np.testing.assert_allclose(got.opacities, column("opacity"), rtol=1e-7, atol=2e-5)
