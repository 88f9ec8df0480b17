"""Animated cameras written and read back; the cameras of a file project as Blender's."""

import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from addon.cameras import camera_math as cm
from addon.cameras import capture_transform
from addon.cameras.render_camera import render_camera
from addon.core import write_splats
from addon.splats import objects
from gscore.datasets.camera_path_json import read_camera_path
from gscore.io.cameras_json import read_cameras_json as read_cameras
from tests.addon import splat_scenes as lab
from tests.addon.calls import export_path, import_capture
from tests.addon.captures import write_capture

ROOT = Path(__file__).parents[3]
POINTS = [(0.0, 0.0, 0.0), (0.7, -0.4, 1.0), (-0.5, 0.8, 0.3)]


@pytest.fixture
def camera(scene) -> bpy.types.Object:
    """The scene camera with an animated position, rotation, lens and shift over six frames."""
    data = bpy.data.cameras.new("moving")
    ob = bpy.data.objects.new("moving", data)
    scene.collection.objects.link(ob)
    scene.camera, scene.frame_start, scene.frame_end = ob, 3, 8
    scene.render.resolution_x, scene.render.resolution_y = 320, 180
    for frame, place, turn, lens, shift in ((3, 0.0, 0.0, 30.0, 0.0), (8, 2.0, 0.6, 70.0, 0.2)):
        ob.location, ob.rotation_euler = (place, -place, 6.0), (turn, 0.0, turn / 2)
        data.lens, data.shift_x = lens, shift
        for owner, path in ((ob, "location"), (ob, "rotation_euler"), (data, "lens")):
            owner.keyframe_insert(path, frame=frame)
        data.keyframe_insert("shift_x", frame=frame)
    return ob


def test_each_frame_projects_as_blender(scene, camera, tmp_path: Path) -> None:
    """Oracle: Blender's own projection of three points at each frame."""
    scene.frame_set(5)
    file = tmp_path / "path.json"
    assert bpy.ops.gscore.export_camera_path(
        filepath=str(file), world="BLENDER", kind="TRANSFORMS"
    ) == {"FINISHED"}
    assert scene.frame_current == 5
    written = json.loads(file.read_text())
    assert len(written["frames"]) == 6
    points = np.array([(0.0, 0.0, 0.0), (0.7, -0.4, 1.0), (-0.5, 0.8, 0.3)])
    for number, frame in zip(range(3, 9), written["frames"], strict=True):
        values = {**written, **frame}
        K = np.eye(3)
        K[[0, 1, 0, 1], [0, 1, 2, 2]] = [values[key] for key in ("fl_x", "fl_y", "cx", "cy")]
        viewmat = cm.viewmat_from_matrix_world(np.array(values["transform_matrix"]))
        ours, _ = cm.project(points, K, viewmat)
        scene.frame_set(number)
        seen = [world_to_camera_view(scene, camera, Vector(point)) for point in points]
        theirs = [(at.x * 320, (1 - at.y) * 180) for at in seen]
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-2)


def test_orthographic_camera_is_refused(scene, camera, tmp_path: Path) -> None:
    """Oracle: no file, the sentence of the export, and the frame as it was."""
    camera.data.type = "ORTHO"
    scene.frame_set(4)
    with pytest.raises(RuntimeError, match="moving"):
        bpy.ops.gscore.export_camera_path(filepath=str(tmp_path / "p.json"), world="BLENDER")
    assert not list(tmp_path.iterdir()) and scene.frame_current == 4


def test_gscore_reads_the_same_cameras(scene, camera, tmp_path: Path) -> None:
    """Oracle: the transforms.json of the same frames, number for number."""
    files = {kind: tmp_path / f"{kind}.json" for kind in ("CAMERAS", "TRANSFORMS")}
    for kind, file in files.items():
        bpy.ops.gscore.export_camera_path(filepath=str(file), world="BLENDER", kind=kind)
    read = read_cameras(files["CAMERAS"])
    other = json.loads(files["TRANSFORMS"].read_text())
    for i, frame in enumerate(other["frames"]):
        values = {**other, **frame}
        K = [values[key] for key in ("fl_x", "fl_y", "cx", "cy")]
        np.testing.assert_allclose(read.Ks[i][[0, 1, 0, 1], [0, 1, 2, 2]], K, rtol=1e-12)
        viewmat = cm.viewmat_from_matrix_world(np.array(values["transform_matrix"]))
        np.testing.assert_allclose(read.viewmats[i], viewmat, rtol=0, atol=1e-6)


