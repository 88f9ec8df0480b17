"""Incremental import of cameras, and repeated imports. Oracle: the files, and the same import in
one call."""

import gc
import shutil
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from addon.cameras import capture_transform, importing, sfm_points
from addon.cameras import objects as co
from addon.cameras.backgrounds import file_of, photo_of
from addon.cameras.objects import cameras_of, points_of
from addon.compat import matrix_to_numpy
from addon.core import read_colmap, write_colmap
from addon.interface import incremental_removal, temporary_data
from addon.panels.cameras import CamerasPanel
from addon.process.incremental_tasks import TaskRunner
from tests.addon.calls import import_capture
from tests.addon.captures import STUDIO
from tests.addon.drawn import drawn
from tools.measure.windowless import windowless

KINDS = ("objects", "cameras", "meshes", "collections", "images", "scenes")


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """One camera per step."""
    monkeypatch.setattr(importing, "BUDGET", 0.0)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A capture that may be changed."""
    shutil.copytree(STUDIO, tmp_path / "studio")
    return tmp_path / "studio"


def counts() -> dict[str, int]:
    """Number of datablocks."""
    return {kind: len(getattr(bpy.data, kind)) for kind in KINDS}


def state() -> dict[str, Any]:
    """All data made by an import, and the other objects of the scene."""
    found: dict[str, Any] = {}
    for ob in bpy.context.scene.objects:
        props = {k: v.to_list() if hasattr(v, "to_list") else v for k, v in ob.items()}
        stands = [tuple(row) for row in ob.matrix_basis], ob.parent and ob.parent.name
        found[ob.name] = props, stands, [c.name for c in ob.users_collection]
        if ob.type == "CAMERA":
            image = photo_of(ob)
            found[f"{ob.name} lens"] = co.lens_of(ob.data), image and file_of(image)
            found[f"{ob.name} drawn"] = ob.data.display_size, ob.data.clip_start, ob.data.name
        if ob.type == "MESH":
            found[f"{ob.name} points"] = [
                read(ob).tobytes() for read in (sfm_points.positions_of, sfm_points.linear_of)
            ]
            found[f"{ob.name} shown"] = [m.node_group.name for m in ob.modifiers], ob.hide_render
    return found


def going(**settings: Any) -> TaskRunner:
    """The operator in a window, before its first step."""
    return TaskRunner(windowless("import_cameras", **settings).steps(bpy.context))


def until(work: TaskRunner, ends: Callable[[], bool]) -> bool:
    """Run steps until a condition is true, or all are done; return whether it is true."""
    for _ in range(10_000):
        if ends():
            return False
        if work.step():
            return True
        threading.Event().wait(0.0005)
    raise AssertionError("it never ends")


def half() -> bool:
    """Whether some, but not all, of the cameras are made."""
    return len(bpy.data.cameras) > 30


def test_bit_by_bit_as_at_once(scene, folder: Path) -> None:
    """Equal to the bit; the scene shows nothing of it meanwhile, and steps report the progress."""
    import_capture(scene, folder)
    at_once = state()
    bpy.ops.wm.read_homefile(use_empty=True)
    work = going(directory=str(folder))
    assert not until(work, half)
    assert not bpy.context.scene.objects and "of 60" in work.sentence
    assert until(work, lambda: False)
    assert work.result == "studio: 60 cameras, 6,725 points"
    assert state() == at_once and bpy.context.object.name == "studio"
    assert not any("gs_temporary" in one for one in bpy.data.collections)


@pytest.mark.parametrize("name", ["reading", "cameras", "points"])
def test_given_up(scene, folder: Path, name: str) -> None:
    """Oracle: the counts of all data before."""
    before = counts()
    work = going(directory=str(folder))
    until(work, {"reading": lambda: True, "cameras": half, "points": _points_come}[name])
    work.cancel()
    incremental_removal.finish()
    assert counts() == before
    scene.gscore.capture_path = str(folder)
    import_capture(scene, folder)
    there, seen = counts(), state()
    shutil.rmtree(folder / "images")
    work = going(directory=str(folder))
    until(work, {"reading": lambda: True, "cameras": _begun, "points": _points_come}[name])
    work.cancel()
    incremental_removal.finish()
    assert counts() == there and state() == seen


def _begun() -> bool:
    return any("gs_temporary" in one for one in bpy.data.collections)


def _points_come() -> bool:
    own = [one for one in bpy.data.collections if "gs_temporary" in one]
    return any(co.is_kind(ob, "points") for one in own for ob in one.objects)


def test_undone_import_is_repeated(scene, folder: Path) -> None:
    """Oracle: the import in one call."""
    import_capture(scene, folder)
    at_once = state()
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.ed.undo_push(message="start")
    bpy.context.scene.frame_end = 77
    bpy.ops.ed.undo_push(message="a frame")
    work = going(directory=str(folder))
    until(work, half)
    bpy.ops.ed.undo_push(message="meanwhile")
    bpy.ops.ed.undo()
    bpy.ops.ed.undo()
    assert not _begun() and bpy.context.scene.frame_end != 77
    until(work, lambda: False)
    assert state() == at_once
    bpy.ops.ed.undo_push(message="imported")
    bpy.ops.ed.undo()
    assert not bpy.context.scene.objects and not _begun()


def test_redo_of_what_was_there_meanwhile(scene, folder: Path) -> None:
    """Oracle: no data of the import after the redo of a step made meanwhile."""
    bpy.ops.ed.undo_push(message="start")
    work = going(directory=str(folder))
    until(work, half)
    bpy.ops.ed.undo_push(message="meanwhile")
    until(work, lambda: False)
    bpy.ops.ed.undo_push(message="imported")
    bpy.ops.ed.undo()
    assert not bpy.data.cameras and not _begun()


def test_a_file_that_is_saved_meanwhile(scene, folder: Path, tmp_path: Path) -> None:
    """Oracle: the file that was opened again."""
    work = going(directory=str(folder))
    until(work, half)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    work.cancel()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert not bpy.data.objects and not bpy.data.cameras and not _begun()


@pytest.mark.parametrize("ends", ["saved", "closed", "imported", "undone"])
def test_cancelled_import_leaves_no_data_or_names(
    scene, folder: Path, tmp_path: Path, ends: str
) -> None:
    """Incremental removal. Oracle: none of it is in the file, or blocks a name."""
    bpy.ops.ed.undo_push(message="start")
    work = going(directory=str(folder))
    until(work, half)
    bpy.ops.ed.undo_push(message="meanwhile")
    made = len(bpy.data.cameras)
    work.cancel()
    next(incremental_removal.clearing())
    assert len(bpy.data.cameras) < made
    if ends == "saved":
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    elif ends == "closed":
        bpy.ops.wm.read_homefile(use_empty=True)
    elif ends == "imported":
        assert until(going(directory=str(folder)), lambda: False)
        assert {"studio", "view_000"} <= set(bpy.context.scene.objects.keys())
        return
    else:
        bpy.ops.ed.undo()
        incremental_removal.finish()
    assert not bpy.data.objects and not bpy.data.cameras and not _begun()
    assert not bpy.data.images or ends == "undone"


def test_photos_that_are_gone_leave_bit_by_bit(
    scene, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: cameras removed from the scene, then from the file; undo restores them, and redo
    removes them."""
    monkeypatch.setattr(temporary_data, "BUDGET", 0.0)
    made = import_capture(scene, folder)
    child = bpy.data.objects.new("child", None)
    scene.collection.objects.link(child)
    child.parent, scene.camera = made.cameras[40], made.cameras[40]
    bpy.ops.ed.undo_push(message="imported")
    model = read_colmap(folder)
    kept = sorted(model.images, key=lambda image: image.name)[:5]
    write_colmap(replace(model, images=kept), folder / "sparse" / "0")
    assert until(going(directory=str(folder)), lambda: False)
    root = bpy.data.objects["studio"]
    assert len(bpy.data.cameras) == 60 and len(cameras_of(root)) == 5
    assert len([ob for ob in scene.objects if ob.type == "CAMERA"]) == 5
    bpy.ops.ed.undo_push(message="anew")
    assert len(list(incremental_removal.clearing())) > 2
    assert len(bpy.data.cameras) == 5 and not _begun() and scene.camera is None
    assert child.parent is None
    bpy.ops.ed.undo()
    assert len(cameras_of(bpy.data.objects["studio"])) == 60
    assert bpy.context.scene.camera.name == "view_040"
    bpy.ops.ed.redo()
    assert len(bpy.data.cameras) == 5 and not _begun()


