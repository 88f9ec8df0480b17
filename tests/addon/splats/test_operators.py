"""Operators called by scripts. Oracle: files read with gscore, and the scene before."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from addon import preferences
from addon.core import (
    MIP_COMMENT,
    DataConfig,
    Splats,
    TrainConfig,
    collected_warnings,
    read_splats,
    transform_splats,
    write_splats,
)
from addon.panels import result
from addon.process.incremental_tasks import TaskRunner
from addon.splats import conversion, edit, exporting, objects, operators
from addon.splats.filters import visible_mask
from gscore.config_file import config_json
from gscore.formats.registry import FORMATS, format_to_write
from tests.addon.calls import export_splats, read_world
from tests.addon.drawn import drawn, labels

Make = Callable[..., Splats]
COUNT = 300
ROOT = Path(__file__).parents[3]
EXACT = ("means", "sh0", "shN")


@pytest.fixture
def ply(tmp_path: Path, make_splats: Make) -> Path:
    """A splat PLY on disk."""
    path = tmp_path / "chair.ply"
    write_splats(path, make_splats(COUNT))
    return path


@pytest.fixture
def ob(scene: bpy.types.Scene, ply: Path) -> bpy.types.Object:
    """The imported PLY, active and selected."""
    assert bpy.ops.gscore.import_splats(filepath=str(ply)) == {"FINISHED"}
    return bpy.context.object


def close(got: Splats, wanted: Splats, atol: float = 3e-6) -> None:
    """Raise unless two models have the same splats, up to the sign of quaternions."""
    for name in ("means", "scales", "sh0", "shN"):
        np.testing.assert_allclose(getattr(got, name), getattr(wanted, name), atol=atol)
    np.testing.assert_allclose(got.opacities, wanted.opacities, rtol=1e-6, atol=2e-5)
    cosines = np.abs((got.quats * wanted.quats).sum(axis=1))
    np.testing.assert_allclose(cosines, 1, atol=1e-6)


def test_import(ob: bpy.types.Object, make_splats: Make) -> None:
    """Oracle: the written splats; data in the file's world, whose -Y is up."""
    assert objects.is_splats(ob) and ob.name == "chair" and ob.select_get()
    close(objects.read(ob), make_splats(COUNT))
    up = ob.matrix_world.to_3x3() @ Matrix(((0, 0, 0), (-1, 0, 0), (0, 0, 0))).col[0]
    np.testing.assert_allclose(up, [0, 0, 1], atol=1e-7)


@pytest.mark.parametrize(
    ("axis", "vector"), [("-Y", (0, -1, 0)), ("Y", (0, 1, 0)), ("Z", (0, 0, 1))]
)
def test_up_axis(scene: bpy.types.Scene, ply: Path, axis: str, vector: tuple) -> None:
    """Oracle: the given axis becomes +Z, without mirroring."""
    bpy.ops.gscore.import_splats(filepath=str(ply), up=axis)
    matrix = np.array([tuple(r) for r in bpy.context.object.matrix_world], np.float64)[:3, :3]
    np.testing.assert_allclose(matrix @ vector, [0, 0, 1], atol=1e-7)
    assert np.linalg.det(matrix) == pytest.approx(1)


def test_import_several(scene: bpy.types.Scene, ply: Path, make_splats: Make) -> None:
    """Oracle: one object per file."""
    write_splats(ply.with_name("table.ply"), make_splats(20))
    files = [{"name": "chair.ply"}, {"name": "table.ply"}]
    bpy.ops.gscore.import_splats(directory=str(ply.parent), files=files)
    assert sorted(ob.name for ob in bpy.context.selected_objects) == ["chair", "table"]


def test_import_below_the_capture(scene: bpy.types.Scene, ply: Path) -> None:
    """Oracle: the child's matrix is the root's."""
    root = bpy.data.objects.new("Capture", None)
    root["gs_kind"] = "capture"
    root.rotation_euler, root.scale = (0.3, 0.2, 0.1), (2, 2, 2)
    scene.collection.objects.link(root)
    bpy.context.view_layer.objects.active = root
    bpy.ops.gscore.import_splats(filepath=str(ply))
    ob = bpy.context.object
    assert ob.parent == root
    bpy.context.view_layer.update()
    np.testing.assert_allclose(ob.matrix_world, root.matrix_world, atol=1e-6)


