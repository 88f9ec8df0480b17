"""An animated camera written out: what stands in the file projects as Blender does."""

import json
from pathlib import Path

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from addon.cameras import formulas as cm
from gscore.io.cameras_json import read_cameras_json as read_cameras


@pytest.fixture
def camera(scene) -> bpy.types.Object:
    """The scene camera, whose place, turn, lens and shift change over six frames."""
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