def test_a_scene_that_is_gone(scene, folder: Path) -> None:
    """Oracle: a sentence; nothing is left."""
    bpy.ops.scene.new()
    work = going(directory=str(folder))
    until(work, half)
    bpy.data.scenes.remove(bpy.context.scene)
    with pytest.raises(ValueError, match="scene of this import was removed"):
        until(work, lambda: False)
    incremental_removal.finish()
    assert not bpy.data.objects and not bpy.data.cameras and not _begun()


def test_anew(scene, folder: Path) -> None:
    """Oracle: the current files. The user's data stay: the empty with its alignment and children,
    names, collections, and users of a camera."""
    made = import_capture(scene, folder, align=False)
    capture_transform.set_extent(made.root, 12.5)
    model, listed = read_colmap(folder), made.cameras
    matrix = matrix_to_numpy(made.root.matrix_basis)
    splats = bpy.data.objects.new("splats", None)
    scene.collection.objects.link(splats)
    splats.parent, scene.camera = made.root, listed[5]
    own = bpy.data.collections.new("own")
    scene.collection.children.link(own)
    own.objects.link(listed[6])
    listed[5].name, listed[5].location.x, listed[6].data.lens = "hero", 99.0, 12.0
    listed[7].data.dof.use_dof = True
    del listed[8]["gs_K"]
    bpy.data.cameras.remove(listed[9].data)  # and the object
    gone = listed[10].name
    made.points.hide_viewport, made.points.name = True, "cloud"
    made.points.data.vertices.add(3)
    images = [replace(one, tvec=one.tvec + 0.5) for one in model.images[:30]]
    kept = [*images, *(one for one in model.images[30:])]
    write_colmap(
        replace(model, images=[one for one in kept if one.name != "view_010.jpg"]),
        folder / "sparse" / "0",
    )
    again = import_capture(scene, folder)
    assert again.renewed and again.root == made.root and len(again.cameras) == 59
    np.testing.assert_array_equal(matrix_to_numpy(again.root.matrix_basis), matrix)
    assert splats.parent == again.root and gone not in bpy.data.objects
    assert scene.camera.name == "hero" and own in again.cameras[6].users_collection
    assert again.cameras[7].data.dof.use_dof and "view_009" in bpy.data.objects
    by_name = {image.name: image for image in read_colmap(folder).images}
    for ob in again.cameras:
        stated = co.photo_camera_of(ob)
        np.testing.assert_array_equal(stated.viewmat, by_name[stated.image].viewmat)
        assert not co.is_moved(ob, stated) and not co.is_lens_changed(ob.data, stated)
        assert ob.data.clip_end == pytest.approx(again.cameras[0].data.clip_end)
        assert photo_of(ob) is not None
    assert again.points.name == "cloud" and again.points.hide_viewport
    assert len(again.points.data.vertices) == len(model.points)
    assert "poses in the files have changed" in again.warnings[-1]
    assert [one.name for one in bpy.data.collections if "studio" in one.name] == [
        "studio",
        "studio cameras",
    ]
    assert len(bpy.data.meshes) == 1 and len(bpy.data.cameras) == 59
    before = state()
    third = import_capture(scene, folder)
    assert state() == before and len(third.warnings) == len(again.warnings) - 1