@pytest.mark.parametrize("under", [True, False])
@pytest.mark.parametrize("what", ["splats", "sequence", "edited"])
def test_splats_of_a_capture_hide_its_points(
    scene: bpy.types.Scene, ply: Path, under: bool, what: str
) -> None:
    """Oracle: the visibility of the points; those of other captures stay visible, and those in Edit
    Mode."""
    root = bpy.data.objects.new("Capture", None)
    dots = bpy.data.objects.new("Points", bpy.data.meshes.new("Points"))
    root["gs_kind"], dots["gs_kind"] = "capture", "points"
    for ob in (root, dots):
        scene.collection.objects.link(ob)
    dots.parent = root
    bpy.context.view_layer.objects.active = root
    if what == "edited":
        bpy.context.view_layer.objects.active = dots
        bpy.ops.object.mode_set(mode="EDIT")
    if what == "sequence":
        ply.rename(ply.with_name("1.ply"))
        bpy.ops.gscore.import_sequence(directory=str(ply.parent), under_capture=under)
    else:
        bpy.ops.gscore.import_splats(filepath=str(ply), under_capture=under)
    assert dots.hide_get() == (under and what != "edited")
    if what == "edited":
        bpy.ops.object.mode_set(mode="OBJECT")


@pytest.mark.parametrize("wanted", [True, False])
def test_splats_of_a_run_come_under_the_capture_it_was_trained_on(
    scene: bpy.types.Scene, ply: Path, wanted: bool
) -> None:
    """Oracle: the source in the run's config.json, with two captures in the scene and no active
    object. Without the option, or for another capture, there is no parent."""
    roots = {}
    for name in ("horse", "street"):
        roots[name] = bpy.data.objects.new(name, None)
        roots[name]["gs_kind"], roots[name]["gs_source"] = "capture", str(ply.parent / name)
        scene.collection.objects.link(roots[name])
    run = ply.parent / "run"
    run.mkdir()
    splats = ply.rename(run / "point_cloud.ply")
    data = DataConfig(source=ply.parent / "street")
    (run / "config.json").write_text(config_json(data, TrainConfig()))
    bpy.context.view_layer.objects.active = None
    bpy.ops.gscore.import_splats(filepath=str(splats), under_capture=wanted)
    assert bpy.context.object.parent == (roots["street"] if wanted else None)
    bpy.data.objects.remove(roots["street"])
    bpy.context.view_layer.objects.active = None
    bpy.ops.gscore.import_splats(filepath=str(splats))
    assert bpy.context.object.parent is None


def test_the_panel_is_about_splats_that_are_there(
    scene: bpy.types.Scene, ob: bpy.types.Object
) -> None:
    """Oracle: the only splats of the scene, with a mesh active; then none."""
    cube = bpy.data.objects.new("Cube", bpy.data.meshes.new("Cube"))
    scene.collection.objects.link(cube)
    bpy.context.view_layer.objects.active = cube
    assert scene.gscore.result is None and objects.in_question(bpy.context) == ob
    bpy.data.objects.remove(ob)
    assert objects.in_question(bpy.context) is None


def test_an_export_of_the_box_that_crops_is_of_the_splats(
    scene: bpy.types.Scene, ply: Path, tmp_path: Path
) -> None:
    """Oracle: the panel after Add Crop Box, which leaves the box active."""
    bpy.ops.gscore.import_splats(filepath=str(ply))
    ob = bpy.context.object
    bpy.ops.gscore.add_crop_box()
    assert bpy.context.object == ob.gscore.crop_object
    out = tmp_path / "boxed.ply"
    assert bpy.ops.gscore.export_splats(filepath=str(out), filtered=False) == {"FINISHED"}
    assert len(read_splats(out)) == len(ob.data.vertices)


@pytest.mark.parametrize("under", [False, True])
@pytest.mark.parametrize(("axis", "world"), [("-Y", "BLENDER"), ("Y", "BLENDER"), ("Y", "SOURCE")])
def test_an_export_lands_in_place(
    scene: bpy.types.Scene, ply: Path, tmp_path: Path, axis: str, world: str, under: bool
) -> None:
    """Oracle: the splats in Blender's world before the export, for each up axis of their file; for
    exports in Blender's world under a rotated capture too."""
    bpy.ops.gscore.import_splats(filepath=str(ply), up=axis)
    first = bpy.context.object
    bpy.context.view_layer.update()
    moved = np.array(first.matrix_world)
    wanted = objects.read(first).means @ moved[:3, :3].T + moved[:3, 3]
    bpy.ops.gscore.export_splats(filepath=str(tmp_path / "again.ply"), world=world)
    if under:
        root = bpy.data.objects.new("Capture", None)
        root["gs_kind"] = "capture"
        root.rotation_euler, root.scale = (0.3, 0.2, 0.1), (2, 2, 2)
        scene.collection.objects.link(root)
        bpy.context.view_layer.objects.active = root
        bpy.context.view_layer.update()
    bpy.ops.gscore.import_splats(filepath=str(tmp_path / "again.ply"))
    ob = bpy.context.object
    assert (ob.parent is not None) == under
    bpy.context.view_layer.update()
    matrix = np.array(ob.matrix_world)
    found = objects.read(ob).means @ matrix[:3, :3].T + matrix[:3, 3]
    if under and world == "SOURCE":  # the capture's own world, which its alignment rotates
        assert np.abs(found - wanted).max() > 0.1
    else:
        np.testing.assert_allclose(found, wanted, atol=1e-5)


