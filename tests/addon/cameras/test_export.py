"""Camera export: the capture's own files to the last bit if nothing was changed."""

import json
import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from addon.cameras import camera_math as cm
from addon.cameras import capture_transform, captures, importing, sfm_points
from addon.cameras import objects as co
from addon.cameras.objects import cameras_of
from addon.cameras.render_camera import render_camera
from addon.compat import matrix_to_numpy
from addon.core import DataConfig, read_capture, read_colmap
from tests.addon.calls import export_colmap, export_transforms, import_capture
from tests.addon.captures import STUDIO, write_capture

FILES = ("cameras", "images", "points3D")


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """A capture with every shape of camera, with observations, without photos."""
    write_capture(tmp_path / "odd", np.random.default_rng(0))
    return tmp_path / "odd"


@pytest.fixture
def made(scene, capture: Path) -> importing.ImportedCapture:
    """That capture in Blender, aligned and scaled."""
    made = import_capture(bpy.context.scene, capture)
    capture_transform.set_extent(made.root, 3.0)
    bpy.context.view_layer.update()
    return made


def graph() -> bpy.types.Depsgraph:
    """The evaluated scene."""
    return bpy.context.evaluated_depsgraph_get()


def test_untouched_is_bit_for_bit(made, scene, capture: Path, tmp_path: Path) -> None:
    """Oracle: the imported files, byte for byte, in spite of alignment and scale."""
    done = export_colmap(tmp_path / "out", made.cameras, scene, root=made.root, depsgraph=graph())
    assert (done.views, done.moved, done.points, done.warnings) == (14, 0, 300, ())
    for name in FILES:
        ours = tmp_path / "out" / "sparse" / "0" / f"{name}.bin"
        assert ours.read_bytes() == (capture / "sparse" / "0" / f"{name}.bin").read_bytes(), name


def test_real_capture_is_kept(scene, tmp_path: Path) -> None:
    """Oracle: the studio's files; only the order of points within tracks may differ."""
    made = import_capture(bpy.context.scene, STUDIO)
    export_colmap(tmp_path, made.cameras, scene, root=made.root, depsgraph=graph())
    for name in ("cameras", "images"):
        ours = tmp_path / "sparse" / "0" / f"{name}.bin"
        assert ours.read_bytes() == (STUDIO / "sparse" / "0" / f"{name}.bin").read_bytes()
    ours, theirs = read_colmap(tmp_path).points, read_colmap(STUDIO).points
    for field in ("ids", "xyz", "rgb", "error", "track_lengths"):
        np.testing.assert_array_equal(getattr(ours, field), getattr(theirs, field))


@pytest.mark.parametrize("kind", ["COLMAP", "COLMAP_TEXT", "TRANSFORMS"])
def test_imported_again_the_cameras_are_the_same(scene, tmp_path: Path, kind: str) -> None:
    """Oracle: Blender's own numbers of the first import."""
    first = import_capture(bpy.context.scene, STUDIO, align=False)
    bpy.ops.gscore.export_cameras(directory=str(tmp_path), kind=kind)
    again = import_capture(bpy.context.scene, tmp_path, align=False)
    for a, b in zip(first.cameras, again.cameras, strict=True):
        assert Path(a["gs_image"]).name == Path(b["gs_image"]).name
        for field in ("location", "rotation_quaternion"):
            np.testing.assert_allclose(getattr(a, field), getattr(b, field), rtol=0, atol=2e-7)
        for field in ("lens", "sensor_width", "shift_x", "shift_y", "sensor_fit"):
            assert getattr(a.data, field) == getattr(b.data, field), field
        np.testing.assert_allclose(a["gs_viewmat"], b["gs_viewmat"], rtol=0, atol=1e-12)
        assert list(a["gs_K"]) == list(b["gs_K"])
    a, b = (sfm_points.positions_of(made.points) for made in (first, again))
    np.testing.assert_array_equal(a, b)


