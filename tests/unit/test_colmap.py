"""COLMAP models, binary and text, against pycolmap and by hand."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from gscore.errors import DatasetError, FormatError
from gscore.io.colmap.folder import (
    ColmapCamera,
    ColmapImage,
    ColmapModel,
    ColmapPoints,
    find_model,
    is_safe_name,
    read_model,
    write_model,
)
from gscore.io.colmap.lenses import CAMERA_MODELS


def _theirs(rng: np.random.Generator) -> pycolmap.Reconstruction:
    """A reconstruction of pycolmap: one camera of every model, two images each, tracks."""
    model = pycolmap.Reconstruction()
    for k, kind in enumerate(CAMERA_MODELS, start=1):
        params = rng.uniform(0.01, 0.2, len(kind.params))
        params[:4] += [600, 610, 320, 240][: len(params[:4])]
        camera = pycolmap.Camera(
            model=kind.name, width=640 + k, height=480, params=params.tolist(), camera_id=k
        )
        model.add_camera_with_trivial_rig(camera)
        for j in range(2):
            image = pycolmap.Image(
                name=f"sub-folder/{kind.name}.{j}.jpg", camera_id=k, image_id=2 * k + j
            )
            seen = rng.uniform(0, 400, (int(rng.integers(0, 9)), 2))
            image.points2D = pycolmap.Point2DList([pycolmap.Point2D(xy) for xy in seen])
            quat = rng.standard_normal(4)
            turn = pycolmap.Rotation3d(quat / np.linalg.norm(quat))
            pose = pycolmap.Rigid3d(turn, rng.normal(0, 3, 3))
            model.add_image_with_trivial_frame(image, pose)
    slots = [
        (image_id, index)
        for image_id, image in model.images.items()
        for index in range(image.num_points2D())
    ]
    rng.shuffle(slots)
    while len(slots) > 4:
        track = pycolmap.Track()
        for image_id, index in [slots.pop() for _ in range(int(rng.integers(2, 5)))]:
            track.add_element(int(image_id), int(index))
        color = rng.integers(0, 256, 3).astype(np.uint8)
        model.add_point3D(rng.normal(0, 5, 3), track, color)
    for point in model.points3D.values():
        point.error = float(rng.uniform(0, 2))
    return model


def _assert_same(ours: ColmapModel, theirs: pycolmap.Reconstruction, digits: float = 0) -> None:
    """Assert equal numbers in both models, to the bit if `digits` is 0."""

    def same(a: object, b: object) -> None:
        np.testing.assert_allclose(a, b, rtol=digits, atol=digits)  # type: ignore[arg-type]

    assert set(ours.cameras) == set(theirs.cameras)
    for camera_id, camera in ours.cameras.items():
        other = theirs.cameras[camera_id]
        assert (camera.model, camera.width, camera.height) == (
            other.model_name,
            other.width,
            other.height,
        )
        same(camera.params, other.params)
    assert len(ours.images) == len(theirs.images)
    for image in ours.images:
        other = theirs.images[image.id]
        assert (image.name, image.camera_id) == (other.name, other.camera_id)
        # Their quaternion passes through a normalisation and another component order.
        matrix = other.cam_from_world().matrix()
        np.testing.assert_allclose(image.viewmat[:3], matrix, atol=max(digits, 1e-14))
        xys = np.array([point.xy for point in other.points2D]).reshape(-1, 2)
        ids = [p.point3D_id if p.has_point3D() else -1 for p in other.points2D]
        same(image.xys, xys)
        assert image.point3D_ids.tolist() == ids
    assert set(ours.points.ids.tolist()) == set(theirs.points3D)
    others = [theirs.points3D[point_id] for point_id in ours.points.ids.tolist()]
    same(ours.points.xyz, np.array([point.xyz for point in others]).reshape(-1, 3))
    same(ours.points.error, np.array([point.error for point in others]))
    same(ours.points.rgb, np.array([point.color for point in others]).reshape(-1, 3))
    same(ours.points.track_lengths, np.array([point.track.length() for point in others]))


def test_camera_models_are_those_of_pycolmap() -> None:
    """Oracle: pycolmap's own list of ids, names and parameters."""
    theirs = {n: m for n, m in pycolmap.CameraModelId.__members__.items() if n != "INVALID"}
    assert {model.name: model.id for model in CAMERA_MODELS} == {
        name: int(member) for name, member in theirs.items()
    }
    for model in CAMERA_MODELS:
        camera = pycolmap.Camera.create_from_model_name(1, model.name, 500.0, 640, 480)
        assert ", ".join(model.params) == camera.params_info.replace("w,h", "w, h")


@pytest.mark.parametrize("binary", [True, False])
def test_reads_what_pycolmap_writes(binary: bool, tmp_path: Path, rng: np.random.Generator) -> None:
    """Oracle: the reconstruction written by pycolmap, with every camera model."""
    theirs = _theirs(rng)
    folder = tmp_path / "sparse" / "0"
    folder.mkdir(parents=True)
    (theirs.write_binary if binary else theirs.write_text)(str(folder))
    assert len(theirs.points3D) > 10
    _assert_same(read_model(tmp_path), theirs, 0 if binary else 1e-12)