@pytest.mark.parametrize("content", [b"", b"ply\nformat ascii 1.0\nend_header\n", b"hello"])
def test_bad_file(scene: bpy.types.Scene, tmp_path: Path, ply: Path, content: bytes) -> None:
    """Oracle: an error naming the file, and an unchanged scene, without the good files too."""
    (tmp_path / "bad.ply").write_bytes(content)
    with pytest.raises(RuntimeError, match=r"bad\.ply"):
        bpy.ops.gscore.import_splats(filepath=str(tmp_path / "bad.ply"))
    files = [{"name": "chair.ply"}, {"name": "bad.ply"}]
    with pytest.raises(RuntimeError, match=r"bad\.ply"):
        bpy.ops.gscore.import_splats(directory=str(tmp_path), files=files)
    with pytest.raises(RuntimeError, match=r"missing\.ply"):
        bpy.ops.gscore.import_splats(filepath=str(tmp_path / "missing.ply"))
    assert len(bpy.data.objects) == len(bpy.data.meshes) == 0


def test_untouched_round_trip(ob: bpy.types.Object, tmp_path: Path, ply: Path) -> None:
    """Oracle: the imported file, to the bit where activation does not round."""
    out = tmp_path / "out.ply"
    assert bpy.ops.gscore.export_splats(filepath=str(out)) == {"FINISHED"}
    got, wanted = read_splats(out), read_splats(ply)
    for name in EXACT:
        np.testing.assert_array_equal(getattr(got, name), getattr(wanted, name))
    np.testing.assert_array_max_ulp(got.scales, wanted.scales, maxulp=1)
    close(got, wanted)
    header = [path.read_bytes().split(b"end_header")[0] for path in (out, ply)]
    assert header[0] == header[1]


@pytest.mark.parametrize("ending", [".compressed.ply", ".spz", ".splat", ".glb", ".spz.glb"])
def test_other_formats(
    ending: str, ob: bpy.types.Object, scene: bpy.types.Scene, ply: Path, tmp_path: Path
) -> None:
    """Oracle: the imported file, to the precision of the format; the same import without its
    name."""
    out = tmp_path / f"out{ending}"
    assert bpy.ops.gscore.export_splats(filepath=str(out)) == {"FINISHED"}
    shutil.copy(out, tmp_path / "some.bin")
    for path in (out, tmp_path / "some.bin"):
        assert bpy.ops.gscore.import_splats(filepath=str(path)) == {"FINISHED"}
        got, wanted = objects.read(bpy.context.object), read_splats(ply)
        assert len(got) == len(wanted)
        by_place = [np.lexsort(s.means.round(1).T) for s in (got, wanted)]
        means = got.means[by_place[0]] - wanted.means[by_place[1]]
        assert np.median(np.abs(means)) < 2e-3


def test_every_format_that_is_written_can_be_chosen() -> None:
    """Oracle: the formats of gscore."""
    offered = [item.identifier for item in ending_items()]
    found = {format_to_write(Path(f"out{ending}")).key for ending in offered}
    assert found == {one.key for one in FORMATS if one.write} and len(offered) == len(found)


def ending_items() -> list[bpy.types.EnumPropertyItem]:
    """Endings offered by the export."""
    return list(bpy.ops.gscore.export_splats.get_rna_type().properties["ending"].enum_items)


MISSING_COPIES = pytest.mark.parametrize(
    ("ending", "package"), [(".sog", "pillow"), (".usdc", "usd-core"), (".usdz", "usd-core")]
)


@pytest.fixture
def without_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blender's bundled Python, without the packages for SOG and USD."""
    for name in ("PIL", "PIL.Image", "pxr", "pxr.UsdVol"):
        monkeypatch.setitem(sys.modules, name, None)