def test_a_moved_camera(made, scene, capture: Path, tmp_path: Path) -> None:
    """Oracle: Blender's matrix_world in the capture's world; the others stay to the last bit."""
    ob = made.cameras[4]
    ob.location.x += 0.5
    ob.rotation_quaternion = [0.5, -0.5, 0.5, 0.5]
    bpy.context.view_layer.update()
    done = export_colmap(tmp_path, made.cameras, scene, root=made.root, depsgraph=graph())
    assert done.moved == 1
    before, after = read_colmap(capture), read_colmap(tmp_path)
    for old, new in zip(before.images, after.images, strict=True):
        assert (old.id, old.name, old.camera_id) == (new.id, new.name, new.camera_id)
        if new.name != ob["gs_image"]:
            np.testing.assert_array_equal(old.qvec, new.qvec)
            np.testing.assert_array_equal(old.point3D_ids, new.point3D_ids)
            continue
        assert len(new.xys) == 0 and len(old.xys) > 0
        world = np.linalg.inv(matrix_to_numpy(made.root.matrix_world)) @ matrix_to_numpy(
            ob.matrix_world
        )
        expected = cm.viewmat_from_matrix_world(world)
        np.testing.assert_allclose(new.viewmat, expected, atol=5e-6)
        np.testing.assert_allclose(
            cm.matrix_world_from_viewmat(new.viewmat)[:3, 3], ob.location, atol=1e-6
        )
    np.testing.assert_array_equal(before.points.xyz, after.points.xyz)
    assert after.points.track_lengths.sum() == 600 - len(
        next(i for i in before.images if i.name == ob["gs_image"]).xys
    )


def test_a_zoomed_camera(made, scene, tmp_path: Path) -> None:
    """Oracle: twice the lens is twice the focal length, in new intrinsics."""
    ob = made.cameras[0]
    ob.data.lens *= 2
    export_colmap(tmp_path, made.cameras, scene, root=made.root, depsgraph=graph())
    model = read_colmap(tmp_path)
    image = next(i for i in model.images if i.name == ob["gs_image"])
    camera = model.cameras[image.camera_id]
    assert image.camera_id == 8 and camera.model == "PINHOLE"
    assert len(image.xys) == 0  # they were observed through another lens
    np.testing.assert_allclose(camera.params, [3400, 3400, 960, 540], rtol=1e-6)
    assert len(model.cameras) == 8


@pytest.mark.parametrize("kind", ["COLMAP", "TRANSFORMS"])
def test_a_zoomed_camera_of_a_bent_photo(
    made, scene, capture: Path, tmp_path: Path, kind: str
) -> None:
    """Oracle: the capture's own files, because the photo fits no other lens; a warning names it."""
    bent = [ob for ob in made.cameras if "gs_photo_size" in ob]
    for ob in bent:
        ob.data.lens *= 2
    export = export_colmap if kind == "COLMAP" else export_transforms
    out = tmp_path / ("o" if kind == "COLMAP" else "o.json")
    done = export(out, bent, scene, root=made.root, depsgraph=graph())
    assert done.moved == 0
    (warning,) = [text for text in done.warnings if "lens" in text]
    names = ", ".join(ob["gs_image"] for ob in bent[:3])
    assert warning.startswith(f"The lens of {names} and 1 more was changed in Blender")
    if kind == "COLMAP":
        ours, theirs = read_colmap(out), read_colmap(capture)
        own = {image.name: image for image in theirs.images}
        for image in ours.images:
            camera, there = ours.cameras[image.camera_id], theirs.cameras[own[image.name].camera_id]
            assert (camera.model, camera.width) == (there.model, there.width)
            np.testing.assert_array_equal(camera.params, there.params)
            np.testing.assert_array_equal(image.xys, own[image.name].xys)
    else:
        for frame in json.loads(out.read_text())["frames"]:
            ob = next(ob for ob in bent if frame["file_path"].endswith(ob["gs_image"]))
            assert [frame["w"], frame["h"]] == list(ob["gs_photo_size"])


def test_an_animated_camera(made, scene, tmp_path: Path) -> None:
    """Oracle: the evaluated pose at the current frame."""
    ob = made.cameras[0]
    ob.keyframe_insert("location", frame=1)
    start = Vector(ob.location)
    ob.location.z += 2
    ob.keyframe_insert("location", frame=11)
    scene.frame_set(11)
    done = export_colmap(tmp_path, [ob], scene, root=made.root, depsgraph=graph())
    assert done.moved == 1
    center = cm.matrix_world_from_viewmat(read_colmap(tmp_path).images[0].viewmat)[:3, 3]
    np.testing.assert_allclose(center, start + Vector((0, 0, 2)), atol=1e-5)


