"""Incremental exports; oracle: the same export in one call, byte by byte."""

import json
import os
import re
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from mathutils import Quaternion, Vector

from addon import attributes, preferences
from addon.core import GsError, Splats, read_splats, read_surface
from addon.process.incremental_tasks import TaskRunner, run_blocking
from addon.render.proxy import attach
from addon.splats import exporting, objects, read_chunked
from tests.addon import points
from tests.addon.calls import export_splats

Make = Callable[..., Splats]


@pytest.fixture(autouse=True)
def small_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """One attribute per step."""
    monkeypatch.setattr(read_chunked, "BUDGET", 0.0)


@pytest.fixture
def obs(scene: bpy.types.Scene, make_splats: Make) -> list[bpy.types.Object]:
    """Two objects of different SH degrees; the second is moved, the first filtered."""
    one = objects.create(make_splats(300), "chair")
    other = objects.create(make_splats(200, rest=3, seed=1), "table")
    other.location, other.scale = (5, 0, 0), (2, 2, 2)
    one.gscore.opacity_min = 0.5
    bpy.context.view_layer.update()
    return [one, other]


class Export(TaskRunner):
    """A running export."""

    def __init__(self, *what: Any, **how: Any) -> None:
        super().__init__(exporting.exporting(*what, **how))
        assert not self.step()


def finished(export: Export) -> exporting.Written:
    """Complete an export; return its result."""
    for _ in range(10_000):
        if export.step():
            return export.result
        threading.Event().wait(0.001)
    raise AssertionError("it never ends")


def nothing_left(folder: Path, *names: str) -> None:
    """Raise unless a folder has only these files, and Blender no copy of a mesh."""
    assert sorted(path.name for path in folder.iterdir()) == sorted(names)
    assert sorted(mesh.name for mesh in bpy.data.meshes) == ["chair", "table"]


@pytest.mark.parametrize("ending", [".ply", ".compressed.ply", ".spz", ".glb", ".splat"])
@pytest.mark.parametrize(("world", "filtered"), [("SOURCE", True), ("BLENDER", False)])
def test_as_at_once(obs: list, tmp_path: Path, ending: str, world: str, filtered: bool) -> None:
    """Oracle: the file of `export_splats`, its count and its warnings."""
    wanted, got = tmp_path / f"at once{ending}", tmp_path / f"bit by bit{ending}"
    reported = export_splats(obs, wanted, world=world, filtered=filtered)
    export = Export(obs, got, world=world, filtered=filtered)
    assert export.sentence == "Reading splats of chair: 0%"
    assert not export.step() and not got.exists()
    assert finished(export) == reported
    assert got.name in export.sentence
    assert got.read_bytes() == wanted.read_bytes()
    nothing_left(tmp_path, wanted.name, got.name)


def test_as_it_was(obs: list, tmp_path: Path) -> None:
    """Oracle: the file before the object was edited, moved and filtered differently."""
    export_splats(obs, tmp_path / "before.ply", filtered=True)
    export = Export(obs, tmp_path / "after.ply", world="SOURCE", filtered=True)
    assert not export.step()
    points.keep(obs[0].data, np.arange(300) < 100)
    obs[0].gscore.opacity_min = 0.0
    bpy.data.objects.remove(obs[1])
    finished(export)
    assert (tmp_path / "after.ply").read_bytes() == (tmp_path / "before.ply").read_bytes()


def test_in_edit_mode(obs: list, tmp_path: Path) -> None:
    """Oracle: the remaining points in Edit Mode, which are not yet in the mesh."""
    ob = obs[0]
    ob.gscore.opacity_min = 0.0
    means = objects.read(ob).means
    attributes.select(ob.data, np.arange(300) >= 100)
    bpy.context.view_layer.objects.active = ob
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.delete(type="VERT")
    finished(Export([ob], tmp_path / "some.ply", world="SOURCE", filtered=True))
    bpy.ops.object.mode_set(mode="OBJECT")
    np.testing.assert_array_equal(read_splats(tmp_path / "some.ply").means, means[:100])