@MISSING_COPIES
def test_the_trainers_python_has_what_blenders_lacks(
    ending: str,
    package: str,
    ob: bpy.types.Object,
    scene: bpy.types.Scene,
    ply: Path,
    tmp_path: Path,
    without_packages: None,
) -> None:
    """Oracle: the file that the same Python writes directly from the same splats, to the byte (a
    USD zip: its size), and the splats imported from it; the mark of antialiasing."""
    python = os.environ["GSCORE_TRAINER_PYTHON"]
    preferences.get().python_path = python
    ob["gs_antialias"] = True
    out, wanted = tmp_path / f"out{ending}", tmp_path / f"wanted{ending}"
    assert bpy.ops.gscore.export_splats(filepath=str(out)) == {"FINISHED"}
    bpy.ops.gscore.export_splats(filepath=str(tmp_path / "whole.ply"))
    command = [python, "-m", "gscore", "convert", tmp_path / "whole.ply", wanted]
    subprocess.run(command, check=True, cwd=ROOT)
    same = out.stat().st_size == wanted.stat().st_size
    assert same if ending == ".usdz" else out.read_bytes() == wanted.read_bytes()
    assert bpy.ops.gscore.import_splats(filepath=str(out)) == {"FINISHED"}
    got = bpy.context.object
    assert len(got.data.vertices) == COUNT and got["gs_antialias"]
    assert [one.name for one in tmp_path.iterdir() if one.name.startswith(".")] == []


def test_an_export_by_the_trainers_python_can_be_given_up(
    ob: bpy.types.Object, tmp_path: Path, without_packages: None
) -> None:
    """Oracle: the file before, its folder, and the processes of that Python afterwards."""
    preferences.get().python_path = os.environ["GSCORE_TRAINER_PYTHON"]
    out = tmp_path / "out.sog"
    out.write_bytes(b"before")
    going = TaskRunner(exporting.exporting([ob], out, world="SOURCE", filtered=False))
    while "trainer" not in going.sentence:
        assert not going.step()
    going.cancel()
    task = going._task
    assert task is not None and task.wait(60) and task.cancelled
    assert out.read_bytes() == b"before"
    assert {one.name for one in tmp_path.iterdir()} == {"out.sog", "chair.ply"}


@MISSING_COPIES
def test_a_format_whose_package_is_missing(
    ending: str,
    package: str,
    ob: bpy.types.Object,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    without_packages: None,
) -> None:
    """Oracle: an error that names the package and the button to press, and no file: without a
    Python for training, and with one that lacks the package too."""
    out = tmp_path / f"out{ending}"
    other = conversion.OtherPython(python=None, folder=bpy.app.tempdir)
    monkeypatch.setattr(conversion, "other_python", lambda: other)
    with pytest.raises(RuntimeError, match=rf"{package}.* pip install .*Make Environment"):
        bpy.ops.gscore.export_splats(filepath=str(out))
    fake = tmp_path / "python"
    fake.write_text(
        f"#!/bin/sh\necho 'gscore convert: error: it lacks {package} too.' >&2; exit 2\n"
    )
    fake.chmod(0o755)
    monkeypatch.setattr(conversion, "other_python", lambda: replace(other, python=fake))
    with pytest.raises(RuntimeError, match=f"python: it lacks {package} too"):
        bpy.ops.gscore.export_splats(filepath=str(out))
    assert not out.exists()