def test_a_capture_that_is_removed_meanwhile(scene, folder: Path) -> None:
    """Or only its empty, or there was none and one was added. Oracle: the import in one call."""
    made = import_capture(scene, folder)
    at_once = state()
    work = going(directory=str(folder))
    until(work, _begun)
    bpy.data.batch_remove([*made.cameras, made.root, made.points])
    assert until(work, lambda: False) and work.result == "studio: 60 cameras, 6,725 points"
    assert state().keys() == at_once.keys()
    work = going(directory=str(folder))
    until(work, _begun)
    bpy.data.objects.remove(bpy.data.objects["studio"])
    assert until(work, lambda: False) and work.result.endswith(": 60 cameras, 6,725 points")


def test_two_imports_at_once(scene, folder: Path) -> None:
    """Oracle: one set of cameras and of images, as of one import."""
    works = [going(directory=str(folder)), going(directory=str(folder))]
    while works:
        works = [work for work in works if not work.step()]
        threading.Event().wait(0.0005)
    incremental_removal.finish()
    found = [len(all_of) for all_of in (bpy.data.cameras, bpy.data.images, bpy.data.meshes)]
    assert found == [60, 60, 1] and not _begun()


def test_another_mesh_is_edited_meanwhile(scene, folder: Path) -> None:
    """Oracle: the mode and the active object; the user can leave it."""
    mesh = bpy.data.objects.new("mesh", bpy.data.meshes.new("mesh"))
    scene.collection.objects.link(mesh)
    work = going(directory=str(folder))
    until(work, half)
    bpy.context.view_layer.objects.active = mesh
    bpy.ops.object.mode_set(mode="EDIT")
    assert until(work, lambda: False)
    assert bpy.context.view_layer.objects.active == mesh and mesh.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    assert len(cameras_of(bpy.data.objects["studio"])) == 60


