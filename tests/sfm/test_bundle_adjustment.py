"""The last adjustment of a model; oracle: the synthetic scene of pycolmap that it was made from."""

from typing import Any

import numpy as np
import pycolmap
import pytest

from gscore.sfm import bundle_adjustment as adjusting
from gscore.sfm.bundle_adjustment import adjust


@pytest.fixture
def squeezed() -> Any:
    """Exact observations by a camera with two focal lengths, assigned to one with a single one."""
    pycolmap.set_random_seed(0)
    options = pycolmap.SyntheticDatasetOptions(
        num_rigs=1, num_cameras_per_rig=1, num_frames_per_rig=12, num_points3D=150
    )
    options.camera_model_id = pycolmap.CameraModelId.PINHOLE
    options.camera_params = [900.0, 1200.0, options.camera_width / 2, options.camera_height / 2]
    model = pycolmap.synthesize_dataset(options)
    for camera in model.cameras.values():
        camera.model = pycolmap.CameraModelId.SIMPLE_RADIAL
        camera.params = [1000.0, camera.width / 2, camera.height / 2, 0.0]
    return model


def test_squeezed_photos_get_two_focal_lengths(squeezed: Any) -> None:
    """Oracle: the focal lengths of the scene, and exact observations."""
    found = adjust(squeezed, may_free=True, expected={})
    (camera,) = squeezed.cameras.values()
    assert found.before is not None and found.before > adjusting.HIGH_ERROR
    assert not found.fixed
    assert camera.model_name == "OPENCV" and squeezed.num_points3D() == 150
    assert squeezed.compute_mean_reprojection_error() < 0.01
    assert camera.params[1] / camera.params[0] == pytest.approx(1200 / 900, rel=1e-3)


def test_a_lens_that_was_asked_for_stays(squeezed: Any) -> None:
    """Oracle: the model's name."""
    expected = dict.fromkeys(squeezed.cameras, 1000.0)
    assert adjust(squeezed, may_free=False, expected=expected).before is None
    assert {camera.model_name for camera in squeezed.cameras.values()} == {"SIMPLE_RADIAL"}


def test_wrong_points_are_left_out(squeezed: Any) -> None:
    """Oracle: the points with observations moved by 30 px, left out of a camera that fits."""
    model, rng = squeezed, np.random.default_rng(0)
    (camera,) = model.cameras.values()
    for image in model.images.values():
        for point in image.points2D:
            if point.has_point3D():
                place = image.cam_from_world() * model.points3D[point.point3D_id].xyz
                point.xy = camera.img_from_cam(place)
    wrong = sorted(model.point3D_ids())[:10]
    for number in wrong:
        for element in model.points3D[number].track.elements:
            model.images[element.image_id].points2D[element.point2D_idx].xy += rng.choice(
                [-30.0, 30.0], 2
            )
    adjust(model, may_free=False, expected=dict.fromkeys(model.cameras, 1000.0))
    assert not set(wrong) & set(model.point3D_ids())
    assert model.num_points3D() >= 135


def _observed(centers: np.ndarray, focal: float, bend: float = 0.0) -> Any:
    """Cameras that face +z from these places towards a cloud ahead, with noise of 0.4 px, as an
    adjusted model of one camera with an initial focal length wrong by a fifth."""
    rng = np.random.default_rng(0)
    model = pycolmap.Reconstruction()
    params = [focal, 320.0, 240.0, bend]
    camera = pycolmap.Camera(
        camera_id=1, model="SIMPLE_RADIAL", width=640, height=480, params=params
    )
    model.add_camera_with_trivial_rig(camera)
    points = rng.uniform([-4, -3, 6], [4, 3, 30], (300, 3))
    ids = [model.add_point3D(point, pycolmap.Track(), np.zeros(3, np.uint8)) for point in points]
    for number, (center, turn) in enumerate(centers, 1):
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.0, turn, 0.0])), np.zeros(3))
        pose = pycolmap.Rigid3d(pose.rotation, -(pose.rotation.matrix() @ center))
        seen = [(pose * point, i) for point, i in zip(points, ids, strict=True)]
        pixels = [(camera.img_from_cam(p), i) for p, i in seen if p[2] > 1]
        kept = [(p + rng.normal(0, 0.4, 2), i) for p, i in pixels
                if p is not None and 0 < p[0] < 640 and 0 < p[1] < 480]  # fmt: skip
        image = pycolmap.Image(
            name=f"{number}.jpg",
            camera_id=1,
            image_id=number,
            points2D=pycolmap.Point2DList([pycolmap.Point2D(p) for p, _ in kept]),
        )
        model.add_image_with_trivial_frame(image, pose)
        for k, (_, i) in enumerate(kept):
            model.add_observation(i, pycolmap.TrackElement(number, k))
    for i in ids:
        if model.points3D[i].track.length() < 3:
            model.delete_point3D(i)
    return model


def test_a_walk_straight_ahead_keeps_the_expected_focal_length() -> None:
    """Oracle: geometry; ahead, a longer lens and a longer way give equal photos."""
    ahead = [(np.array([0.0, 0.0, 0.5 * i]), 0.0) for i in range(10)]
    model = _observed(ahead, 600.0)
    found = adjust(model, may_free=True, expected={1: 700.0})
    assert found.fixed and found.before is None
    assert model.cameras[1].params[0] == pytest.approx(700.0, rel=1e-9)
    assert abs(model.cameras[1].params[3]) < 0.05
    assert found.after < 0.8


def test_a_walk_straight_ahead_tells_how_the_lens_bends() -> None:
    """Oracle: the lens of the photos; without distortion, its residuals exceed their noise."""
    ahead = [(np.array([0.0, 0.0, 0.5 * i]), 0.0) for i in range(10)]
    model = _observed(ahead, 600.0, bend=-0.1)
    found = adjust(model, may_free=True, expected={1: 600.0})
    assert found.fixed
    assert model.cameras[1].params[3] == pytest.approx(-0.1, abs=0.02)
    assert found.after < 0.6


def test_a_walk_around_tells_the_focal_length() -> None:
    """Oracle: the lens of the photos, with another one expected."""
    turns = np.linspace(-0.7, 0.7, 12)
    around = [(np.array([-14 * np.sin(t), 0.2 * np.cos(9 * t), 16 - 14 * np.cos(t)]), -t)
              for t in turns]  # fmt: skip
    model = _observed(around, 600.0)
    found = adjust(model, may_free=True, expected={1: 700.0})
    assert not found.fixed
    assert model.cameras[1].params[0] == pytest.approx(600.0, rel=0.01)