def seen(scene, camera) -> list[np.ndarray]:
    """Blender's own projection of three points at each frame of the scene, [3, 2] pixels."""
    found, render = [], scene.render
    for number in range(scene.frame_start, scene.frame_end + 1, scene.frame_step):
        scene.frame_set(number)
        at = [world_to_camera_view(scene, camera, Vector(point)) for point in POINTS]
        size = render.resolution_x, render.resolution_y
        found.append(np.array([(p.x * size[0], (1 - p.y) * size[1]) for p in at]))
    return found


def capture_with(camera) -> bpy.types.Object:
    """A capture that is rotated, moved and scaled in the scene."""
    made = import_capture(bpy.context.scene, ROOT / "examples" / "studio", photos=False)
    capture_transform.set_root_matrix(made.root, made_matrix())
    bpy.context.view_layer.update()
    return made.root


def made_matrix() -> np.ndarray:
    """A similarity."""
    c, s = np.cos(0.7), np.sin(0.7)
    matrix = np.eye(4)
    matrix[:3, :3] = 1.7 * np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    matrix[:3, 3] = 0.4, -1.1, 0.3
    return matrix


@pytest.mark.parametrize("step", [1, 5])
@pytest.mark.parametrize("kind", ["CAMERAS", "TRANSFORMS"])
@pytest.mark.parametrize("world", ["BLENDER", "CAPTURE"])
def test_a_path_comes_back(scene, camera, tmp_path: Path, kind, world, step) -> None:
    """Oracle: Blender's projection through the camera that was written, at each frame."""
    if world == "CAPTURE":
        capture_with(camera)
    scene.camera, scene.frame_step = camera, step
    camera.data.sensor_fit = "VERTICAL"
    before = seen(scene, camera)
    file = str(tmp_path / "walk.json")
    bpy.ops.gscore.export_camera_path(filepath=file, world=world, kind=kind)
    scene.frame_start, scene.frame_end, scene.render.resolution_x = 1, 250, 1920
    scene.frame_step = 4
    assert bpy.ops.gscore.import_camera_path(filepath=file, world=world) == {"FINISHED"}
    again = scene.camera
    assert again != camera and again.name == "walk" and bpy.context.object == again
    assert (scene.frame_start, scene.frame_end, scene.frame_step) == (3, 8, 1)
    assert (scene.render.resolution_x, scene.render.resolution_y) == (320, 180)
    scene.frame_step = step
    for ours, theirs in zip(seen(scene, again), before, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-2)


def without_shift(camera) -> None:
    """Remove the lens's shift and its keyframes."""
    for curve in lab.curves(camera.data):
        if curve.data_path == "shift_x":
            for key in curve.keyframe_points:
                key.co.y = key.handle_left.y = key.handle_right.y = 0
    camera.data.shift_x = 0


@pytest.mark.parametrize("world", ["BLENDER", "CAPTURE"])
def test_a_path_for_nerfstudio(scene, camera, tmp_path: Path, world) -> None:
    """Oracles: Blender's projection at each frame, compared with nerfstudio's formulas on the file
    and with the imported camera; its size, frame rate and times."""
    if world == "CAPTURE":
        capture_with(camera)
    scene.camera = camera
    without_shift(camera)
    scene.render.fps, scene.render.fps_base = 30, 1.001
    before = seen(scene, camera)
    file = tmp_path / "walk.json"
    export = bpy.ops.gscore.export_camera_path
    assert export(filepath=str(file), world=world, kind="NERFSTUDIO") == {"FINISHED"}
    written = json.loads(file.read_text())
    assert (written["render_width"], written["render_height"]) == (320, 180)
    assert written["fps"] == pytest.approx(30 / 1.001)
    assert written["seconds"] == pytest.approx(6 / written["fps"])
    keys = [(key["matrix"], key["fov"]) for key in written["keyframes"]]
    entries = written["camera_path"]
    assert keys == [(entry["camera_to_world"], entry["fov"]) for entry in entries]
    times = [entry["render_time"] for entry in entries]
    np.testing.assert_allclose(times, [0, 0.2, 0.4, 0.6, 0.8, 1])
    to_file = np.linalg.inv(made_matrix()) if world == "CAPTURE" else np.eye(4)
    for entry, wanted in zip(entries, before, strict=True):
        # nerfstudio: OpenGL axes, focal length of the height's field of view, the axis in the
        # middle.
        pose = np.reshape(entry["camera_to_world"], (4, 4))
        focal = 0.5 * 180 / np.tan(0.5 * np.radians(entry["fov"]))
        for point, pixel in zip(POINTS, wanted, strict=True):
            x, y, z, _ = np.linalg.inv(pose) @ to_file @ (*point, 1)
            at = 160 + focal * x / -z, 90 - focal * y / -z
            np.testing.assert_allclose(at, pixel, rtol=0, atol=1e-2)
        assert entry["aspect"] == pytest.approx(320 / 180)
    scene.render.fps = 24
    bpy.ops.gscore.import_camera_path(filepath=str(file), world=world, start=3, numbered=False)
    assert (scene.frame_start, scene.frame_end) == (3, 8)
    assert scene.render.fps / scene.render.fps_base == pytest.approx(30 / 1.001)
    for ours, theirs in zip(seen(scene, scene.camera), before, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-2)