@pytest.mark.parametrize("binary", [True, False])
def test_pycolmap_reads_what_we_write(
    binary: bool, tmp_path: Path, rng: np.random.Generator
) -> None:
    """Oracle: pycolmap's reading of our files, tracks included, to the bit in both formats."""
    theirs = _theirs(rng)
    theirs.write_binary(str(tmp_path))
    ours = read_model(tmp_path)
    write_model(ours, tmp_path / "out", binary=binary)
    again = pycolmap.Reconstruction(str(tmp_path / "out"))
    _assert_same(ours, again)
    for point_id, point in theirs.points3D.items():
        track = {(e.image_id, e.point2D_idx) for e in again.points3D[point_id].track.elements}
        assert track == {(e.image_id, e.point2D_idx) for e in point.track.elements}


@pytest.mark.data
@pytest.mark.parametrize("name", ["plush", "stone_horse", "lund"])
@pytest.mark.parametrize("binary", [True, False])
def test_real_captures_both_ways(name: str, binary: bool, data_root: Path, tmp_path: Path) -> None:
    """Oracle: pycolmap on the same files, and on the files we write from them."""
    ours = read_model(data_root / name)
    _assert_same(ours, pycolmap.Reconstruction(str(data_root / name / "sparse" / "0")))
    write_model(ours, tmp_path, binary=binary)
    _assert_same(ours, pycolmap.Reconstruction(str(tmp_path)))
    _assert_same(read_model(tmp_path), pycolmap.Reconstruction(str(tmp_path)))


@pytest.fixture
def small() -> ColmapModel:
    camera = ColmapCamera(model="PINHOLE", width=8, height=6, params=np.array([5.0, 5.0, 4.0, 3.0]))
    return ColmapModel(cameras={1: camera}, images=[], points=ColmapPoints.none())


def test_empty_model_round_trip(small: ColmapModel, tmp_path: Path) -> None:
    """Oracle: the written model."""
    for binary in (True, False):
        write_model(small, tmp_path / str(binary), binary=binary)
        again = read_model(tmp_path / str(binary))
        assert again.images == [] and len(again.points) == 0
        np.testing.assert_array_equal(again.cameras[1].params, small.cameras[1].params)


def test_observations_of_dropped_points(make_capture: Callable, tmp_path: Path) -> None:
    """Oracle: pycolmap's reading of the model; observations of dropped points are unassigned."""
    model = make_capture(write=False, points=4).model
    points = model.points
    fewer = ColmapPoints(**{name: value[1:] for name, value in vars(points).items()})
    dropped = int(points.ids[0])
    write_model(ColmapModel(cameras=model.cameras, images=model.images, points=fewer), tmp_path)
    theirs = pycolmap.Reconstruction(str(tmp_path))
    assert dropped not in theirs.points3D and len(theirs.points3D) == 3
    assert all((image.point3D_ids != dropped).all() for image in read_model(tmp_path).images)


def test_intrinsics_of_every_model() -> None:
    """Oracle: pycolmap's calibration matrix and its own definition of 'undistorted'."""
    for kind in CAMERA_MODELS[:-1]:
        theirs = pycolmap.Camera.create_from_model_name(1, kind.name, 500.0, 640, 480)
        ours = ColmapCamera(
            model=kind.name, width=640, height=480, params=np.array(theirs.params, float)
        )
        np.testing.assert_array_equal(ours.K, theirs.calibration_matrix())
        if ours.is_pinhole:  # to be safe, fisheye models with zeros are not pinholes
            assert theirs.is_undistorted()
        if len(kind.params) > 4:
            bent = np.array(theirs.params, float)
            bent[-1] += 0.01
            assert not ColmapCamera(model=kind.name, width=1, height=1, params=bent).is_pinhole