def test_a_collection_that_is_left_out(scene, folder: Path) -> None:
    """Oracle: the camera is updated, and the selection stays."""
    made = import_capture(scene, folder)
    other = bpy.data.objects.new("other", None)
    scene.collection.objects.link(other)
    bpy.context.view_layer.objects.active = other
    made.cameras[0].location.x = 99
    layers = bpy.context.view_layer.layer_collection.children
    layers[made.collection.name].exclude = True
    assert bpy.ops.gscore.import_cameras(directory=str(folder)) == {"FINISHED"}
    assert bpy.data.objects["view_000"].location.x != 99
    assert bpy.context.view_layer.objects.active == other


def test_cameras_that_another_scene_has_too(scene, folder: Path) -> None:
    """Oracle: new cameras are only in the scene of the import."""
    made = import_capture(scene, folder)
    other = bpy.data.scenes.new("Other")
    shared = bpy.data.collections.new("a")  # before those of the capture
    other.collection.children.link(shared)
    inside = made.cameras[0].users_collection[0]
    for ob in made.cameras[:5]:
        shared.objects.link(ob)
    bpy.data.cameras.remove(made.cameras[9].data)
    import_capture(scene, folder)
    assert list(bpy.data.objects["view_009"].users_collection) == [inside]
    bpy.data.cameras.remove(bpy.data.objects["view_009"].data)
    for ob in cameras_of(made.root):
        scene.collection.objects.link(ob)
        inside.objects.unlink(ob)
    bpy.context.window.scene = other
    import_capture(scene, folder)
    bpy.context.window.scene = scene
    assert list(bpy.data.objects["view_009"].users_collection) == [scene.collection]