def test_other_endings_are_refused(ob: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: an error that lists the formats, and no file."""
    with pytest.raises(RuntimeError, match=r"no format of splats has this ending.*\.spz"):
        bpy.ops.gscore.export_splats(filepath=str(tmp_path / "out.obj"))
    assert not (tmp_path / "out.obj").exists()


def test_untouched_below_a_root(scene: bpy.types.Scene, ply: Path, tmp_path: Path) -> None:
    """Oracle: the imported file, to the bit, whatever the root's alignment."""
    root = bpy.data.objects.new("Capture", None)
    root["gs_kind"] = "capture"
    root.rotation_euler, root.scale, root.location = (0.3, 2, 0.1), (3.3,) * 3, (100, 7, 1)
    scene.collection.objects.link(root)
    bpy.context.view_layer.objects.active = root
    bpy.ops.gscore.import_splats(filepath=str(ply))
    bpy.ops.gscore.export_splats(filepath=str(tmp_path / "out.ply"))
    for name in EXACT:
        got, wanted = read_splats(tmp_path / "out.ply"), read_splats(ply)
        np.testing.assert_array_equal(getattr(got, name), getattr(wanted, name))


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("world", ["SOURCE", "BLENDER"])
def test_moved_export(
    scene: bpy.types.Scene, ply: Path, tmp_path: Path, world: str, mirrored: bool
) -> None:
    """Oracle: transform_splats with matrices by hand in float64."""
    root = bpy.data.objects.new("Capture", None)
    root["gs_kind"] = "capture"
    root.rotation_euler, root.scale, root.location = (0.3, 2, 0.1), (1.7,) * 3, (1, 7, 1)
    scene.collection.objects.link(root)
    bpy.context.view_layer.objects.active = root
    bpy.ops.gscore.import_splats(filepath=str(ply))
    ob = bpy.context.object
    ob.location, ob.rotation_euler = (1, 2, 3), (0.5, -1, 2)
    ob.scale = (-0.8 if mirrored else 0.8, 0.8, 0.8)
    bpy.ops.gscore.export_splats(filepath=str(tmp_path / "out.ply"), world=world)
    local = np.array([tuple(r) for r in ob.matrix_basis], np.float64)
    base = np.array([tuple(r) for r in root.matrix_basis], np.float64)
    matrix = local if world == "SOURCE" else base @ local
    assert (np.linalg.det(matrix[:3, :3]) < 0) == mirrored
    close(read_splats(tmp_path / "out.ply"), transform_splats(read_splats(ply), matrix), 6e-6)


@pytest.mark.parametrize("antialiased", [False, True])
def test_antialiasing_is_kept(
    scene: bpy.types.Scene, tmp_path: Path, make_splats: Make, antialiased: bool
) -> None:
    """Oracle: the header's comment, before and after, and the mark that the engine reads."""
    comments = (MIP_COMMENT,) if antialiased else ()
    write_splats(tmp_path / "in.ply", make_splats(4), comments=comments)
    bpy.ops.gscore.import_splats(filepath=str(tmp_path / "in.ply"))
    assert bool(bpy.context.object.get("gs_antialias")) == antialiased
    bpy.ops.gscore.export_splats(filepath=str(tmp_path / "out.ply"))
    header = (tmp_path / "out.ply").read_bytes().partition(b"end_header")[0]
    assert (b"comment SplatRenderMode: mip" in header) == antialiased


def test_warnings_are_collected(tmp_path: Path, make_splats: Make) -> None:
    """Oracle: a splat that is not finite is left out, and the warning has the number."""
    splats = make_splats(10)
    splats.means[3, 1] = np.nan
    write_splats(tmp_path / "a.ply", splats)
    with collected_warnings() as warnings:
        assert len(read_splats(tmp_path / "a.ply")) == 9
    assert len(warnings) == 1 and "1 of 10 splats" in warnings[0]
    read_splats(tmp_path / "a.ply")
    assert len(warnings) == 1


def test_export_in_blenders_world(ob: bpy.types.Object, tmp_path: Path, ply: Path) -> None:
    """Oracle: the rotation of the import by hand: y becomes -z, z becomes y."""
    bpy.ops.gscore.export_splats(filepath=str(tmp_path / "out.ply"), world="BLENDER")
    x, y, z = read_splats(ply).means.T
    got = read_splats(tmp_path / "out.ply").means
    np.testing.assert_allclose(got, np.stack([x, z, -y], axis=1), atol=1e-6)


def test_export_joins(scene: bpy.types.Scene, tmp_path: Path, make_splats: Make) -> None:
    """Oracle: the active object's splats, then the other's in its world."""
    a = objects.create(make_splats(30, 15), "a")
    b = objects.create(make_splats(20, 3, seed=1), "b")
    b.location.x = 5
    bpy.context.view_layer.objects.active = a
    a.select_set(True)
    b.select_set(True)
    bpy.ops.gscore.export_splats(filepath=str(tmp_path / "out.ply"))
    got = read_splats(tmp_path / "out.ply")
    assert len(got) == 50 and got.sh_degree == 3
    close(got.subset(np.arange(30)), make_splats(30, 15))
    other = got.subset(np.arange(30, 50))
    np.testing.assert_allclose(
        other.means, make_splats(20, 3, 1).means + np.array([5, 0, 0]), atol=1e-6
    )
    np.testing.assert_allclose(other.shN[:, :3], make_splats(20, 3, 1).shN, atol=1e-6)
    assert not other.shN[:, 3:].any()


def test_export_refuses(ob: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the message names object and reason; an older file is unchanged."""
    out = tmp_path / "out.ply"
    out.write_bytes(b"older")
    ob.scale = (1, 1, 1.5)
    with pytest.raises(RuntimeError, match=r"chair.*unevenly"):
        bpy.ops.gscore.export_splats(filepath=str(out))
    ob.scale = (1, 1, 1)
    ob.gscore.opacity_min = 1.0
    with pytest.raises(RuntimeError, match=r"chair: no splats left"):
        bpy.ops.gscore.export_splats(filepath=str(out))
    assert out.read_bytes() == b"older"
    ob.gscore.opacity_min = 0.0
    with pytest.raises(RuntimeError, match="Cannot write"):
        bpy.ops.gscore.export_splats(filepath=str(out / "below_a_file.ply"))


def test_export_visible(ob: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the mask's rows, and the number of the others; all of them on request."""
    ob.gscore.opacity_min = 0.5
    keep = visible_mask(ob)
    out, means = tmp_path / "out.ply", objects.read(ob).means
    bpy.ops.gscore.export_splats(filepath=str(out))
    np.testing.assert_array_equal(read_splats(out).means, means[keep])
    assert len(ob.data.vertices) == COUNT
    _, notes = export_splats([ob], out, filtered=True)
    assert notes == (f"{COUNT - keep.sum():,} splats that the filters hide were left out.",)
    bpy.ops.gscore.export_splats(filepath=str(out), filtered=False)
    np.testing.assert_array_equal(read_splats(out).means, means)


def test_apply_filters(ob: bpy.types.Object) -> None:
    """Oracle: the visible rows, to the bit, including a user's attribute."""
    own = ob.data.attributes.new("mine", "INT", "POINT")
    own.data.foreach_set("value", np.arange(COUNT, dtype=np.int32))
    flag = ob.data.attributes.new("flag", "BOOLEAN", "POINT")
    flag.data.foreach_set("value", np.arange(COUNT) % 2 == 0)
    ob.gscore.size_max = 0.1
    keep = visible_mask(ob)
    before = objects.read(ob)
    assert 20 < keep.sum() < COUNT - 20
    assert bpy.ops.gscore.apply_filters() == {"FINISHED"}
    after = objects.read(ob)
    for name in ("means", "quats", "scales", "opacities", "sh0", "shN"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name)[keep])
    values = np.empty(len(after), np.int32)
    ob.data.attributes["mine"].data.foreach_get("value", values)
    np.testing.assert_array_equal(values, np.flatnonzero(keep))
    flags = np.empty(len(after), bool)
    ob.data.attributes["flag"].data.foreach_get("value", flags)
    np.testing.assert_array_equal(flags, np.flatnonzero(keep) % 2 == 0)
    assert ob.gscore.size_max == 0


def test_apply_filters_and_undo(ob: bpy.types.Object) -> None:
    """Oracle: one undo restores all splats and the filter."""
    before = objects.read(ob)
    ob.gscore.opacity_min = 0.5
    bpy.ops.ed.undo_push(message="filter set")
    bpy.ops.gscore.apply_filters()
    bpy.ops.ed.undo_push(message="applied")
    assert len(bpy.data.objects["chair"].data.vertices) < COUNT
    bpy.ops.ed.undo()
    again = bpy.data.objects["chair"]
    np.testing.assert_array_equal(objects.read(again).shN, before.shN)
    assert again.gscore.opacity_min == 0.5


def test_apply_filters_refuses(ob: bpy.types.Object) -> None:
    """Oracle: hiding everything is refused, and all splats stay."""
    ob.gscore.opacity_min = 1.0
    with pytest.raises(RuntimeError, match="hide every splat"):
        bpy.ops.gscore.apply_filters()
    assert len(ob.data.vertices) == COUNT


@pytest.mark.parametrize("which", ["HIDDEN", "VISIBLE"])
def test_select_and_delete(ob: bpy.types.Object, which: str) -> None:
    """Oracle: deleting the selection in Edit Mode leaves the other splats."""
    ob.gscore.opacity_min = 0.5
    keep = visible_mask(ob)
    before = objects.read(ob)
    bpy.ops.gscore.select_splats(which=which)
    assert ob.mode == "EDIT"
    bpy.ops.mesh.delete(type="VERT")
    bpy.ops.object.mode_set(mode="OBJECT")
    left = keep if which == "HIDDEN" else ~keep
    np.testing.assert_array_equal(objects.read(ob).means, before.means[left])


def test_select_from_edit_mode(ob: bpy.types.Object) -> None:
    """Oracle: splats deleted earlier in the same edit are gone, and the selection fits the rest."""
    bpy.ops.gscore.select_splats(which="HIDDEN")  # nothing is hidden
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.delete(type="VERT")
    bpy.ops.gscore.select_splats(which="VISIBLE")
    bpy.ops.object.mode_set(mode="OBJECT")
    assert len(ob.data.vertices) == 0
    assert len(objects.read(ob)) == 0


def test_crop_box(ob: bpy.types.Object) -> None:
    """Oracle: most splats are inside the box, by its corners in the scene."""
    bpy.ops.gscore.add_crop_box()
    box = ob.gscore.crop_object
    assert box.hide_render and box.display_type == "WIRE"
    assert 0.8 * COUNT < visible_mask(ob).sum() < COUNT
    box.scale.x *= 0.5
    bpy.context.view_layer.update()
    inside = [
        all(abs(v) <= 1 for v in box.matrix_world.inverted() @ (ob.matrix_world @ vertex.co))
        for vertex in ob.data.vertices
    ]
    np.testing.assert_array_equal(visible_mask(ob), inside)
    bpy.ops.gscore.reset_filters()
    assert ob.gscore.crop_object is None and visible_mask(ob).all()


def test_a_crop_box_stands_upright_and_is_at_hand(ob: bpy.types.Object) -> None:
    """Oracle: the world's axes, for splats rotated by an import and a user; Blender's selection;
    the filters' operators work on the splats while the box is active."""
    ob.rotation_euler, ob.scale = (0.4, 0.7, -0.2), (3, 3, 3)
    bpy.context.view_layer.update()
    bpy.ops.gscore.add_crop_box()
    box = ob.gscore.crop_object
    turn = np.array(box.matrix_world.to_3x3())
    np.testing.assert_allclose(turn - np.diag(np.diag(turn)), 0, atol=1e-5)
    assert bpy.context.object == box and bpy.context.selected_objects == [box]
    assert 0.8 * COUNT < visible_mask(ob).sum() < COUNT
    assert objects.active_splats(bpy.context) == ob == objects.in_question(bpy.context)
    assert "(Delete Hidden Splats)" in drawn(result.FiltersPanel)
    bpy.ops.gscore.select_splats(which="VISIBLE")
    assert bpy.context.object == ob and ob.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    ob.select_set(False)
    bpy.context.view_layer.objects.active = box
    left = int(visible_mask(ob).sum())
    bpy.ops.gscore.apply_filters()
    assert len(ob.data.vertices) == left


@pytest.mark.parametrize("parented", [False, True])
def test_an_uneven_scale_is_made_even(ob: bpy.types.Object, parented: bool) -> None:
    """Oracle: the determinant, which is the volume, and that the splats can be read in the world; a
    mirrored object stays mirrored."""
    stretched = ob
    if parented:
        stretched = bpy.data.objects.new("parent", None)
        bpy.context.collection.objects.link(stretched)
        ob.parent, ob.rotation_euler = stretched, (0.3, 0.2, 0.1)
    stretched.scale = (-1, 2, 4)
    bpy.context.view_layer.update()
    with pytest.raises(ValueError, match="scale"):
        read_world(ob)
    assert not operators.is_even(ob)
    bpy.ops.gscore.make_scale_even()
    assert ob.matrix_world.to_3x3().determinant() == pytest.approx(-8, rel=1e-5)
    read_world(ob)
    assert operators.is_even(ob)


def test_a_stretch_that_no_scale_explains_is_refused(ob: bpy.types.Object) -> None:
    """Oracle: the error, and an unchanged scale: the stretch is in the parent's inverse."""
    parent = bpy.data.objects.new("parent", None)
    bpy.context.collection.objects.link(parent)
    ob.parent, ob.matrix_parent_inverse = parent, Matrix.Diagonal((1, 2, 3, 1))
    ob.scale = (1, 1, 2)
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="Clear Parent Inverse"):
        bpy.ops.gscore.make_scale_even()
    assert tuple(ob.scale) == (1, 1, 2)


