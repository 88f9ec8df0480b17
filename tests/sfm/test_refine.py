"""The last adjustment of a model; oracle: the synthetic scene of pycolmap that it was made from."""

from typing import Any

import numpy as np
import pycolmap
import pytest

from gscore.sfm import stages


@pytest.fixture
def squeezed() -> Any:
    """Exact observations by a camera of two focal lengths, given to one of a single one."""
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
    before = stages.refine(squeezed, may_free=True)
    (camera,) = squeezed.cameras.values()
    assert before is not None and before > stages.HIGH_ERROR
    assert camera.model_name == "OPENCV" and squeezed.num_points3D() == 150
    assert squeezed.compute_mean_reprojection_error() < 0.01
    assert camera.params[1] / camera.params[0] == pytest.approx(1200 / 900, rel=1e-3)


def test_a_lens_that_was_asked_for_stays(squeezed: Any) -> None:
    """Oracle: the model's name."""
    assert stages.refine(squeezed, may_free=False) is None
    assert {camera.model_name for camera in squeezed.cameras.values()} == {"SIMPLE_RADIAL"}


def test_wrong_points_are_left_out(squeezed: Any) -> None:
    """Oracle: the points whose observations were moved by 30 px, out of a camera that fits."""
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
    stages.refine(model, may_free=False)
    assert not set(wrong) & set(model.point3D_ids())
    assert model.num_points3D() >= 135