def test_reimport_resets_deltas_and_keeps_animation(scene, folder: Path) -> None:
    """Deltas are removed; keyframes and constraints stay, with a warning. Oracle: Blender's own
    matrices."""
    listed = import_capture(scene, folder).cameras
    bpy.context.view_layer.update()
    before = [matrix_to_numpy(ob.matrix_world) for ob in listed]
    listed[0].delta_location.x = 9
    listed[1].delta_scale.x, listed[2].delta_rotation_quaternion = 2, (0, 1, 0, 0)
    listed[2].delta_rotation_euler.x = 1
    for ob in listed[3:8]:
        ob.location.x = 50
        ob.keyframe_insert("location", frame=1)
    limit = listed[8].constraints.new("LIMIT_LOCATION")
    limit.use_min_x, limit.min_x = True, 99
    made = import_capture(scene, folder)
    (reported,) = made.warnings
    assert "view_003, view_004, view_005 and 3 more." in reported
    scene.frame_set(2)
    bpy.context.view_layer.update()
    far = [np.abs(matrix_to_numpy(ob.matrix_world) - was).max()
           for ob, was in zip(listed, before, strict=True)]  # fmt: skip
    assert [i for i, distance in enumerate(far) if distance > 1e-5] == [3, 4, 5, 6, 7, 8]
    listed[2].rotation_mode = "XYZ"
    assert tuple(listed[2].delta_rotation_euler) == (0, 0, 0)
    for ob in listed[3:9]:
        ob.animation_data_clear()
        ob.constraints.clear()
    assert not import_capture(scene, folder).warnings


def test_reimport_writes_changed_properties_only(scene, folder: Path) -> None:
    """Every changed property of a camera, and no other. Oracle: the scene before."""
    listed = import_capture(scene, folder).cameras
    before = state()
    listed[0].rotation_mode, listed[0].location.x = "XYZ", 5.0
    listed[1].rotation_mode, listed[1].rotation_axis_angle = "AXIS_ANGLE", (1.0, 0.0, 0.0, 1.0)
    listed[2].scale.x, listed[3].rotation_quaternion.w = 2.0, 0.5
    listed[4].data.type, listed[5].data.shift_y = "ORTHO", 0.3
    listed[6]["gs_photo_size"], listed[7]["gs_size"] = [4, 3], "large"
    listed[8]["gs_K"] = [*listed[8]["gs_K"][:8], 2.0]
    listed[9].matrix_parent_inverse[0][3] = 5.0
    listed[10].data.passepartout_alpha = 0.25
    assert state() != before
    import_capture(scene, folder)
    assert state() == before and listed[10].data.passepartout_alpha == 0.25
    assert {ob.rotation_mode for ob in listed} == {"QUATERNION"}


def test_a_camera_that_is_renamed_meanwhile(scene, folder: Path) -> None:
    """It is not found during the comparison. Oracle: it is updated to the files nevertheless."""
    import_capture(scene, folder)
    work = going(directory=str(folder))
    until(work, _begun)
    late = cameras_of(bpy.data.objects["studio"])[-1]
    late.name, late.location.x = "late", 99.0
    assert until(work, lambda: False)
    assert len(bpy.data.cameras) == 60 and not co.is_moved(late, co.photo_camera_of(late))


@pytest.mark.parametrize("what", ["moved", "replaced"])
def test_a_camera_that_is_changed_after_it_was_compared(
    scene, folder: Path, monkeypatch, what: str
) -> None:
    """Oracle: the import in one call: all data match the files, whatever was moved meanwhile."""
    camera = import_capture(scene, folder).cameras[0]
    before = state()
    camera.data.lens += 3
    done, compare = [], importing._PendingCapture._compare
    monkeypatch.setattr(
        importing._PendingCapture, "_compare", lambda *given: (compare(*given), done.append(given))
    )
    work = going(directory=str(folder))
    assert not until(work, lambda: len(done) >= 30)
    name = camera.name
    if what == "replaced":
        other = camera.copy()
        other.data = camera.data.copy()
        scene.collection.objects.link(other)
        scene.collection.objects.unlink(other)
        camera.users_collection[0].objects.link(other)
        data = camera.data
        bpy.data.objects.remove(camera)
        data_name = data.name
        bpy.data.cameras.remove(data)
        camera = other
        camera.name, camera.data.name, camera.data.shift_x = name, data_name, 0.5
    camera.location.x += 99
    assert until(work, lambda: False)
    assert state() == before