def test_limits_that_are_off_say_so(ob: bpy.types.Object) -> None:
    """Oracle: 0 means no limit, as in the property's description."""
    assert {"Maximum Size (off)", "Minimum Opacity (off)"} <= set(labels(result.FiltersPanel))
    ob.gscore.size_max = 0.5
    assert "Maximum Size" in labels(result.FiltersPanel)


def test_apply_transform(ob: bpy.types.Object) -> None:
    """Oracle: the splats in the world are the same, and the object's matrix is the identity."""
    ob.location, ob.scale = (1, 2, 3), (-2, 2, 2)
    bpy.context.view_layer.update()
    before = read_world(ob)
    assert bpy.ops.gscore.apply_splat_transform() == {"FINISHED"}
    bpy.context.view_layer.update()
    np.testing.assert_array_equal(ob.matrix_world, np.eye(4))
    close(objects.read(ob), before)
    ob.scale = (1, 2, 1)
    with pytest.raises(RuntimeError, match="unevenly"):
        bpy.ops.gscore.apply_splat_transform()


def test_applied_transform_leaves_children_in_place(ob: bpy.types.Object) -> None:
    """Oracle: the crop box in the world is the same, and so are the splats that it shows."""
    bpy.ops.gscore.add_crop_box()
    box = bpy.context.view_layer.objects.active
    ob.location, ob.rotation_euler, ob.scale = (1, 2, 3), (0.1, 0.2, 0.3), (-2, 2, 2)
    bpy.context.view_layer.update()
    place, shown = np.array(box.matrix_world), visible_mask(ob)
    assert shown.any() and not shown.all()
    assert bpy.ops.gscore.apply_splat_transform() == {"FINISHED"}
    bpy.context.view_layer.update()
    np.testing.assert_allclose(box.matrix_world, place, atol=1e-5)
    np.testing.assert_array_equal(visible_mask(ob), shown)


