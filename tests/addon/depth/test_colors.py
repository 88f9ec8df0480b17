"""Oracle: Blender's objects before and after, its undo, and its own drawing of cameras."""

from pathlib import Path

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from addon.cameras import camera_colors
from addon.cameras.lookup import roots_of
from addon.cameras.objects import cameras_of
from addon.capture import depth_maps
from addon.capture.depth_maps import ACCEPTED, MISSING, REFUSED, UNKNOWN, DepthReport, DepthRow
from addon.depth import colors as depth_colors
from addon.depth import predict_depth
from tests.addon.captures import write_capture

SQUARE = {1: ("PINHOLE", 60, 40, (50.0, 50.0, 30.0, 20.0))}
VERDICTS = (ACCEPTED, REFUSED, MISSING, UNKNOWN)


@pytest.fixture
def root(scene: bpy.types.Scene, tmp_path: Path) -> bpy.types.Object:
    """A capture of 8 cameras with different colors."""
    rng = np.random.default_rng(3)
    write_capture(tmp_path / "cap", rng, cameras=SQUARE, images=8, photos=True)
    bpy.ops.gscore.import_cameras(directory=str(tmp_path / "cap"))
    root = roots_of(scene)[0]
    for ob, color in zip(cameras_of(root), rng.random((8, 4)), strict=True):
        ob.color = color
    return root


def report(root: bpy.types.Object, shift: int = 0) -> DepthReport:
    """A report with alternating verdicts."""
    cameras = cameras_of(root)
    return DepthReport(
        tuple(
            DepthRow(view=ob["gs_image"], verdict=VERDICTS[(i + shift) % 4])
            for i, ob in enumerate(cameras)
        )
    )


def colors(root: bpy.types.Object) -> np.ndarray:
    """[8, 4]."""
    return np.array([tuple(ob.color) for ob in cameras_of(root)])


def test_colors_come_and_go(root: bpy.types.Object) -> None:
    """Oracle: the palette, and the colors the user had, bit for bit."""
    before = colors(root)
    assert depth_colors.show(root, report(root)) == 6
    now = colors(root)
    for i in range(8):
        expected = depth_colors.PALETTE.get(VERDICTS[i % 4])
        np.testing.assert_allclose(now[i], before[i] if expected is None else expected, rtol=1e-6)
    assert depth_colors.shown(root) and depth_colors.matches(root, report(root))
    assert not depth_colors.matches(root, report(root, 1))
    depth_colors.show(root, report(root, 1))
    depth_colors.show(root, report(root, 1))
    camera_colors.hide(root)
    np.testing.assert_array_equal(colors(root), before)
    assert not depth_colors.shown(root)
    assert not any(key.startswith("gs_color") for ob in cameras_of(root) for key, _ in ob.items())


def test_a_color_the_user_gives_meanwhile_stays(root: bpy.types.Object) -> None:
    """Oracle: the color given."""
    depth_colors.show(root, report(root))
    camera = cameras_of(root)[0]
    camera.color = (0.25, 0.5, 0.75, 1.0)
    camera_colors.hide(root)
    assert tuple(camera.color) == (0.25, 0.5, 0.75, 1.0)


def test_colors_survive_a_file(root: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the colors from before, after saving, loading and hiding."""
    before = colors(root)
    depth_colors.show(root, report(root))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "x.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "x.blend"))
    again = roots_of(bpy.context.scene)[0]
    assert depth_colors.matches(again, report(again))
    bpy.ops.gscore.color_cameras(show=False)
    np.testing.assert_array_equal(colors(again), before)


def test_the_operator_takes_the_scenes_report(
    root: bpy.types.Object, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the report; without one, or of another capture, an error and no change."""
    scene, before = bpy.context.scene, colors(root)
    scene.gscore.capture_path = ""
    with pytest.raises(RuntimeError, match="no depth report yet"):
        bpy.ops.gscore.color_cameras()
    other = DepthReport((DepthRow(view="elsewhere.jpg", verdict=ACCEPTED),))
    monkeypatch.setattr(predict_depth, "report", lambda scene: other)
    with pytest.raises(RuntimeError, match="has no camera"):
        bpy.ops.gscore.color_cameras()
    np.testing.assert_array_equal(colors(root), before)
    monkeypatch.setattr(predict_depth, "report", lambda scene: report(root))
    assert bpy.ops.gscore.color_cameras() == {"FINISHED"}
    assert depth_colors.matches(root, report(root))


def test_colors_follow_the_report(root: bpy.types.Object, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the later report; nothing where no camera is colored."""
    first, second = report(root), report(root, 1)
    monkeypatch.setattr(predict_depth, "report", lambda scene: second)
    assert not depth_colors.follow() and not depth_colors.shown(root)
    depth_colors.show(root, first)
    monkeypatch.setattr(predict_depth, "report", lambda scene: first)
    assert not depth_colors.follow()
    monkeypatch.setattr(predict_depth, "report", lambda scene: second)
    assert depth_colors.follow() and depth_colors.matches(root, second)
    assert not depth_colors.follow()


def test_undo_takes_the_colors_back(
    root: bpy.types.Object, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: Blender's undo and redo."""
    before = colors(root)
    monkeypatch.setattr(predict_depth, "report", lambda scene: report(roots_of(scene)[0]))
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.gscore.color_cameras()
    bpy.ops.ed.undo_push(message="colored")
    assert depth_colors.shown(root)
    bpy.ops.ed.undo()
    root = roots_of(bpy.context.scene)[0]
    assert not depth_colors.shown(root)
    np.testing.assert_array_equal(colors(root), before)
    bpy.ops.ed.redo()
    assert depth_colors.shown(roots_of(bpy.context.scene)[0])


def test_drawn_frames_match_the_cameras(root: bpy.types.Object) -> None:
    """Oracle: by Blender's own projection, the corners are those of the camera's picture."""
    scene = bpy.context.scene
    bpy.ops.gscore.use_camera(index=0, look_through=False)
    bpy.context.view_layer.update()
    some = cameras_of(root)[:3]
    for ob, (place, *frame) in zip(some, camera_colors.corners(some, scene), strict=True):
        np.testing.assert_allclose(place, ob.matrix_world.translation, atol=1e-6)
        seen = [world_to_camera_view(scene, ob, Vector(corner))[:2] for corner in frame]
        ends = [(0, 0), (0, 1), (1, 0), (1, 1)]
        np.testing.assert_allclose(sorted(map(tuple, np.round(seen, 3))), ends, atol=2e-3)
        widest = max(np.linalg.norm(frame[i] - frame[j]) for i, j in ((0, 1), (1, 2)))
        assert widest == pytest.approx(ob.data.display_size, rel=1e-4)


def test_a_selected_camera_keeps_its_lines(root: bpy.types.Object) -> None:
    """Oracle: eight lines a camera, none for the selected one; every plane is filled."""
    scene = bpy.context.scene
    depth_colors.show(root, report(root))
    cameras = [ob for ob in cameras_of(root) if camera_colors.MARK in ob]
    cameras[0].select_set(True)
    lines, line_colors, faces, face_colors = camera_colors.geometry(cameras, scene)
    assert (lines.shape, faces.shape) == ((5 * 16, 3), (6 * 6, 3))
    assert len(line_colors) == len(lines) and len(face_colors) == len(faces)
    assert tuple(face_colors[0][:3]) == pytest.approx(depth_colors.PALETTE[ACCEPTED][:3])
    assert depth_maps.UNKNOWN not in depth_colors.PALETTE
