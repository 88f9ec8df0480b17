"""Incremental imports; oracle: the same files imported in one call."""

import re
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest

from addon.core import GsError, Splats, write_splats
from addon.process.incremental_tasks import TaskRunner
from addon.splats import importing, objects, settings, splat_files, write_chunked
from tests.addon.calls import import_splats

FIELDS = ("means", "quats", "scales", "opacities", "sh0", "shN")


@pytest.fixture(autouse=True)
def small_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """One attribute or node group per step."""
    monkeypatch.setattr(write_chunked, "BUDGET", 0.0)
    monkeypatch.setattr(settings, "BUDGET", 0.0)


@pytest.fixture
def paths(tmp_path: Path, make_splats: Callable[..., Splats]) -> list[Path]:
    """Two files of different numbers and degrees."""
    write_splats(tmp_path / "chair.ply", make_splats(300))
    write_splats(tmp_path / "table.ply", make_splats(200, rest=3, seed=1))
    return [tmp_path / "chair.ply", tmp_path / "table.ply"]


def begun(paths: list[Path], **options: object) -> TaskRunner:
    """An import with its files read."""
    wanted = [splat_files.import_request(path, **options) for path in paths]
    coming = TaskRunner(importing.importing_splats(bpy.context, wanted))
    for _ in paths:
        assert not coming.step() and coming._task.wait(60)
    return coming


def finished(coming: TaskRunner) -> list[bpy.types.Object]:
    """Complete an import; return its objects."""
    for _ in range(200):
        if coming.step():
            return coming.result.objects
    raise AssertionError("it never ends")


def until_filling(coming: TaskRunner, percent: int = 25) -> bpy.types.Mesh:
    """Step until this part is written; return the mesh that is being filled."""
    while int(re.search(r"Blender: (\d+)%|$", coming.sentence)[1] or 0) < percent:
        assert not coming.step()
    return [mesh for mesh in bpy.data.meshes if "gs_temporary" in mesh][-1]


def same(one: bpy.types.Object, other: bpy.types.Object) -> None:
    """Raise unless two objects have the same splats and transform."""
    got, wanted = objects.read(one), objects.read(other)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(got, name), getattr(wanted, name))
    assert one.matrix_basis == other.matrix_basis
    assert one.gscore.point_size == other.gscore.point_size
    assert one.parent == other.parent


@pytest.mark.parametrize("up", ["-Y", "Z"])
def test_as_at_once(scene: bpy.types.Scene, paths: list[Path], up: str) -> None:
    """Oracle: `import_splats`, to the bit; no incomplete data in the file meanwhile."""
    coming = begun(paths, up=up)
    assert "table.ply" in coming.sentence
    until_filling(coming)
    assert not bpy.data.objects and "500 splats" in coming.sentence
    made = finished(coming)
    assert [ob.name for ob in made] == [ob.data.name for ob in made] == ["chair", "table"]
    assert not any("gs_temporary" in mesh for mesh in bpy.data.meshes)
    for ob, path in zip(made, paths, strict=True):
        same(ob, import_splats(bpy.context, path, up=up))


@pytest.mark.parametrize(
    ("line", "up"),
    [
        ("", (0, -1, 0)),
        ("gscore up Y", (0, 1, 0)),
        ("Vertical Axis: z", (0, 0, 1)),
        ("Vertical Axis: -z", (0, 0, -1)),
        ("Vertical Axis: x", (1, 0, 0)),
        ("Vertical axis: y", (0, -1, 0)),
    ],
)
def test_the_axis_that_a_file_states_points_up(
    scene: bpy.types.Scene, tmp_path: Path, make_splats: Callable[..., Splats], line: str, up: tuple
) -> None:
    """Oracle: the axis of the comment, rotated to Blender's +Z; -Y without a comment."""
    write_splats(tmp_path / "a.ply", make_splats(20), comments=(line,))
    ob = import_splats(bpy.context, tmp_path / "a.ply")
    turn = np.array(ob.matrix_basis)[:3, :3]
    np.testing.assert_allclose(turn @ up, (0, 0, 1), atol=1e-6)
    assert np.linalg.det(turn) == pytest.approx(1)


def test_all_or_none(scene: bpy.types.Scene, paths: list[Path]) -> None:
    """Oracle: an empty file, and an error with the name of the broken one."""
    paths[1].write_bytes(paths[1].read_bytes()[:-100])
    with pytest.raises(GsError, match=r"table\.ply is a truncated"):
        finished(begun(paths))
    paths[1].unlink()
    with pytest.raises(GsError, match=r"table\.ply"):
        finished(begun(paths))
    assert not bpy.data.objects and not bpy.data.meshes


@pytest.mark.parametrize("name", ["import_splats", "import_camera_path", "export_camera_path"])
def test_a_folder_is_no_file(scene: bpy.types.Scene, tmp_path: Path, name: str) -> None:
    """The file browser gives its folder if no file is chosen."""
    for chosen in ("", str(tmp_path)):
        with pytest.raises(RuntimeError, match="No file is chosen"):
            getattr(bpy.ops.gscore, name)(filepath=chosen)


def test_undone_import_is_repeated(scene: bpy.types.Scene, paths: list[Path]) -> None:
    """Oracle: `import_splats`; undo removes meshes without users, complete ones too."""
    coming = begun(paths)
    bpy.data.meshes.remove(until_filling(coming))
    until_filling(coming, 75)
    for mesh in list(bpy.data.meshes):
        bpy.data.meshes.remove(mesh)
    for ob, path in zip(finished(coming), paths, strict=True):
        same(ob, import_splats(bpy.context, path))


def test_cancelled(scene: bpy.types.Scene, paths: list[Path]) -> None:
    """Oracle: the unchanged file, whether it was reading or filling."""
    coming = begun(paths)
    until_filling(coming)
    coming.cancel()
    coming = begun(paths[:1])
    coming.cancel()
    assert not bpy.data.objects and not bpy.data.meshes


def test_objects_removed_during_an_import(scene: bpy.types.Scene, paths: list[Path]) -> None:
    """Oracle: Blender's data: no parent, and the scene's own collection; without the scene none."""
    parent = bpy.data.objects.new("capture", None)
    own = bpy.data.collections.new("own")
    scene.collection.objects.link(parent)
    scene.collection.children.link(own)
    layer = bpy.context.view_layer
    layer.active_layer_collection = layer.layer_collection.children["own"]
    coming = begun(paths[:1], parent=parent)
    bpy.data.objects.remove(parent)
    bpy.data.collections.remove(own)
    ob = finished(coming)[0]
    assert ob.parent is None and ob.users_collection == (scene.collection,)
    assert "chair" in coming.result.warnings[0] and "was removed" in coming.result.warnings[0]
    same(ob, import_splats(bpy.context, paths[0]))

    other = bpy.data.scenes.new("other")
    with bpy.context.temp_override(scene=other, view_layer=other.view_layers[0]):
        coming = begun(paths[:1])
    bpy.data.scenes.remove(other)
    meshes = len(bpy.data.meshes)
    with pytest.raises(ValueError, match="scene"):
        finished(coming)
    assert len(bpy.data.meshes) == meshes
