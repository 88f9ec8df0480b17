"""transforms.json of nerfstudio, Instant-NGP and synthetic NeRF, by hand and by projection."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import plyfile
import pytest

from gscore.config import DataConfig
from gscore.datasets import Dataset, load_dataset
from gscore.datasets.capture import repeated
from gscore.datasets.transforms_json import read_transforms
from gscore.errors import DatasetError, FormatError, GsError
from gscore.io.images.png import write_png

_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def _write(path: Path, data: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(data))


def _load(root: Path, **options: Any) -> Dataset:
    return load_dataset(DataConfig(source=root, **options))


@pytest.fixture
def nerfstudio(make_capture: Callable, tmp_path: Path) -> tuple[Path, Any]:
    """The same capture twice: as a COLMAP model in memory and as nerfstudio's files on disk."""
    capture = make_capture(write=False)
    root = tmp_path / "ns"
    frames = []
    for image in capture.model.images:
        write_png(root / "images" / image.name, capture.photos[image.name])
        pose = np.linalg.inv(image.viewmat) @ _FLIP
        frames.append({"file_path": f"images/{image.name}", "transform_matrix": pose.tolist()})
    fx, fy, cx, cy = capture.model.cameras[1].params.tolist()
    data = {
        "camera_model": "OPENCV",
        "fl_x": fx,
        "fl_y": fy,
        "cx": cx,
        "cy": cy,
        "w": 64,
        "h": 48,
        "k1": 0.0,
        "k2": 0.0,
        "p1": 0.0,
        "p2": 0.0,
        "applied_transform": [[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0]],
        "ply_file_path": "sparse_pc.ply",
        "frames": frames,
    }
    table = np.zeros(6, [(n, "f4") for n in "xyz"] + [(n, "u1") for n in ("red", "green", "blue")])
    for k, n in enumerate("xyz"):
        table[n] = capture.model.points.xyz[:, k]
    for k, n in enumerate(("red", "green", "blue")):
        table[n] = capture.model.points.rgb[:, k]
    plyfile.PlyData([plyfile.PlyElement.describe(table, "vertex")]).write(
        str(root / "sparse_pc.ply")
    )
    _write(root / "transforms.json", data)
    return root, capture


def test_nerfstudio_equals_colmap(nerfstudio: tuple[Path, Any]) -> None:
    """Oracle: the COLMAP poses that the file was made from, and the photos' discs."""
    root, capture = nerfstudio
    data = _load(root)
    cameras = data.scene.cameras
    assert data.warnings == () and data.mask_mode == "none"
    assert cameras.names == tuple(f"images/view_{i:02d}.png" for i in range(9))
    for i, image in enumerate(capture.model.images):
        np.testing.assert_allclose(cameras.viewmats[i], image.viewmat, atol=1e-12)
        np.testing.assert_array_equal(cameras.Ks[i], capture.model.cameras[1].K)
        np.testing.assert_array_equal(data.image(i), capture.photos[image.name])
    np.testing.assert_allclose(data.scene.points.points, capture.model.points.xyz, atol=1e-6)
    np.testing.assert_array_equal(data.scene.points.colors, capture.model.points.rgb)
    # The file itself is valid input too.
    assert _load(root / "transforms.json").names == data.names


def test_frames_have_their_own_cameras(nerfstudio: tuple[Path, Any]) -> None:
    """Oracle: numbers of single frames, which override those of the file."""
    root, _ = nerfstudio
    data = json.loads((root / "transforms.json").read_text())
    data["frames"][2] |= {"fl_x": 99.0, "cx": 30.0}
    data["frames"][4] |= {"k1": -0.05, "camera_model": "OPENCV_FISHEYE"}
    data["frames"][5] |= {"k1": -0.05, "k3": 0.001}
    _write(root / "transforms.json", data)
    views = read_transforms(DataConfig(source=root)).views
    assert views[2].camera.named_params["fx"] == 99.0
    assert views[2].camera.named_params["cx"] == 30.0
    assert views[4].camera.model == "OPENCV_FISHEYE"
    assert views[4].camera.named_params["k1"] == -0.05
    assert views[5].camera.model == "FULL_OPENCV"
    assert views[5].camera.named_params["k3"] == 0.001
    assert _load(root).image(4).ndim == 3  # undistorted