@pytest.mark.parametrize("what", ["shift", "pixels"])
def test_nerfstudio_has_no_such_lens(scene, camera, tmp_path: Path, what) -> None:
    """Oracle: a sentence that names the frame, and no file."""
    if what == "pixels":
        without_shift(camera)
        scene.render.pixel_aspect_x = 1.5
    text = lab.error_of(
        lambda: bpy.ops.gscore.export_camera_path(
            filepath=str(tmp_path / "p.json"), world="BLENDER", kind="NERFSTUDIO"
        )
    )
    first = "frame_000004" if what == "shift" else "frame_000003"
    assert first in text and "transforms.json" in text and not list(tmp_path.iterdir())


def test_transforms_have_times(scene, camera, tmp_path: Path) -> None:
    """Oracle: 0 to 1 over the rendered frames; the frame rate is restored."""
    scene.render.fps = 50
    file = tmp_path / "p.json"
    export = bpy.ops.gscore.export_camera_path
    export(filepath=str(file), world="BLENDER", kind="TRANSFORMS")
    written = json.loads(file.read_text())
    times = [frame["time"] for frame in written["frames"]]
    np.testing.assert_allclose(times, [0, 0.2, 0.4, 0.6, 0.8, 1])
    assert written["fps"] == 50
    scene.render.fps = 24
    bpy.ops.gscore.import_camera_path(filepath=str(file), world="BLENDER")
    assert scene.render.fps / scene.render.fps_base == 50


@pytest.mark.parametrize("numbered", [True, False])
@pytest.mark.parametrize("kind", ["TRANSFORMS", "NERFSTUDIO"])
def test_a_step_keeps_the_time_that_a_path_takes(
    scene, camera, tmp_path: Path, kind, numbered
) -> None:
    """Oracle: Blender's timeline: seconds between the first and the last picture, in the file, by
    gscore's reader and in the imported camera."""
    without_shift(camera)
    scene.render.fps, scene.render.fps_base, scene.frame_step = 50, 1.001, 2
    wanted = 4 * 1.001 / 50  # of frames 3, 5 and 7
    file = tmp_path / "p.json"
    bpy.ops.gscore.export_camera_path(filepath=str(file), world="BLENDER", kind=kind)
    written = json.loads(file.read_text())
    read = read_camera_path(file)
    assert len(read.cameras) == 3
    assert 2 / written["fps"] == 2 / read.fps == pytest.approx(wanted)
    if kind == "NERFSTUDIO":
        assert written["seconds"] == pytest.approx(3 * wanted / 2)
        assert written["default_transition_sec"] == pytest.approx(wanted / 2)
        assert [entry["render_time"] for entry in written["camera_path"]] == [0, 0.5, 1]
    else:
        assert [frame["time"] for frame in written["frames"]] == [0, 0.5, 1]
    scene.render.fps, scene.render.fps_base = 24, 1
    bpy.ops.gscore.import_camera_path(filepath=str(file), world="BLENDER", numbered=numbered)
    frames = scene.frame_end - scene.frame_start
    assert frames == (4 if numbered and kind == "TRANSFORMS" else 2)
    assert frames * scene.render.fps_base / scene.render.fps == pytest.approx(wanted)