def test_points_that_another_object_shows_too(scene, folder: Path) -> None:
    """Oracle: it keeps the earlier points, also after the removal of unused data."""
    made = import_capture(scene, folder)
    twin = made.points.copy()
    scene.collection.objects.link(twin)
    made.points.data.vertices.add(3)
    assert import_capture(scene, folder).points == made.points
    assert len(twin.data.vertices) == len(made.points.data.vertices) + 3
    assert len(bpy.data.meshes) == 2 and not _begun()


@pytest.mark.parametrize("ends", ["done", "esc", "fails"])
def test_python_searches_for_garbage_again(scene, folder: Path, ends: str) -> None:
    """Not during the import, when it takes long. Oracle: the threshold of full collections."""
    before = gc.get_threshold()
    work = going(directory=str(folder))
    assert not until(work, half) and gc.get_threshold()[2] > before[2]
    if ends == "esc":
        work.cancel()
    elif ends == "fails":
        bpy.ops.scene.new()
        bpy.data.scenes.remove(scene)
        with pytest.raises(ValueError, match="was removed"):
            until(work, lambda: False)
    else:
        until(work, lambda: False)
    assert gc.get_threshold() == before
    incremental_removal.finish()


def test_points_that_are_edited(scene, folder: Path) -> None:
    """Oracle: an error; nothing is changed."""
    made = import_capture(scene, folder)
    bpy.context.view_layer.objects.active = made.points
    bpy.ops.object.mode_set(mode="EDIT")
    before = counts()
    with pytest.raises(RuntimeError, match="studio points is in Edit Mode"):
        bpy.ops.gscore.import_cameras(directory=str(folder))
    assert counts() == before


def test_anew_is_one_undo_step(scene, folder: Path) -> None:
    """Oracle: the camera as it was moved by hand."""
    bpy.ops.gscore.import_cameras(directory=str(folder))
    cameras_of(bpy.context.object)[0].location.x = 99
    bpy.ops.ed.undo_push(message="moved")
    bpy.ops.gscore.import_cameras(directory=str(folder))
    root = bpy.context.object
    assert cameras_of(root)[0].location.x != 99 and len(cameras_of(root)) == 60
    bpy.ops.ed.undo_push(message="anew")
    bpy.ops.ed.undo()
    root = bpy.data.objects["studio"]
    assert cameras_of(root)[0].location.x == 99 and len(bpy.data.cameras) == 60


def test_the_button_stays(scene, folder: Path, tmp_path: Path) -> None:
    """Oracle: the drawn panel; one set of cameras, also if the capture was moved."""
    scene.gscore.capture_path = str(folder)
    bpy.ops.gscore.import_cameras()
    assert "(Import Cameras Again)" in drawn(CamerasPanel)
    moved = folder.rename(tmp_path / "elsewhere")
    scene.gscore.capture_path = str(moved)
    bpy.ops.gscore.import_cameras(capture="studio")
    assert len(bpy.data.cameras) == 60
    root = bpy.data.objects["studio"]
    assert Path(root["gs_source"]) == moved and points_of(root) is not None
    assert Path(co.photo_camera_of(cameras_of(root)[0]).photo).is_file()


def test_file_import_has_it(scene) -> None:
    """Oracle: the entry of Blender's menu opens the file browser for a folder."""
    from types import SimpleNamespace

    from addon.cameras import operators
    from tests.addon.drawn import Layout

    layout = Layout()
    operators._draw_import(SimpleNamespace(layout=layout), bpy.context)
    assert layout.notes == ["(COLMAP or NeRF Cameras (capture folder))"]
    assert operators._draw_import in bpy.types.TOPBAR_MT_file_import.draw._draw_funcs