def test_masks_black_is_ignored(nerfstudio: tuple[Path, Any]) -> None:
    """Oracle: the written mask; a frame without one counts as a whole, with a warning."""
    root, _ = nerfstudio
    data = json.loads((root / "transforms.json").read_text())
    for i, frame in enumerate(data["frames"][:-1]):
        mask = np.full((48, 64), 255, np.uint8)
        mask[:, : 5 + i] = 0
        write_png(root / "masks" / f"m{i}.png", mask)
        frame["mask_path"] = f"masks/m{i}.png"
    _write(root / "transforms.json", data)
    loaded = _load(root)
    assert loaded.mask_mode == "ignore"
    mask = loaded.mask(3)
    assert mask is not None and not mask[:, :8].any() and (mask[:, 8:] == 255).all()
    assert loaded.mask(8) is None
    assert "1 of 9 views have no mask" in loaded.warnings[0]
    assert loaded.nbytes == 64 * 48 * (9 * 3 + 8)


def test_stated_test_views(nerfstudio: tuple[Path, Any]) -> None:
    """Oracle: nerfstudio's test_filenames."""
    root, _ = nerfstudio
    data = json.loads((root / "transforms.json").read_text())
    data["test_filenames"] = ["images/view_02.png", "./images/view_05.png"]
    _write(root / "transforms.json", data)
    assert _load(root, eval=True).test == [2, 5]
    assert _load(root).test == []


class TestSynthetic:
    """The layout of the synthetic NeRF scenes."""

    @pytest.fixture
    def root(self, tmp_path: Path, rng: np.random.Generator) -> Path:
        for split, count in (("train", 5), ("test", 2), ("val", 2)):
            frames = []
            for i in range(count):
                photo = rng.integers(0, 256, (40, 50, 4)).astype(np.uint8)
                write_png(tmp_path / split / f"r_{i}.png", photo)
                pose = np.eye(4)
                pose[:3, 3] = [0.1 * i, 0, 4 + i]
                frames.append({"file_path": f"./{split}/r_{i}", "transform_matrix": pose.tolist()})
            _write(tmp_path / f"transforms_{split}.json", {"camera_angle_x": 0.8, "frames": frames})
        return tmp_path

    def test_cameras(self, root: Path) -> None:
        """Oracle: f = w / 2 / tan(angle / 2); a camera at (0, 0, 4) that faces -z."""
        data = _load(root)
        cameras = data.scene.cameras
        focal = 25 / np.tan(0.4)
        i = data.names.index("train/r_0.png")
        np.testing.assert_allclose(cameras.Ks[i], [[focal, 0, 25], [0, focal, 20], [0, 0, 1]])
        np.testing.assert_allclose(cameras.centers[i], [0, 0, 4], atol=1e-12)
        np.testing.assert_allclose(cameras.viewmats[i] @ [0, 0, 0, 1], [0, 0, 4, 1], atol=1e-12)
        assert data.mask_mode == "composite"
        mask = data.mask(i)
        assert mask is not None and mask.shape == (40, 50)

    def test_its_own_split(self, root: Path) -> None:
        """Oracle: the files' names; without --eval all of them train."""
        data = _load(root, eval=True)
        assert [data.names[i] for i in data.test] == ["test/r_0.png", "test/r_1.png"]
        assert len(data.train) == 5
        everything = _load(root)
        assert (len(everything.train), len(everything.test)) == (7, 0)

    def test_random_points(self, root: Path) -> None:
        """Oracle: random points and a message, because none are stated."""
        data = _load(root)
        assert len(data.scene.points) == 100_000
        assert any("no points" in warning for warning in data.warnings)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frames": None}, "must be an object with a list `frames`"),
        ({"frames": []}, "lists no frames"),
        ({"frames": [3]}, "frame 0 is not an object"),
        ({"camera_model": "OMNI"}, "unknown camera_model 'OMNI', known are SIMPLE_PINHOLE"),
        ({"camera_model": ["x"]}, "unknown camera_model"),
        ({"fl_x": "long"}, "fl_x is 'long', expected a number"),
        ({"fl_x": -5}, "the focal lengths are -5 and 62 pixels"),
        ({"fl_x": 0}, "the focal lengths are 0 and 62 pixels"),
        ({"fl_x": 1e-30}, "the focal lengths are 1e-30 and 62 pixels for a picture of 64 x 48"),
        ({"fl_y": 1e29}, r"the focal lengths are 60 and 1e\+29 pixels"),
        ({"fl_x": float("nan")}, "fl_x is nan, expected a number"),
        ({"k4": 0.1}, "k4 of a OPENCV camera has no agreed meaning"),
        ({"w": 0}, "must be positive"),
        ({"w": 60}, r"is 64 x 48 pixels, its camera was calibrated for 60 x 48"),
        ({"ply_file_path": "../x.ply"}, "ply_file_path is '../x.ply', expected a path inside"),
        ({"ply_file_path": "gone.ply"}, r"Cannot read .*gone\.ply"),
        ({"test_filenames": 3}, "test_filenames must be a list"),
    ],
)
def test_unusable_files(change: dict, message: str, nerfstudio: tuple[Path, Any]) -> None:
    """Oracle: the sentence, with file, place and expected value."""
    root, _ = nerfstudio
    data = json.loads((root / "transforms.json").read_text())
    _write(root / "transforms.json", data | change)
    with pytest.raises(GsError, match=message):
        _load(root)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"file_path": None}, "file_path is None, expected a path inside"),
        ({"file_path": "/etc/passwd"}, "expected a path inside"),
        ({"transform_matrix": [[1, 2], [3, 4]]}, "expected 4 x 4 numbers"),
        ({"transform_matrix": "x"}, "expected 4 x 4 numbers"),
        ({"transform_matrix": (np.eye(4) + 1e200).tolist()}, "expected 4 x 4 numbers up to 1e"),
        ({"transform_matrix": [[10**400] * 4] * 4}, "expected 4 x 4 numbers"),
        ({"fl_x": 1e200}, "fl_x is 1e\\+200, expected a number up to 1e"),
        ({"w": 2**40}, "size 1099511627776 x 48 must be positive, and sides below 2\\^31"),
        ({"fl_x": 10**400}, "fl_x is inf, expected a number up to"),
        ({"transform_matrix": (2 * np.eye(4)).tolist()}, "Remove the scale"),
        ({"transform_matrix": np.diag([1.0, 1, -1, 1]).tolist()}, "mirrors the camera"),
        ({"mask_path": 7}, "mask_path is 7"),
        ({"file_path": "images/view_01.png"}, r"lists images twice: images/view_01\.png"),
    ],
)
def test_unusable_frames(change: dict, message: str, nerfstudio: tuple[Path, Any]) -> None:
    """Oracle: the sentence, with file, frame and expected value."""
    root, _ = nerfstudio
    data = json.loads((root / "transforms.json").read_text())
    data["frames"][3] |= change
    _write(root / "transforms.json", data)
    with pytest.raises((FormatError, DatasetError), match=message):
        _load(root)