def test_a_path_of_one_camera_keeps_its_pace(scene, camera, tmp_path: Path) -> None:
    """Oracle: the scene's frame rate, which cannot be derived from a single picture."""
    scene.render.fps, scene.frame_end = 50, 3
    file = tmp_path / "p.json"
    bpy.ops.gscore.export_camera_path(filepath=str(file), world="BLENDER", kind="TRANSFORMS")
    scene.render.fps = 24
    bpy.ops.gscore.import_camera_path(filepath=str(file), world="BLENDER")
    assert scene.render.fps / scene.render.fps_base == 50


@pytest.mark.skipif(not bpy.app.build_options.alembic, reason="this Blender has no Alembic")
def test_cameras_of_alembic_files(scene, camera, tmp_path: Path) -> None:
    """Oracle: the path of the camera that Blender itself wrote to Alembic and read again."""
    bpy.ops.object.select_all(action="DESELECT")
    camera.select_set(True)
    if bpy.app.version < (
        5,
        2,
    ):  # of an animated lens, Blender 4.2 and 5.0 read the first frame only
        camera.data.animation_data_clear()
    file, paths = str(tmp_path / "walk.abc"), [tmp_path / "before.json", tmp_path / "after.json"]
    bpy.ops.gscore.export_camera_path(filepath=str(paths[0]), world="BLENDER", kind="TRANSFORMS")
    bpy.ops.wm.alembic_export(filepath=file, start=3, end=8, selected=True, as_background_job=False)
    bpy.data.objects.remove(camera)
    bpy.ops.wm.alembic_import(filepath=file, as_background_job=False, set_frame_range=False)
    scene.camera = next(ob for ob in scene.objects if ob.type == "CAMERA")
    bpy.ops.gscore.export_camera_path(filepath=str(paths[1]), world="BLENDER", kind="TRANSFORMS")
    before, after = (json.loads(path.read_text()) for path in paths)
    assert len(before["frames"]) == len(after["frames"]) == 6
    for theirs, ours in zip(before["frames"], after["frames"], strict=True):
        for key in ("transform_matrix", "fl_x", "cx", "cy"):
            want, got = ({**whole, **one}[key] for whole, one in ((before, theirs), (after, ours)))
            np.testing.assert_allclose(got, want, rtol=2e-4, atol=1e-4)


def test_the_path_of_nerfstudios_viewer(scene, tmp_path: Path) -> None:
    """Oracle: points projected by hand, with the vertical field of view; its size and frame
    rate."""
    pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
    entries = [
        {"camera_to_world": np.ravel(pose).tolist(), "fov": fov, "aspect": 1} for fov in (90, 40)
    ]
    content = {"render_width": 400, "render_height": 200, "fps": 23.976, "camera_path": entries}
    file = tmp_path / "camera_path.json"
    file.write_text(json.dumps(content))
    bpy.ops.gscore.import_camera_path(filepath=str(file), world="BLENDER", numbered=False, start=7)
    render = scene.render
    assert (scene.frame_start, scene.frame_end, render.fps) == (7, 8, 24)
    assert render.fps / render.fps_base == pytest.approx(23.976, rel=1e-6)
    for ours, fov in zip(seen(scene, scene.camera), (90, 40), strict=True):
        focal = 100 / np.tan(np.radians(fov / 2))
        want = [(200 + focal * x / (4 - z), 100 - focal * y / (4 - z)) for x, y, z in POINTS]
        np.testing.assert_allclose(ours, want, rtol=0, atol=1e-2)


def test_pixels_that_are_not_square(scene, tmp_path: Path) -> None:
    """Oracle: K of the file; a scene has one pixel aspect, so a path with two is refused."""

    def entry(fy: float) -> dict:
        return {
            "id": 0,
            "img_name": "a",
            "width": 300,
            "height": 200,
            "fx": 250,
            "fy": fy,
            "position": [0, 0, 0],
            "rotation": np.eye(3).tolist(),
        }

    file = tmp_path / "path.json"
    file.write_text(json.dumps([entry(200), entry(200)]))
    bpy.ops.gscore.import_camera_path(filepath=str(file), world="BLENDER")
    got = render_camera(scene.camera, scene)
    np.testing.assert_allclose(got.K, [[250, 0, 150], [0, 200, 100], [0, 0, 1]], rtol=1e-6)
    file.write_text(json.dumps([entry(200), entry(210)]))
    count = len(bpy.data.cameras)
    message = lab.error_of(
        lambda: bpy.ops.gscore.import_camera_path(filepath=str(file), world="BLENDER")
    )
    assert "pixels in " in message and len(bpy.data.cameras) == count