def test_applied_transform_still_knows_its_source(ob: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the file in the source's world is the same before and after applying."""
    ob.rotation_euler.z = 1
    bpy.ops.gscore.export_splats(filepath=str(tmp_path / "before.ply"))
    bpy.ops.gscore.apply_splat_transform()
    bpy.ops.gscore.export_splats(filepath=str(tmp_path / "after.ply"))
    close(read_splats(tmp_path / "after.ply"), read_splats(tmp_path / "before.ply"))


def test_reset_display(ob: bpy.types.Object) -> None:
    """Oracle: one modifier again, with the object's settings."""
    ob.gscore.opacity_min = 0.5
    ob.modifiers.clear()
    bpy.ops.gscore.reset_display()
    bpy.ops.gscore.reset_display()
    assert len(ob.modifiers) == 1
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert edit.stats(ob, depsgraph).visible == visible_mask(ob).sum() < COUNT


def test_exporter_of_a_collection(ob: bpy.types.Object, make_splats: Make, tmp_path: Path) -> None:
    """Oracle: the splats in the collection, although others are active and selected."""
    collection = bpy.data.collections.new("Some")
    bpy.context.scene.collection.children.link(collection)
    objects.create(make_splats(20, seed=1), "in it", collection=collection)
    layer = bpy.context.view_layer.layer_collection.children["Some"]
    bpy.context.view_layer.active_layer_collection = layer
    bpy.ops.collection.exporter_add(name="GSCORE_FH_splats")
    collection.exporters[0].export_properties.filepath = str(tmp_path / "some.ply")
    for active in (ob, None):
        bpy.context.view_layer.objects.active = active
        bpy.ops.collection.exporter_export(index=0)
        close(read_splats(tmp_path / "some.ply"), make_splats(20, seed=1))
        (tmp_path / "some.ply").unlink()
    with pytest.raises(RuntimeError, match="no collection"):
        bpy.ops.gscore.export_splats(filepath=str(tmp_path / "some.ply"), collection="none")


def test_only_on_splats(scene: bpy.types.Scene) -> None:
    """Oracle: no operator runs without a splat object."""
    for name in (
        "export_splats",
        "apply_filters",
        "reset_filters",
        "select_splats",
        "add_crop_box",
        "apply_splat_transform",
        "reset_display",
        "take_native_splats",
    ):
        assert not getattr(bpy.ops.gscore, name).poll(), name


def test_edit_mode_is_refused(ob: bpy.types.Object) -> None:
    """Oracle: the message says to leave Edit Mode; export works in it."""
    bpy.ops.object.mode_set(mode="EDIT")
    for name in ("apply_filters", "apply_splat_transform"):
        with pytest.raises(RuntimeError, match="Edit Mode"):
            getattr(bpy.ops.gscore, name)()
    bpy.ops.object.mode_set(mode="OBJECT")
    assert len(ob.data.vertices) == COUNT


def test_import_and_undo(scene: bpy.types.Scene, ply: Path) -> None:
    """Oracle: the scene before; existing data are unchanged to the bit."""
    bpy.ops.gscore.import_splats(filepath=str(ply))
    before = objects.read(bpy.data.objects["chair"])
    bpy.ops.ed.undo_push(message="first")
    bpy.ops.gscore.import_splats(filepath=str(ply))
    bpy.ops.ed.undo_push(message="second")
    assert len(bpy.data.objects) == 2
    bpy.ops.ed.undo()
    assert [ob.name for ob in bpy.data.objects] == ["chair"]
    np.testing.assert_array_equal(objects.read(bpy.data.objects["chair"]).shN, before.shN)


def test_drop_handler(scene: bpy.types.Scene) -> None:
    """Oracle: Blender has a handler that calls the add-on's import, for every format of gscore."""
    handler = bpy.types.GSCORE_FH_splats
    assert handler.bl_import_operator == "gscore.import_splats"
    endings = handler.bl_file_extensions.split(";")
    assert sorted(endings) == sorted(set(endings))
    wanted = {Path(f"a{ending}").suffix for one in FORMATS for ending in one.endings}
    assert set(endings) == wanted - {".json"}, "meta.json is dropped as any JSON would be"