def test_cancelled(obs: list, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the earlier file and no other: while splats are read, and while the new file is
    written."""
    out = tmp_path / "out.ply"
    out.write_bytes(b"earlier")
    export = Export(obs, out, world="SOURCE", filtered=False)
    assert not export.step()
    export.cancel()
    nothing_left(tmp_path, "out.ply")

    began, go_on = threading.Event(), threading.Event()
    write = exporting.write_splat_file

    def slow(*args: object, **options: object) -> object:
        began.set()
        assert go_on.wait(60)
        return write(*args, **options)

    monkeypatch.setattr(exporting, "write_splat_file", slow)
    export = Export(obs, out, world="SOURCE", filtered=False)
    while not began.is_set():
        assert not export.step()
    task = export._task
    export.cancel()
    go_on.set()
    assert task.wait(60) and task.cancelled
    assert out.read_bytes() == b"earlier"
    nothing_left(tmp_path, "out.ply")


def test_refuses(obs: list, tmp_path: Path) -> None:
    """Oracle: the errors of the export in one call; the earlier file is unchanged."""
    out = tmp_path / "out.ply"
    out.write_bytes(b"earlier")
    options = {"world": "SOURCE", "filtered": True}
    obs[1].scale.z = 3
    bpy.context.view_layer.update()
    with pytest.raises(ValueError, match=r"table.*unevenly"):
        Export(obs, out, **options)
    obs[0].gscore.opacity_min = 1.0
    with pytest.raises(ValueError, match=r"chair: no splats left"):
        finished(Export(obs[:1], out, **options))
    obs[0].gscore.opacity_min = 0.0
    with pytest.raises(GsError, match="Cannot write"):
        finished(Export(obs[:1], out / "below_a_file.ply", **options))
    scales = attributes.column(obs[0].data, attributes.SCALE)
    scales[7] = np.nan
    attributes.fill(obs[0].data, attributes.SCALE, "FLOAT_VECTOR", scales.ravel())
    export = Export(obs[:1], out, **options)
    with pytest.raises(ValueError, match=r"^chair has 1 splat whose scale is not finite.* 7:"):
        finished(export)
    export.cancel()
    obs[0].data.attributes.remove(obs[0].data.attributes[attributes.SCALE])
    with pytest.raises(ValueError, match=r"^chair contains no splats: the attributes scale"):
        Export(obs[:1], out, **options)
    assert out.read_bytes() == b"earlier"
    nothing_left(tmp_path, "out.ply")


CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
PLACES = np.concatenate([CORNERS, 2 * (CORNERS + 1) + [5, 0, 0]])
"""Vertices of the proxies of `obs` in Blender's world."""


def give_proxies(obs: list[bpy.types.Object]) -> None:
    """Give two objects a triangle each, with colors."""
    for number, ob in enumerate(obs):
        mesh = bpy.data.meshes.new("proxy")
        mesh.from_pydata((CORNERS + number).tolist(), [], [(0, 1, 2)])
        colors = mesh.color_attributes.new("Color", "BYTE_COLOR", "POINT")
        colors.data.foreach_set("color_srgb", np.float32([0.2, 0.4, 0.6, 1] * 3))
        mesh.color_attributes.active_color = colors
        proxy = bpy.data.objects.new("proxy", mesh)
        bpy.context.scene.collection.objects.link(proxy)
        proxy.matrix_world = ob.matrix_world
        bpy.context.view_layer.update()
        attach(bpy.context.scene, ob, proxy)


def test_proxies_are_written_beside(obs: list[bpy.types.Object], tmp_path: Path) -> None:
    """Oracle: their vertices in the coordinates of the file, both objects' as one mesh, with
    colors; a file of another program stays, and without a proxy nothing is written."""
    out = tmp_path / "a.ply"
    export = {"world": "BLENDER", "filtered": False, "proxies": True}
    with pytest.raises(ValueError, match="no proxy"):
        run_blocking(exporting.exporting(obs, out, **export))
    give_proxies(obs)
    beside = tmp_path / "a.proxy.ply"
    beside.write_text("mine")
    with pytest.raises(ValueError, match="another program"):
        run_blocking(exporting.exporting(obs, out, **export))
    assert beside.read_text() == "mine"
    beside.unlink()
    for _ in range(2):  # its own file is replaced
        run_blocking(exporting.exporting(obs, out, **export))
    written = read_surface(beside)
    np.testing.assert_allclose(written.vertices, PLACES, atol=1e-6)
    np.testing.assert_array_equal(written.triangles, [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_allclose(written.colors, [[0.2, 0.4, 0.6]] * 6, atol=1 / 255)
    run_blocking(exporting.exporting(obs, tmp_path / "a.proxy.ply", **export))
    assert len(read_surface(tmp_path / "a.proxy.proxy.ply").vertices) == 6
    run_blocking(exporting.exporting(obs, tmp_path / "a.v2.ply", **export))
    assert (tmp_path / "a.v2.proxy.ply").exists()


@pytest.mark.parametrize("ending", [".glb", ".usda"])
def test_proxies_are_in_files_that_have_meshes(
    obs: list[bpy.types.Object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str
) -> None:
    """One hidden mesh, y up beside the splats, and nothing else in the folder; of USD by the
    trainer's Python. Oracle: the JSON and numbers of the file."""
    give_proxies(obs)
    out = tmp_path / f"a{ending}"
    if ending == ".usda":
        preferences.get().python_path = os.environ["GSCORE_TRAINER_PYTHON"]
        for name in ("pxr", "pxr.UsdVol"):
            monkeypatch.setitem(sys.modules, name, None)
    run_blocking(exporting.exporting(obs, out, world="BLENDER", filtered=False, proxies=True))
    assert list(tmp_path.iterdir()) == [out]
    if ending == ".usda":
        block = out.read_text().split('def Mesh "Proxy"')[1]
        (row,) = re.findall(r"point3f\[\] points = \[(.*)\]", block)
        places = np.array(re.findall(r"[-+.\de]+", row), np.float64).reshape(-1, 3)
        assert 'purpose = "guide"' in block
        np.testing.assert_allclose(places, PLACES * [1, -1, -1], atol=1e-5)
        return
    data = out.read_bytes()
    size = int.from_bytes(data[12:16], "little")
    content, packed = json.loads(data[20 : 20 + size]), data[28 + size :]
    splats, proxy = content["nodes"]
    assert proxy["extensions"] == {"KHR_node_visibility": {"visible": False}}
    (primitive,) = content["meshes"][proxy["mesh"]]["primitives"]
    accessor = content["accessors"][primitive["attributes"]["POSITION"]]
    at = content["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
    places = np.frombuffer(packed, np.float32, 3 * accessor["count"], at).reshape(-1, 3)
    x, y, z, w = proxy["rotation"]
    turned = np.array([Quaternion((w, x, y, z)) @ Vector(one) for one in places.tolist()])
    np.testing.assert_allclose(turned, PLACES[:, [0, 2, 1]] * [1, 1, -1], atol=1e-5)
    assert splats["rotation"] == proxy["rotation"]
