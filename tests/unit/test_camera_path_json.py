"""Camera path files. Each test names its oracle."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from gscore.datasets.camera_path_json import read_camera_path, write_nerfstudio_path
from gscore.errors import ConfigError, DatasetError, FormatError
from gscore.io.cameras_json import write_cameras
from gscore.scene import Cameras

# One unit right of the origin, four units up the z axis, turned a quarter about z.
POSE = [0.0, -1, 0, 1, 1, 0, 0, 0, 0, 0, 1, 4, 0, 0, 0, 1]
NERFSTUDIO = {
    "camera_type": "perspective",
    "render_width": 200,
    "render_height": 100,
    "fps": 24,
    "seconds": 1,
    "camera_path": [
        {"camera_to_world": POSE, "fov": 90, "aspect": 2.0},
        {"camera_to_world": [POSE[i : i + 4] for i in range(0, 16, 4)], "fov": 60},
    ],
}


def written(folder: Path, content: object) -> Path:
    """The file."""
    path = folder / "path.json"
    path.write_text(json.dumps(content))
    return path


def test_the_path_of_nerfstudios_viewer(tmp_path: Path) -> None:
    """Oracle: a point projected by hand: OpenGL poses, a vertical field of view."""
    found = read_camera_path(written(tmp_path, NERFSTUDIO))
    cameras = found.cameras
    assert found.fps == 24 and len(cameras) == 2
    assert (cameras.widths[0], cameras.heights[0]) == (200, 100)
    for K, viewmat, fov in zip(cameras.Ks, cameras.viewmats, (90, 60), strict=True):
        focal = 50 / math.tan(math.radians(fov / 2))
        # World (1, 3, 2) is 2 units in front of the camera and 3 to its right, which is world +y.
        at = viewmat @ (1, 3, 2, 1)
        np.testing.assert_allclose(at, (3, 0, 2, 1), atol=1e-12)
        pixel = K @ at[:3] / at[2]
        np.testing.assert_allclose(pixel, (100 + focal * 1.5, 50, 1), rtol=1e-12)


def test_a_path_for_nerfstudios_viewer_comes_back(tmp_path: Path) -> None:
    """Oracles: the written cameras; the file of the viewer, pose by pose."""
    read = read_camera_path(written(tmp_path, NERFSTUDIO))
    write_nerfstudio_path(tmp_path / "again.json", read.cameras, fps=23.976)
    again = read_camera_path(tmp_path / "again.json")
    np.testing.assert_allclose(again.cameras.viewmats, read.cameras.viewmats, atol=1e-12)
    np.testing.assert_allclose(again.cameras.Ks, read.cameras.Ks, rtol=1e-12)
    assert again.fps == 23.976 and list(again.cameras.widths) == [200, 200]
    content = json.loads((tmp_path / "again.json").read_text())
    for key, entry, fov in zip(content["keyframes"], content["camera_path"], (90, 60), strict=True):
        np.testing.assert_allclose(key["matrix"], POSE, atol=1e-12)
        assert key["matrix"] == entry["camera_to_world"]
        assert entry["fov"] == key["fov"] == pytest.approx(fov) and entry["aspect"] == 2
    assert [entry["render_time"] for entry in content["camera_path"]] == [0, 1]
    assert content["seconds"] == pytest.approx(2 / 23.976)


@pytest.mark.parametrize(
    ("row", "column", "value"), [(0, 0, 60.0), (0, 2, 101.0), (1, 2, 49.0), (None, None, None)]
)
def test_lenses_that_nerfstudio_cannot_state(tmp_path: Path, row, column, value) -> None:
    """Oracle: a sentence that names the second camera, and no file."""
    cameras = read_camera_path(written(tmp_path, NERFSTUDIO)).cameras
    if row is None:
        cameras.widths[1] = 210
    else:
        cameras.Ks[1, row, column] = value
    with pytest.raises(ConfigError, match=r"frame_000002.*transforms\.json"):
        write_nerfstudio_path(tmp_path / "again.json", cameras, fps=24)
    assert not (tmp_path / "again.json").exists()


def test_frames_come_in_the_order_of_their_time(tmp_path: Path) -> None:
    """Oracle: the times; without them, the order of the file."""
    rows = [POSE[i : i + 4] for i in range(0, 16, 4)]
    frames = [
        {"file_path": f"{n}.png", "transform_matrix": rows, "time": t}
        for n, t in (("c", 0.9), ("a", 0.0), ("b", 0.5))
    ]
    content = {"fl_x": 90, "fl_y": 80, "cx": 33, "cy": 44, "w": 100, "h": 70, "frames": frames}
    found = read_camera_path(written(tmp_path, content))
    assert found.cameras.names == ("a.png", "b.png", "c.png") and not found.warnings
    np.testing.assert_array_equal(found.cameras.Ks[0], [[90, 0, 33], [0, 80, 44], [0, 0, 1]])
    assert found.fps is None
    content["fps"] = 30
    assert read_camera_path(written(tmp_path, content)).fps == 30
    del frames[1]["time"]
    assert read_camera_path(written(tmp_path, content)).cameras.names == ("c.png", "a.png", "b.png")
    content["k1"] = 0.1
    assert "3 of 3 frames" in read_camera_path(written(tmp_path, content)).warnings[0]


def test_cameras_json_is_read_as_ever(tmp_path: Path) -> None:
    """Oracle: the written cameras."""
    cameras = Cameras(
        viewmats=np.tile(np.eye(4), (2, 1, 1)),
        Ks=np.tile(np.array([[50.0, 0, 20], [0, 60, 15], [0, 0, 1]]), (2, 1, 1)),
        widths=np.array([40, 40]),
        heights=np.array([30, 30]),
        names=("a", "b"),
    )
    write_cameras(tmp_path / "cameras.json", cameras)
    found = read_camera_path(tmp_path / "cameras.json")
    assert found.cameras.names == ("a", "b") and found.fps is None
    np.testing.assert_array_equal(found.cameras.Ks, cameras.Ks)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        ({"camera_type": "fisheye"}, "camera_type is 'fisheye'"),
        ({"render_width": 0}, "render_width is 0"),
        ({"render_height": "7"}, "render_height is '7'"),
        ({"fps": -1}, "fps is -1"),
        ({"fps": "fast"}, "fps is 'fast'"),
        ({"camera_path": [{"camera_to_world": POSE[:15], "fov": 50}]}, "camera 0: camera_to_world"),
        ({"camera_path": [{"camera_to_world": POSE, "fov": 180}]}, "camera 0: the focal lengths"),
        ({"camera_path": [{"camera_to_world": POSE}]}, "camera 0: fov is None"),
        ({"camera_path": [7]}, "camera 0 is not an object"),
        ({"camera_path": 7}, "is not a camera path"),
    ],
)
def test_damaged_field_is_named(tmp_path: Path, spoil: dict, words: str) -> None:
    """Oracle: the damaged field."""
    with pytest.raises(FormatError, match=words):
        read_camera_path(written(tmp_path, NERFSTUDIO | spoil))


def test_paths_without_cameras(tmp_path: Path) -> None:
    """Oracle: the sentence, for each kind of file, and for a missing one."""
    for content in ([], {"frames": []}, NERFSTUDIO | {"camera_path": []}):
        with pytest.raises(DatasetError, match="contains no cameras"):
            read_camera_path(written(tmp_path, content))
    with pytest.raises(DatasetError, match=r"gone\.json"):
        read_camera_path(tmp_path / "gone.json")
    (tmp_path / "path.json").write_text("{")
    with pytest.raises(FormatError, match="is not JSON"):
        read_camera_path(tmp_path / "path.json")


def test_fisheye_lenses_are_refused(tmp_path: Path) -> None:
    """Oracle: the camera model of the file."""
    rows = [POSE[i : i + 4] for i in range(0, 16, 4)]
    content = {"fl_x": 90, "w": 100, "h": 70, "camera_model": "OPENCV_FISHEYE"}
    content["frames"] = [{"file_path": "a.png", "transform_matrix": rows}]
    with pytest.raises(FormatError, match="OPENCV_FISHEYE"):
        read_camera_path(written(tmp_path, content))