class TestFinding:
    """Folders in which models are found."""

    def _put(self, small: ColmapModel, folder: Path, images: int = 0) -> None:
        image = {
            "qvec": np.array([1.0, 0, 0, 0]),
            "tvec": np.zeros(3),
            "xys": np.zeros((0, 2)),
            "point3D_ids": np.zeros(0, np.int64),
            "camera_id": 1,
        }
        listed = [ColmapImage(id=k + 1, name=f"{k}.jpg", **image) for k in range(images)]
        write_model(ColmapModel(cameras=small.cameras, images=listed, points=small.points), folder)

    @pytest.mark.parametrize("place", ["sparse/0", "sparse", ".", "0", "colmap/sparse/0"])
    def test_places(self, place: str, small: ColmapModel, tmp_path: Path) -> None:
        """Oracle: the folder of the model."""
        self._put(small, tmp_path / place)
        assert find_model(tmp_path) == (tmp_path / place, ())

    def test_largest_of_several(self, small: ColmapModel, tmp_path: Path) -> None:
        """Oracle: the one with most images, with a sentence about the choice."""
        for name, images in (("0", 2), ("1", 5), ("10", 3)):
            self._put(small, tmp_path / "sparse" / name, images)
        model = read_model(tmp_path)
        assert len(model.images) == 5 and model.path.name == "1"
        (warning,) = model.warnings
        assert "3 models" in warning and "using 1 with 5 images" in warning
        assert "0 (2), 10 (3)" in warning

    def test_none(self, tmp_path: Path) -> None:
        """Oracle: the sentence, with the searched folders and a remedy."""
        with pytest.raises(DatasetError, match=r"is an empty folder\. Give one with photos"):
            read_model(tmp_path)
        (tmp_path / "notes.md").touch()
        with pytest.raises(DatasetError, match=r"There are no photos in .* or its folders"):
            read_model(tmp_path)
        (tmp_path / "a.gif").touch()
        with pytest.raises(
            DatasetError, match=r"No COLMAP model in .*sparse/0.*Give the folder above"
        ):
            read_model(tmp_path)
        with pytest.raises(DatasetError, match="There is no folder"):
            read_model(tmp_path / "nowhere")

    def test_points_may_be_missing(self, small: ColmapModel, tmp_path: Path) -> None:
        """Oracle: a model without points and a warning."""
        self._put(small, tmp_path, 1)
        (tmp_path / "points3D.bin").unlink()
        model = read_model(tmp_path)
        assert len(model.points) == 0
        assert "points3D.bin is missing" in model.warnings[0]


@pytest.mark.parametrize(
    ("name", "safe"),
    [
        ("a.jpg", True),
        ("cam 1/ä/b.jpg", True),
        ("cam\\b.jpg", True),
        ("./a.jpg", True),
        ("a..b.jpg", True),
        ("../a.jpg", False),
        ("x/../../a.jpg", False),
        ("x\\..\\a.jpg", False),
        ("/etc/a.jpg", False),
        ("C:\\a.jpg", False),
        ("C:a.jpg", False),
        ("\\\\server\\share\\a.jpg", False),
        ("", False),
        (".", False),
        ("a\x00b.jpg", False),
    ],
)
def test_names_stay_inside(name: str, safe: bool) -> None:
    """Oracle: by hand, for both kinds of separators."""
    assert is_safe_name(name) is safe


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 FISH_LENS 8 6 5 5 4 3", r"cameras\.txt line 1: camera 1 has the unknown camera model "),
        ("1 PINHOLE 8 6 5 5 4", r"cameras\.txt line 1 is truncated or corrupt: expected CAMERA_ID"),
        ("# c\n1 PINHOLE 8 x 5 5 4 3", r"cameras\.txt line 2 is truncated or corrupt"),
        ("1 PINHOLE 8 6 5 5 nan 3", r"camera 1 \(PINHOLE\) has the size 8 x 6 and the parameters"),
        ("1 PINHOLE 0 6 5 5 4 3", "expected a positive size"),
        ("1 PINHOLE 8 6 -5 5 4 3", "focal lengths of 0.001 to 100000 times its longer side"),
        ("1 PINHOLE 8 6 5 0 4 3", "focal lengths of 0.001 to 100000"),
        ("1 PINHOLE 8 6 1e-30 5 4 3", "focal lengths of 0.001 to 100000"),
        ("1 SIMPLE_RADIAL 8 6 1e29 4 3 0", "focal lengths of 0.001 to 100000"),
        ("1 PINHOLE 8 6 nan 5 4 3", "focal lengths of 0.001 to 100000"),
    ],
)
def test_bad_cameras(text: str, message: str, tmp_path: Path) -> None:
    """Oracle: the sentence, with file, line and expected value."""
    (tmp_path / "cameras.txt").write_text(text)
    (tmp_path / "images.txt").write_text("")
    with pytest.raises(FormatError, match=message):
        read_model(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 1 0 0 0 0 0 0 1", r"images\.txt line 1 is truncated or corrupt: expected IMAGE_ID"),
        ("1 1 0 0 0 0 0 0 2 a.jpg\n\n", r"image 'a\.jpg' uses camera 2, which the model does not"),
        ("1 0 0 0 0 0 0 0 1 a.jpg\n\n", "a quaternion that is not zero"),
        ("1 1 0 0 0 nan 0 0 1 a.jpg\n\n", "expected numbers up to"),
        ("1 1 0 0 0 1e200 0 0 1 a.jpg\n\n", "'a.jpg' has the pose .*expected numbers up to 1e"),
        ("1 1 0 0 0 0 0 0 1 ../a.jpg\n\n", "expected a path inside the image folder"),
        ("1 1 0 0 0 0 0 0 1 a.jpg\n1 2 3 4\n", r"images\.txt line 2 .* triples of X Y POINT3D_ID"),
        ("-1 1 0 0 0 0 0 0 1 a.jpg\n\n", r"has the id -1, expected 0 to"),
    ],
)
def test_bad_images(text: str, message: str, tmp_path: Path) -> None:
    """Oracle: the sentence, with file, line and expected value."""
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 8 6 5 5 4 3")
    (tmp_path / "images.txt").write_text(text)
    with pytest.raises(FormatError, match=message):
        read_model(tmp_path)