def test_missing_photos(nerfstudio: tuple[Path, Any]) -> None:
    """Oracle: few missing photos are a warning, most missing an error; both name them."""
    root, _ = nerfstudio
    (root / "images" / "view_04.png").unlink()
    data = _load(root)
    assert len(data) == 8
    assert "1 of the 9 images" in data.warnings[0] and "images/view_04.png" in data.warnings[0]
    for i in range(5):
        (root / "images" / f"view_{i:02d}.png").unlink(missing_ok=True)
    with pytest.raises(DatasetError, match=r"5 of the 9 images of .*: images/view_00\.png, "):
        _load(root)


def test_hostile(nerfstudio: tuple[Path, Any], mutations: Callable) -> None:
    """Oracle: a capture or one of our errors, for a damaged file; no other exception."""
    root, _ = nerfstudio
    path, refused = root / "transforms.json", 0
    for raw in [*mutations(path.read_bytes()), b"[]", b"3", b"[" * 9999]:
        path.write_bytes(raw)
        try:
            read_transforms(DataConfig(source=root))
        except GsError as error:
            assert str(root) in str(error)
            refused += 1
    assert refused > 20


def test_names_that_repeat_are_found_in_linear_time() -> None:
    """Oracle: names sorted by hand, and the comparisons of names: a linear search for each would
    need two million."""
    compared = []

    class Name(str):
        __hash__ = str.__hash__

        def __eq__(self, other: object) -> bool:
            compared.append(1)
            return str.__eq__(self, other)

    names = [Name(f"images/{i:06d}.jpg") for i in range(2000)]
    assert repeated(names) == []
    again = [Name(names[i]) for i in (7, 3, 7)]
    assert repeated([*names, *again]) == [names[3], names[7]]
    assert len(compared) < 100


def test_photos_and_masks_of_the_longest_names(tmp_path: Path) -> None:
    """Oracle: one of our sentences: with an ending of ours the name would be too long."""
    frame = {"file_path": "n" * 254, "mask_path": "m" * 254, "transform_matrix": np.eye(4).tolist()}
    content = {"w": 64, "h": 48, "fl_x": 60, "frames": [frame]}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(DatasetError, match=r"1 of the 1 images of .* are missing"):
        read_transforms(DataConfig(source=tmp_path))
    frame["file_path"] = "n" * 256
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(FormatError, match="with names of 255 bytes at most"):
        read_transforms(DataConfig(source=tmp_path))