def test_the_other_half_of_a_turn(scene, tmp_path: Path) -> None:
    """Oracle: the angle between neighbours; a camera must not swing around between two frames."""
    entries = []
    for i, angle in enumerate(np.linspace(0, 2 * np.pi, 13)):
        c, s = np.cos(angle), np.sin(angle)
        turn = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
        entries.append(
            {
                "id": i,
                "img_name": f"{2 * i}",
                "width": 30,
                "height": 20,
                "fx": 25,
                "fy": 25,
                "position": [0, 0, 0],
                "rotation": turn,
            }
        )
    file = tmp_path / "path.json"
    file.write_text(json.dumps(entries))
    bpy.ops.gscore.import_camera_path(filepath=str(file), world="BLENDER")
    forward = []
    for number in range(25):  # every second one is between two cameras of the file
        scene.frame_set(number)
        forward.append(np.array(scene.camera.matrix_world)[:3, 2])
    cosines = [np.clip(a @ b, -1, 1) for a, b in pairwise(forward)]
    steps = np.degrees(np.arccos(cosines))
    assert steps.max() < 25 and steps.min() > 5


@pytest.mark.parametrize("kind", ["CAMERAS", "TRANSFORMS", "NERFSTUDIO"])
def test_gscore_render_draws_what_f12_does(scene, camera, tmp_path: Path, kind) -> None:
    """Oracle: F12 at each frame; the splats are children of a rotated, scaled capture."""
    root = capture_with(camera)
    splats = lab.blob(3000, size=1.2)
    objects.create(splats, "s", collection=scene.collection, parent=root)
    write_splats(tmp_path / "s.ply", splats)
    lab.prepare(scene, (320, 180))
    scene.camera, scene.frame_step = camera, 5
    # The visible position of the blob, in the capture's space.
    camera.parent = root
    names = {3: "frame_000003", 8: "frame_000008"}
    if kind == "NERFSTUDIO":  # which has no names and no shift
        names = {3: "frame_000001", 8: "frame_000002"}
        without_shift(camera)
    file = tmp_path / "path.json"
    bpy.ops.gscore.export_camera_path(filepath=str(file), world="CAPTURE", kind=kind)
    command = [sys.executable, "-m", "gscore", "render", str(tmp_path / "s.ply"), "--quiet"]
    command += ["--path", str(file), "--near", str(camera.data.clip_start / 1.7)]
    subprocess.run([*command, "-o", str(tmp_path / "out")], check=True, cwd=ROOT)
    for number, name in names.items():
        scene.frame_set(number)
        got = lab.render_file(tmp_path / "blender.png")
        want = lab.read_image(next((tmp_path / "out").rglob(f"{name}.png")))
        assert np.abs(got - want).mean() < 2 / 255 and np.abs(got - want).max() < 4 / 255
        assert want[..., :3].std() > 0.05


def test_a_camera_of_a_straightened_photo(scene, tmp_path: Path) -> None:
    """Oracle: its pinhole camera in Blender, with the size of the undistorted photo and the
    animated lens."""
    write_capture(tmp_path / "c", np.random.default_rng(0))
    made = import_capture(scene, tmp_path / "c")
    ob = next(ob for ob in made.cameras if ob["gs_model"] == "OPENCV")
    scene.frame_start, scene.frame_end = 1, 2
    ob.data.keyframe_insert("lens", frame=1)
    ob.data.lens *= 2
    ob.data.keyframe_insert("lens", frame=2)
    assert export_path(tmp_path / "p.json", ob, scene, root=made.root) == 2
    found = read_cameras(tmp_path / "p.json")
    assert [found.widths[0], found.heights[0]] == list(ob["gs_size"])
    K = np.reshape(ob["gs_K"], (3, 3))
    np.testing.assert_allclose(found.Ks[0], K, rtol=1e-5)
    np.testing.assert_allclose(found.Ks[1][[0, 1], [0, 1]], 2 * K[[0, 1], [0, 1]], rtol=1e-5)