def test_deleted_cameras_and_points(made, scene, capture: Path, tmp_path: Path) -> None:
    """Oracle: the rest of the model: exact rows, ids, and tracks."""
    gone = made.cameras[0]["gs_image"]
    bpy.data.objects.remove(made.cameras[0])
    mesh = made.points.data
    keep = np.arange(300) % 3 != 0
    _delete(made.points, ~keep)
    assert len(mesh.vertices) == 200
    mesh.vertices[5].co.x += 1
    listed = cameras_of(made.root)
    done = export_colmap(tmp_path, listed, scene, root=made.root, depsgraph=graph())
    assert (done.views, done.points) == (13, 200)
    before, after = read_colmap(capture), read_colmap(tmp_path)
    np.testing.assert_array_equal(after.points.ids, before.points.ids[keep])
    expected = before.points.xyz[keep]
    moved = np.arange(200) == 5
    np.testing.assert_array_equal(after.points.xyz[~moved], expected[~moved])
    np.testing.assert_allclose(after.points.xyz[5], expected[5] + [1, 0, 0], atol=1e-6)
    ids = set(after.points.ids.tolist())
    for image in after.images:
        old = next(i for i in before.images if i.name == image.name)
        assert image.name != gone
        wanted = [i if i in ids else -1 for i in old.point3D_ids.tolist()]
        assert image.point3D_ids.tolist() == wanted


def _delete(ob, chosen: np.ndarray) -> None:
    """Delete vertices in Edit Mode, as a user does, and duplicate none."""
    bpy.context.view_layer.objects.active = ob
    ob.data.vertices.foreach_set("select", chosen)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.delete(type="VERT")
    bpy.ops.object.mode_set(mode="OBJECT")


def test_duplicated_points_are_new_ones(made, scene, capture: Path, tmp_path: Path) -> None:
    """Oracle: the copy has a new id, no track and no error."""
    bpy.context.view_layer.objects.active = made.points
    chosen = np.arange(300) == 17
    made.points.data.vertices.foreach_set("select", chosen)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.duplicate()
    bpy.ops.object.mode_set(mode="OBJECT")
    assert len(made.points.data.vertices) == 301
    export_colmap(tmp_path, made.cameras, scene, root=made.root, depsgraph=graph())
    points = read_colmap(tmp_path).points
    assert len(points) == 301 and len(set(points.ids.tolist())) == 301
    assert points.track_lengths[-1] == 0 and points.error[-1] == -1
    np.testing.assert_array_equal(points.rgb[-1], read_colmap(capture).points.rgb[17])


def test_cameras_of_ones_own(made, scene, tmp_path: Path) -> None:
    """Oracle: the same place and picture in Blender after another import."""
    data = bpy.data.cameras.new("Dolly")
    ob = bpy.data.objects.new("Dolly/1", data)
    scene.collection.objects.link(ob)
    data.lens, data.sensor_fit, data.shift_x = 35, "VERTICAL", 0.1
    ob.location, ob.rotation_euler, ob.scale = (1, -3, 2), (1.1, 0.2, 0.4), (2, 2, 2)
    scene.render.resolution_x, scene.render.resolution_y = 333, 500
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = 1.0, 1.25
    bpy.context.view_layer.update()
    wanted = render_camera(ob, scene)
    done = export_colmap(tmp_path, [*made.cameras, ob], scene, root=made.root, depsgraph=graph())
    assert (done.views, done.moved) == (15, 1)
    other = import_capture(bpy.context.scene, tmp_path, align=False)
    capture_transform.set_root_matrix(other.root, matrix_to_numpy(made.root.matrix_basis))
    again = next(o for o in other.cameras if o["gs_image"] == "Dolly_1.png")
    captures.use_camera(scene, again)
    bpy.context.view_layer.update()
    got = render_camera(again, scene)
    np.testing.assert_allclose(got.K, wanted.K, rtol=1e-5)
    np.testing.assert_allclose(got.viewmat, wanted.viewmat, atol=1e-5)
    assert (got.width, got.height) == (wanted.width, wanted.height)


def test_blenders_world(made, scene, tmp_path: Path) -> None:
    """Oracle: matrix_world; no points, because they belong to the capture."""
    done = export_colmap(tmp_path, made.cameras[:3], scene, depsgraph=graph())
    assert (done.moved, done.points) == (3, 0)
    for image, ob in zip(read_colmap(tmp_path).images, made.cameras, strict=False):
        expected = cm.viewmat_from_matrix_world(matrix_to_numpy(ob.matrix_world))
        np.testing.assert_allclose(image.viewmat, expected, atol=5e-6)


