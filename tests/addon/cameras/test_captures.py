"""Imported and user-made cameras against Blender's own projection; captures as scene objects."""

import shutil
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from addon.cameras import camera_math as cm
from addon.cameras import capture_transform, captures, sfm_points
from addon.cameras import objects as co
from addon.cameras.backgrounds import photo_of
from addon.cameras.objects import cameras_of, is_camera, root_of
from addon.cameras.render_camera import RenderCamera, render_camera
from addon.capture.inspection import inspect
from addon.compat import matrix_to_numpy
from addon.core import GsError, plan_undistortion, read_capture, read_colmap, write_colmap
from tests.addon.calls import import_capture
from tests.addon.captures import STUDIO, write_capture
from tests.program_files import Rig, write_metashape
from tests.upright_photos import upright_capture

PIXELS = 1e-3
"""Blender projects in single precision."""


def by_blender(ob, scene, points: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Pixels [P, 2] of world points [P, 3] by Blender's own projection."""
    views = np.array([tuple(world_to_camera_view(scene, ob, Vector(p))) for p in points])
    return np.stack([views[:, 0] * size[0], (1 - views[:, 1]) * size[1]], axis=1)


def in_view(render: RenderCamera, rng: np.random.Generator, count: int = 30) -> np.ndarray:
    """World points [count, 3] in a camera's picture, two to eight units away, as floats."""
    depths = rng.uniform(2, 8, (count, 1))
    pixels = rng.uniform([0, 0], [render.width, render.height], (count, 2))
    local = np.ones((count, 3))
    local[:, :2] = (pixels - render.K[:2, 2]) / render.K[[0, 1], [0, 1]]
    local *= depths if not render.orthographic else [1, 1, 0]
    local[:, 2:] = depths
    points = (local - render.viewmat[:3, 3]) @ np.linalg.inv(render.viewmat[:3, :3]).T
    return points.astype(np.float32).astype(np.float64)  # Blender's vectors are float32


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """A capture with every shape of camera, without photos."""
    write_capture(tmp_path / "odd", np.random.default_rng(0))
    return tmp_path / "odd"


@pytest.mark.parametrize("aligned", [False, True])
def test_imported_cameras_project_as_colmap_says(scene, capture: Path, aligned: bool) -> None:
    """Oracle: COLMAP's K and pose in float64, compared with Blender's own projection."""
    made = import_capture(bpy.context.scene, capture, align=aligned)
    if aligned:
        capture_transform.set_extent(made.root, 12.5)
    bpy.context.view_layer.update()
    world = matrix_to_numpy(made.root.matrix_world)
    states = {image.name: image for image in read_colmap(capture).images}
    intrinsics = read_colmap(capture).cameras
    rng = np.random.default_rng(1)
    for ob in made.cameras:
        image = states[ob["gs_image"]]
        camera = intrinsics[image.camera_id]
        camera = plan_undistortion(camera) or camera
        captures.use_camera(scene, ob)
        render = render_camera(ob, scene)
        points = in_view(render, rng)
        mine = points @ np.linalg.inv(world)[:3, :3].T + np.linalg.inv(world)[:3, 3]
        expected, depths = cm.project(mine, camera.K, image.viewmat)
        assert depths.min() > 0
        got = by_blender(ob, scene, points, (camera.width, camera.height))
        assert np.abs(got - expected).max() < PIXELS, ob.name
        ours, _ = cm.project(points, render.K, render.viewmat)
        assert np.abs(ours - expected).max() < PIXELS, ob.name
        assert (render.width, render.height) == (camera.width, camera.height)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
@pytest.mark.parametrize("size", [(1920, 1080), (1080, 1920), (640, 640), (801, 533)])
def test_render_camera(scene, size: tuple[int, int], fit: str, kind: str) -> None:
    """Oracle: Blender's world_to_camera_view and calc_matrix_camera, in 54 settings each."""
    rng = np.random.default_rng(2)
    data = bpy.data.cameras.new("c")
    ob = bpy.data.objects.new("c", data)
    scene.collection.objects.link(ob)
    scene.camera = ob
    render = scene.render
    render.resolution_x, render.resolution_y = size
    data.type, data.sensor_fit, data.ortho_scale = kind, fit, 5.0
    data.sensor_width, data.sensor_height = 36, 24
    for percentage in (100, 50, 37):
        for aspect in ((1, 1), (1.5, 1), (1, 1.25)):
            for shift in ((0, 0), (0.13, -0.07)):
                for lens in (18.0, 50.0, 85.0):
                    render.resolution_percentage = percentage
                    render.pixel_aspect_x, render.pixel_aspect_y = aspect
                    data.lens, (data.shift_x, data.shift_y) = lens, shift
                    ob.rotation_euler, ob.location = rng.uniform(-3, 3, 3), rng.uniform(-2, 2, 3)
                    ob.scale = rng.uniform(0.5, 2, 3)
                    bpy.context.view_layer.update()
                    _compare(ob, scene, rng)


def _compare(ob, scene, rng: np.random.Generator) -> None:
    depsgraph = bpy.context.evaluated_depsgraph_get()
    ours = render_camera(ob, scene, depsgraph=depsgraph)
    points = in_view(ours, rng)
    got, _ = cm.project(points, ours.K, ours.viewmat, orthographic=ours.orthographic)
    render = scene.render
    matrix = ob.calc_matrix_camera(
        depsgraph,
        x=ours.width,
        y=ours.height,
        scale_x=render.pixel_aspect_x,
        scale_y=render.pixel_aspect_y,
    )
    clip = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    view = matrix_to_numpy(ob.matrix_world.normalized().inverted())
    clip = clip @ (matrix_to_numpy(matrix) @ view).T
    ndc = clip[:, :2] / clip[:, 3:]
    expected = np.stack(
        [(ndc[:, 0] + 1) / 2 * ours.width, (1 - ndc[:, 1]) / 2 * ours.height], axis=1
    )
    assert np.abs(got - expected).max() < PIXELS
    # Blender's helper leaves the percentage out, so its frame differs where pixels were cut off.
    if (ours.width, ours.height) == (render.resolution_x, render.resolution_y):
        other = by_blender(ob, scene, points, (ours.width, ours.height))
        assert np.abs(got - other).max() < PIXELS
    assert ours.near == ob.data.clip_start


def test_cameras_that_are_refused(scene) -> None:
    """Oracle: the message names the camera and its type."""
    data = bpy.data.cameras.new("c")
    ob = bpy.data.objects.new("Eye", data)
    scene.collection.objects.link(ob)
    data.type = "PANO"
    with pytest.raises(ValueError, match="Eye is panoramic"):
        render_camera(ob, scene)
    data.type = "PERSP"
    for scale in ((-1, 1, 1), (1, 1, 0)):
        ob.scale = scale
        bpy.context.view_layer.update()
        with pytest.raises(ValueError, match=r"Eye is (mirrored|scaled)"):
            render_camera(ob, scene)
    with pytest.raises(ValueError, match="not a camera"):
        render_camera(bpy.data.objects.new("Thing", None), scene)


def test_another_size(scene) -> None:
    """Oracle: half the size halves K."""
    data = bpy.data.cameras.new("c")
    ob = bpy.data.objects.new("c", data)
    scene.render.resolution_x, scene.render.resolution_y = 800, 600
    whole = render_camera(ob, scene)
    half = render_camera(ob, scene, width=400, height=300)
    np.testing.assert_allclose(half.K[:2], whole.K[:2] / 2)


def test_import_matches_the_model(scene) -> None:
    """Oracle: the model: names, sizes, float64 values to the last bit, photos not decoded."""
    made = import_capture(bpy.context.scene, STUDIO / "sparse" / "0")
    model = read_colmap(STUDIO)
    assert made.root["gs_kind"] == "capture" and made.root["gs_source"] == str(STUDIO)
    assert [ob["gs_image"] for ob in made.cameras] == sorted(i.name for i in model.images)
    by_name = {image.name: image for image in model.images}
    for ob in made.cameras:
        assert is_camera(ob) and root_of(ob) == made.root
        own = co.photo_camera_of(ob)
        np.testing.assert_array_equal(own.viewmat, by_name[own.image].viewmat)
        np.testing.assert_array_equal(own.K, model.cameras[by_name[own.image].camera_id].K)
        photo = photo_of(ob)
        assert Path(photo.filepath) == STUDIO / "images" / own.image
        assert not photo.has_data
        assert not co.is_moved(ob, own) and not co.is_lens_changed(ob.data, own)
    assert cameras_of(made.root) == made.cameras
    assert made.warnings == ()


def test_points_show_their_colors(scene) -> None:
    """Oracle: the model's points; the depsgraph's mesh: octahedra and one bare vertex."""
    made = import_capture(bpy.context.scene, STUDIO)
    model = read_colmap(STUDIO)
    np.testing.assert_array_equal(
        sfm_points.positions_of(made.points), model.points.xyz.astype(np.float32)
    )
    colors = sfm_points.encoded(sfm_points.linear_of(made.points))
    np.testing.assert_array_equal(colors, model.points.rgb)
    places = sfm_points.unique_places(sfm_points.places_of(made.points))
    np.testing.assert_array_equal(places, np.arange(len(model.points)))
    shown = made.points.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    assert len(shown.vertices) == 6 * len(model.points) + 1
    assert len(shown.polygons) == 8 * len(model.points)
    assert shown.color_attributes.active_color_name == sfm_points.COLOR
    assert [m.name for m in shown.materials if m] == [sfm_points.GROUP]


def test_use_camera(scene) -> None:
    """Oracle: the photo's size and K; the former camera's photo leaves memory."""
    made = import_capture(bpy.context.scene, STUDIO)
    first, second = made.cameras[:2]
    assert captures.use_camera(scene, first) == []
    assert scene.camera == first
    assert (scene.render.resolution_x, scene.render.resolution_y) == (480, 640)
    photo = photo_of(first)
    assert len(photo.pixels) == 4 * 480 * 640  # decodes it
    assert photo.has_data
    assert captures.step_camera(scene, made.root, 1) == second
    captures.use_camera(scene, second)
    assert not photo.has_data
    scene.camera = made.cameras[-1]
    assert captures.step_camera(scene, made.root, 1) == first
    scene.camera = None
    assert captures.step_camera(scene, made.root, -1) == made.cameras[-1]
    with pytest.raises(ValueError, match="not a camera of a photo"):
        captures.use_camera(scene, made.root)


def test_pixel_aspect_is_reported(scene, capture: Path) -> None:
    """Oracle: fy / fx of the model, in the scene and in the message."""
    made = import_capture(bpy.context.scene, capture)
    assert any("fx and fy differ" in warning for warning in made.warnings)
    assert any("differ in size" in warning for warning in made.warnings)
    ob = next(ob for ob in made.cameras if tuple(ob["gs_size"]) == (640, 640))
    notes = captures.use_camera(scene, ob)
    assert scene.render.pixel_aspect_x == pytest.approx(701 / 500)
    assert "1.4020" in notes[0]


def test_distorted_cameras_come_as_trainings_see_them(scene, capture: Path) -> None:
    """Oracle: the pinhole camera of a training; model, parameters and the photo's size are kept."""
    made = import_capture(bpy.context.scene, capture)
    ob = next(ob for ob in made.cameras if ob["gs_model"] == "OPENCV")
    own = co.photo_camera_of(ob)
    assert own.params == (800.0, 801.0, 505.0, 370.0, -0.1, 0.02, 0.001, -0.002)
    assert own.photo_size == own.taken == (1000, 750)
    lens = next(c for c in read_colmap(capture).cameras.values() if c.model == "OPENCV")
    plan = plan_undistortion(lens)
    np.testing.assert_array_equal(own.K, plan.K)
    assert (own.width, own.height) == (plan.width, plan.height) != own.taken


def test_lens_without_inverse_is_reported(scene, tmp_path: Path) -> None:
    """Oracle: r (1 - 1.5 r^2) is not monotonic beyond 0.47, inside the photo: the camera is the
    pinhole part of the lens, and its photo is not undistorted."""
    bent = {1: ("SIMPLE_RADIAL", 640, 480, (400.0, 320.0, 240.0, -1.5))}
    write_capture(tmp_path / "x", np.random.default_rng(0), cameras=bent, photos=True)
    made = import_capture(bpy.context.scene, tmp_path / "x")
    assert sum("cannot be undistorted" in warning for warning in made.warnings) == 1
    own = co.photo_camera_of(made.cameras[0])
    np.testing.assert_array_equal(own.K, [[400, 0, 320], [0, 400, 240], [0, 0, 1]])
    assert own.photo_size is None and own.taken == (640, 480)
    assert Path(photo_of(made.cameras[0]).filepath) == Path(own.photo)


def test_photos_that_are_missing(scene, tmp_path: Path) -> None:
    """Oracle: cameras without photos; the warning counts them; using one reports the expected
    path."""
    shutil.copytree(STUDIO / "sparse", tmp_path / "c" / "sparse")
    (tmp_path / "c" / "images").mkdir()
    shutil.copy(STUDIO / "images" / "view_000.jpg", tmp_path / "c" / "images")
    made = import_capture(bpy.context.scene, tmp_path / "c")
    assert "59 of the 60 images" in made.warnings[0]
    assert [photo_of(ob) is not None for ob in made.cameras] == [True] + 59 * [False]
    notes = captures.use_camera(scene, made.cameras[1])
    assert str(tmp_path / "c" / "images" / "view_001.jpg") in notes[0]


@pytest.mark.parametrize("kind", ["missing", "empty", "photos", "broken", "panoramas"])
def test_bad_captures_leave_the_scene_alone(scene, tmp_path: Path, kind: str) -> None:
    """Oracle: the counts of all data before; a message about the folder."""
    folder = tmp_path / "x"
    if kind != "missing":
        folder.mkdir()
    if kind == "photos":
        shutil.copytree(STUDIO / "images", folder / "images")
    if kind in ("broken", "panoramas"):
        sphere = {1: ("EQUIRECTANGULAR", 100, 50, (100.0, 50.0))}
        write_capture(folder, np.random.default_rng(0), cameras=sphere)
    if kind == "broken":
        file = folder / "sparse" / "0" / "images.bin"
        file.write_bytes(file.read_bytes()[:100])
    before = _counts()
    with pytest.raises((GsError, ValueError), match=str(folder)):
        import_capture(bpy.context.scene, folder)
    with pytest.raises(RuntimeError, match=str(folder)):
        bpy.ops.gscore.import_cameras(directory=str(folder))
    assert _counts() == before


def _counts() -> dict[str, int]:
    kinds = ("objects", "cameras", "meshes", "collections", "images", "materials", "node_groups")
    return {kind: len(getattr(bpy.data, kind)) for kind in kinds}


def test_save_and_load(scene, tmp_path: Path) -> None:
    """Oracle: the model's values, read from the .blend file to the last bit."""
    import_capture(bpy.context.scene, STUDIO)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    root = next(ob for ob in bpy.data.objects if co.is_kind(ob, "capture"))
    by_name = {image.name: image for image in read_colmap(STUDIO).images}
    listed = cameras_of(root)
    assert len(listed) == 60
    for ob in listed:
        own = co.photo_camera_of(ob)
        np.testing.assert_array_equal(own.viewmat, by_name[own.image].viewmat)
        assert not co.is_moved(ob, own) and not co.is_lens_changed(ob.data, own)
    assert captures.use_camera(bpy.context.scene, listed[0]) == []
    assert co.points_of(root).modifiers[0].node_group.name == sfm_points.GROUP


@pytest.mark.parametrize("held", [(3,) * 8, (6,) * 8, (8, 1) * 4, (4,) * 8, (7,) * 8])
def test_up_by_the_orientation_of_photos(scene, tmp_path: Path, held: tuple[int, ...]) -> None:
    """Oracle: the vertical of the world in which the photos were taken upright, stored according to
    their EXIF orientation; a ground may be tilted by up to 12 degrees."""
    up = upright_capture(tmp_path / "walk", held)
    root = import_capture(bpy.context.scene, tmp_path / "walk").root
    for how in ("", "CAMERAS", "CAPTURE"):
        if how:
            bpy.ops.gscore.align_capture(capture=root.name, up=how)
        assert (matrix_to_numpy(root.matrix_basis)[:3, :3] @ up)[2] > np.cos(np.radians(12.1))


def test_up_that_a_capture_states(scene, tmp_path: Path) -> None:
    """Oracle: the stated direction, far from the photos' common one, points up by default; that of
    the cameras differs."""
    shutil.copytree(STUDIO / "sparse", tmp_path / "studio" / "sparse")
    model = read_colmap(tmp_path / "studio")
    root = import_capture(bpy.context.scene, tmp_path / "studio", photos=False).root
    own = matrix_to_numpy(root.matrix_basis)
    bpy.data.batch_remove(list(bpy.data.objects))
    stated = np.array([1.0, 2.0, 2.0]) / 3
    write_colmap(replace(model, up=stated), tmp_path / "studio" / "sparse" / "0")
    root = import_capture(bpy.context.scene, tmp_path / "studio", photos=False).root
    turned = matrix_to_numpy(root.matrix_basis)[:3, :3] @ stated
    assert turned[2] > np.cos(np.radians(12.1))  # largest tilt of a ground
    bpy.ops.gscore.align_capture(capture=root.name, up="CAMERAS")
    np.testing.assert_allclose(matrix_to_numpy(root.matrix_basis), own, atol=1e-5)
    bpy.ops.gscore.align_capture(capture=root.name, up="CAPTURE")
    again = matrix_to_numpy(root.matrix_basis)[:3, :3] @ stated
    np.testing.assert_allclose(again, turned, atol=1e-5)


def test_another_machine(scene, tmp_path: Path) -> None:
    """Oracle: cameras as before; a message about the photo, which is found again at its new
    path."""
    shutil.copytree(STUDIO, tmp_path / "here" / "studio")
    made = import_capture(bpy.context.scene, tmp_path / "here" / "studio")
    (tmp_path / "here").rename(tmp_path / "there")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    scene = bpy.context.scene
    root = next(ob for ob in scene.objects if co.is_kind(ob, "capture"))
    ob = cameras_of(root)[0]
    assert "is missing" in captures.use_camera(scene, ob)[0]
    assert capture_transform.align_root(root).ground_found
    with pytest.raises(ValueError, match="none of the 60 photos"):
        captures.relink(root, tmp_path)
    assert root["gs_source"] == "//here/studio"
    assert captures.relink(root, tmp_path / "there" / "studio" / "images") == (60, 60)
    assert captures.use_camera(scene, ob) == []
    assert root["gs_source"] == "//there/studio"
    assert len(photo_of(ob).pixels) == 4 * 480 * 640
    del made


def test_undo(scene) -> None:
    """Oracle: the counts of all data before the operator."""
    bpy.ops.ed.undo_push(message="start")
    before = _counts()
    bpy.ops.gscore.import_cameras(directory=str(STUDIO))
    bpy.ops.ed.undo_push(message="imported")
    assert _counts() != before
    bpy.ops.ed.undo()
    assert _counts()["objects"] == before["objects"]
    bpy.ops.ed.redo()
    root = next(ob for ob in bpy.context.scene.objects if co.is_kind(ob, "capture"))
    assert len(cameras_of(root)) == 60


def test_moving_and_zooming_is_noticed(scene) -> None:
    """Oracle: a change of a hundredth of a pixel counts, another rotation mode does not."""
    made = import_capture(bpy.context.scene, STUDIO)
    ob = made.cameras[7]
    own = co.photo_camera_of(ob)
    ob.rotation_mode = "XYZ"
    assert not co.is_moved(ob, own)
    ob.rotation_euler.z += 1e-4
    assert co.is_moved(ob, own)
    ob = made.cameras[8]
    own = co.photo_camera_of(ob)
    ob.location.x += 1e-4
    assert co.is_moved(ob, own)
    ob.data.shift_x += 1e-4
    assert co.is_lens_changed(ob.data, own)
    ob = made.cameras[9]
    ob.constraints.new("COPY_LOCATION")
    assert co.is_moved(ob, co.photo_camera_of(ob))
    ob = made.cameras[10]
    ob.driver_add("location", 0).driver.expression = "frame"
    assert co.is_moved(ob, co.photo_camera_of(ob))
    made.root.location.x += 5
    assert not co.is_moved(made.cameras[0], co.photo_camera_of(made.cameras[0]))


def test_a_property_that_is_gone(scene) -> None:
    """Oracle: the sentence names camera and property."""
    made = import_capture(bpy.context.scene, STUDIO)
    del made.cameras[0]["gs_K"]
    with pytest.raises(ValueError, match=r"view_000 .*gs_K"):
        co.photo_camera_of(made.cameras[0])


def test_operators(scene) -> None:
    """Oracle: the results of the functions; errors of both kinds are reports."""
    with pytest.raises(RuntimeError, match="No capture is imported"):
        bpy.ops.gscore.use_camera(index=0)
    with pytest.raises(RuntimeError, match="Capture is empty"):
        bpy.ops.gscore.import_cameras()
    bpy.ops.gscore.import_cameras(directory=str(STUDIO))
    assert Path(scene.gscore.capture_path) == STUDIO
    bpy.ops.gscore.use_camera(camera="view_012.jpg")
    assert scene.camera["gs_image"] == "view_012.jpg"
    bpy.ops.gscore.step_camera(step=-2)
    assert scene.camera["gs_image"] == "view_010.jpg"
    bpy.ops.gscore.use_camera(index=3)
    assert scene.camera["gs_image"] == "view_003.jpg"
    bpy.ops.gscore.choose_camera(image="view_044.jpg")
    assert scene.camera["gs_image"] == "view_044.jpg"
    with pytest.raises(TypeError, match="view_099"):
        bpy.ops.gscore.choose_camera(image="view_099.jpg")
    bpy.ops.gscore.use_camera(index=3)
    with pytest.raises(RuntimeError, match="from 0 to 59"):
        bpy.ops.gscore.use_camera(index=60)
    with pytest.raises(RuntimeError, match="called nobody"):
        bpy.ops.gscore.use_camera(camera="nobody")
    root = root_of(scene.camera)
    bpy.ops.gscore.set_extent(extent=11.0)
    assert capture_transform.world_extent(root) == pytest.approx(11, rel=1e-6)
    assert scene.camera.data.clip_end == pytest.approx(1100, rel=1e-5)
    before = matrix_to_numpy(root.matrix_basis)
    bpy.ops.gscore.flip_up()
    flipped = matrix_to_numpy(root.matrix_basis)
    np.testing.assert_allclose(flipped[2, :3], -before[2, :3], atol=1e-3 * 11)
    bpy.context.view_layer.update()
    bpy.ops.gscore.align_capture(up="Z")
    np.testing.assert_allclose(matrix_to_numpy(root.matrix_basis), before, atol=1e-3)
    bpy.context.view_layer.update()
    bpy.ops.gscore.align_capture(up="VIEW")
    bpy.context.view_layer.update()
    bpy.ops.gscore.align_capture(up="CURRENT")
    np.testing.assert_allclose(matrix_to_numpy(root.matrix_basis), before, atol=1e-3)
    bpy.ops.gscore.reset_alignment()
    np.testing.assert_array_equal(matrix_to_numpy(root.matrix_basis), np.eye(4))


def test_two_captures(scene, capture: Path) -> None:
    """Oracle: the active object decides; without one, a name must be given."""
    a = import_capture(bpy.context.scene, STUDIO)
    b = import_capture(bpy.context.scene, capture)
    assert a.root != b.root and len(cameras_of(a.root)) == 60
    with pytest.raises(RuntimeError, match="several captures"):
        bpy.ops.gscore.use_camera(index=0)
    bpy.ops.gscore.use_camera(index=0, capture=b.root.name)
    assert scene.camera == b.cameras[0]
    bpy.context.view_layer.objects.active = a.points
    bpy.ops.gscore.use_camera(index=0)
    assert scene.camera == a.cameras[0]


def test_transforms_json(scene, tmp_path: Path) -> None:
    """Oracle: gscore's reader of the same file, photos decoded by Blender."""
    from addon.core import DataConfig

    made = import_capture(bpy.context.scene, STUDIO)
    bpy.ops.gscore.export_cameras(directory=str(tmp_path), kind="TRANSFORMS")
    shutil.copytree(STUDIO / "images", tmp_path / "images")
    bpy.ops.wm.read_homefile(use_empty=True)
    made = import_capture(bpy.context.scene, tmp_path / "transforms.json")
    views = {v.name: v for v in read_capture(DataConfig(source=tmp_path)).views}
    assert len(made.cameras) == 60 and len(made.points.data.vertices) == 6725
    for ob in made.cameras:
        own = co.photo_camera_of(ob)
        np.testing.assert_array_equal(own.viewmat, views[own.image].viewmat)
        np.testing.assert_array_equal(own.K, views[own.image].camera.K)
    assert captures.use_camera(bpy.context.scene, made.cameras[0]) == []


def test_cameras_of_metashape(scene, tmp_path: Path) -> None:
    """Oracle: the poses of the bundled model, which an independent script wrote as Metashape does;
    the panel names the file."""
    model = read_colmap(STUDIO)
    turns = np.stack([image.viewmat[:3, :3] for image in model.images])
    places = np.stack([-i.viewmat[:3, :3].T @ i.viewmat[:3, 3] for i in model.images])
    names = tuple(image.name for image in model.images)
    rig = Rig(names, turns, places, (480, 640), 856.7, terms={"k1": -0.01})
    shutil.copytree(STUDIO / "images", tmp_path / "images")
    file = write_metashape(tmp_path, rig)
    assert inspect(tmp_path / "images").lines()[0] == ("Metashape XML", str(file))
    made = import_capture(bpy.context.scene, tmp_path)
    assert len(made.cameras) == 60
    poses = {image.name: image.viewmat for image in model.images}
    for ob in made.cameras:
        np.testing.assert_allclose(
            co.photo_camera_of(ob).viewmat, poses[co.photo_camera_of(ob).image], atol=1e-6
        )


def test_one_switch_shows_all_photos_of_the_capture(scene, tmp_path: Path) -> None:
    """Oracle: Blender's own settings of each camera; a camera of the user keeps its own."""
    write_capture(tmp_path / "odd", np.random.default_rng(0), photos=True)
    made = import_capture(bpy.context.scene, tmp_path / "odd")
    own = bpy.data.objects.new("own", bpy.data.cameras.new("own"))
    scene.collection.objects.link(own)
    own.data.background_images.new().alpha, own.data.show_background_images = 0.25, True
    photos = scene.gscore_photos
    assert (photos.shown, photos.opacity) == (True, 1)
    photos.shown, photos.opacity = False, 0.5
    data = [ob.data for ob in made.cameras if ob.data.background_images]
    assert len(data) > 5
    assert {(d.show_background_images, d.background_images[0].alpha) for d in data} == {
        (False, 0.5)
    }
    assert own.data.show_background_images and own.data.background_images[0].alpha == 0.25
    data[0].show_background_images = True  # by hand; the switch shows that
    assert photos.shown