def test_operator_without_a_capture(scene, tmp_path: Path) -> None:
    """Oracle: Blender's own projection of the export; an error without a capture."""
    for i in range(3):
        ob = bpy.data.objects.new(f"Shot {i}", bpy.data.cameras.new("c"))
        scene.collection.objects.link(ob)
        ob.location, ob.rotation_euler = (i, -4, 1), (1.4, 0, 0.1 * i)
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="No capture is imported"):
        bpy.ops.gscore.export_cameras(directory=str(tmp_path))
    bpy.ops.gscore.export_cameras(directory=str(tmp_path), which="SCENE", world="BLENDER")
    model = read_colmap(tmp_path)
    assert [image.name for image in model.images] == ["Shot 0.png", "Shot 1.png", "Shot 2.png"]
    assert len(model.cameras) == 1
    point = np.array([[0.3, 0.2, 0.9]])
    for image in model.images:
        ob = scene.objects[Path(image.name).stem]
        camera = model.cameras[image.camera_id]
        ours, _ = cm.project(point, camera.K, image.viewmat)
        x, y, _ = world_to_camera_view(scene, ob, Vector(point[0]))
        expected = [x * camera.width, (1 - y) * camera.height]
        np.testing.assert_allclose(ours[0], expected, atol=1e-3)


def test_without_the_source(made, scene, capture: Path, tmp_path: Path) -> None:
    """Oracle: poses and intrinsics of the model to the last bit; points as floats; a warning."""
    model = read_colmap(capture)
    shutil.rmtree(capture)
    done = export_colmap(tmp_path / "o", made.cameras, scene, root=made.root, depsgraph=graph())
    assert done.moved == 0 and "single precision" in done.warnings[0]
    after = read_colmap(tmp_path / "o")
    old = {image.name: image for image in model.images}
    for image in after.images:
        np.testing.assert_allclose(image.viewmat, old[image.name].viewmat, rtol=0, atol=1e-14)
        a = model.cameras[old[image.name].camera_id]
        b = after.cameras[image.camera_id]
        assert (a.model, a.width, a.params.tolist()) == (b.model, b.width, b.params.tolist())
    assert len(after.cameras) == len(model.cameras)
    np.testing.assert_array_equal(after.points.xyz, model.points.xyz.astype(np.float32))
    np.testing.assert_array_equal(after.points.rgb, model.points.rgb)


def test_reconstructed_source_warns(made, scene, capture: Path, tmp_path: Path) -> None:
    """Oracle: the imported poses take precedence over those of another reconstruction; a
    warning."""
    imported = {ob["gs_image"]: co.photo_camera_of(ob).viewmat for ob in made.cameras}
    write_capture(capture, np.random.default_rng(7))
    done = export_colmap(tmp_path / "o", made.cameras, scene, root=made.root, depsgraph=graph())
    assert "14 cameras have changed" in done.warnings[0]
    for image in read_colmap(tmp_path / "o").images:
        np.testing.assert_allclose(image.viewmat, imported[image.name], atol=1e-13)
        assert len(image.xys) == 0


def test_copies_get_names_of_their_own(made, scene, tmp_path: Path) -> None:
    """Oracle: COLMAP requires unique names."""
    copy = made.cameras[0].copy()
    bpy.context.scene.collection.objects.link(copy)
    listed = [*made.cameras, copy]
    export_colmap(tmp_path, listed, scene, root=made.root, depsgraph=graph())
    names = [image.name for image in read_colmap(tmp_path).images]
    assert "sub/v000_1.png" in names and len(set(names)) == 15


def test_transforms_file(made, scene, tmp_path: Path) -> None:
    """Oracle: gscore's reader; distortion and sizes of every camera; OpenGL axes by hand."""
    path = tmp_path / "t" / "transforms.json"
    done = export_transforms(path, made.cameras, scene, root=made.root, depsgraph=graph())
    assert done.points == 300 and "14 photos are not inside" in done.warnings[0]
    data = json.loads(path.read_text())
    frame = data["frames"][0]
    own = co.photo_camera_of(made.cameras[0])
    world = np.linalg.inv(own.viewmat)
    np.testing.assert_allclose(frame["transform_matrix"], world @ np.diag([1, -1, -1, 1]))
    views = read_capture(DataConfig(source=path), photos_required=False).views
    assert len(views) == 14
    for view, ob in zip(views, made.cameras, strict=True):
        own = co.photo_camera_of(ob)
        np.testing.assert_allclose(view.viewmat, own.viewmat, atol=1e-12)
        assert (view.camera.width, view.camera.height) == own.taken
        if own.photo_size is None:
            np.testing.assert_array_equal(view.camera.K, own.K)
        if own.model == "OPENCV":
            assert tuple(view.camera.params) == own.params
        if own.model == "SIMPLE_RADIAL":
            assert view.camera.named_params["k1"] == own.params[-1]


def test_refusals(made, scene, capture: Path, tmp_path: Path) -> None:
    """Oracle: an error; no file is written and the capture's own are as before."""
    before = {p: p.read_bytes() for p in capture.rglob("*.bin")}
    root = made.root
    with pytest.raises(ValueError, match="own model"):
        export_colmap(capture, made.cameras, scene, root=root)
    with pytest.raises(ValueError, match="own model"):  # in Blender's world as well
        export_colmap(capture, made.cameras, scene)
    with pytest.raises(ValueError, match="no cameras"):
        export_colmap(tmp_path / "o", [], scene, root=root)
    with pytest.raises(ValueError, match="is not a camera"):
        export_colmap(tmp_path / "o", [made.points], scene, root=root)
    made.cameras[3].data.type = "ORTHO"
    with pytest.raises(ValueError, match="v003 is not perspective"):
        export_colmap(tmp_path / "o", made.cameras, scene, root=root)
    with pytest.raises(RuntimeError, match="v003 is not perspective"):
        bpy.ops.gscore.export_cameras(directory=str(tmp_path / "o"))
    made.cameras[3].data.type = "PERSP"
    made.cameras[3].scale = (1, -1, 1)
    with pytest.raises(ValueError, match="v003 is mirrored"):
        export_colmap(tmp_path / "o", made.cameras, scene, root=root)
    assert not (tmp_path / "o").exists()
    made.cameras[3].scale = (1, 1, 1)
    (tmp_path / "file").write_text("x")
    with pytest.raises(RuntimeError, match="Cannot write"):
        bpy.ops.gscore.export_cameras(directory=str(tmp_path / "file"))
    export_colmap(tmp_path / "b", made.cameras, scene, root=root)
    with pytest.raises(ValueError, match="binary model"):
        export_colmap(tmp_path / "b", made.cameras, scene, root=root, binary=False)
    assert before == {p: p.read_bytes() for p in capture.rglob("*.bin")}


def test_other_captures_of_the_file_stay(made, scene, tmp_path: Path) -> None:
    """Oracle: the files of a capture chosen in the panel, and of one imported, are as before."""
    chosen, imported = tmp_path / "chosen", tmp_path / "imported"
    for folder in (chosen, imported):
        write_capture(folder, np.random.default_rng(1))
        (folder / "transforms.json").write_text("{}")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    import_capture(bpy.context.scene, imported)
    scene.gscore.capture_path = str(chosen)
    for folder in (chosen, imported):
        with pytest.raises(ValueError, match=f"own model of .*{folder.name}"):
            export_colmap(folder, made.cameras, scene, root=made.root)
        with pytest.raises(ValueError, match=f"own file of .*{folder.name}"):
            export_transforms(folder / "transforms.json", made.cameras, scene, root=made.root)
    assert before == {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}


def test_a_fisheye_has_no_transforms(scene, tmp_path: Path) -> None:
    """Oracle: the message names photo and model."""
    bent = {1: ("THIN_PRISM_FISHEYE", 640, 480, (400.0, 400.0, 320.0, 240.0, *8 * (0.01,)))}
    write_capture(tmp_path / "c", np.random.default_rng(0), cameras=bent)
    made = import_capture(bpy.context.scene, tmp_path / "c")
    with pytest.raises(ValueError, match=r"v000.png has the camera model THIN_PRISM"):
        export_transforms(tmp_path / "transforms.json", made.cameras, scene, root=made.root)
    assert not (tmp_path / "transforms.json").exists()
