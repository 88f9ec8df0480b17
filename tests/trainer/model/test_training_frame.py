"""The training world; oracle: distances measured in COLMAP world."""

from dataclasses import replace

import numpy as np
import pytest

from gscore.scene import PointCloud, Scene
from gscore.trainer.model.training_frame import TrainingFrame


def moved(scene: Scene, factor: float, offset: float) -> Scene:
    """The same capture in other units and at another place."""
    viewmats = scene.cameras.viewmats.copy()
    centers = scene.cameras.centers * factor + offset
    viewmats[:, :3, 3] = -np.einsum("cij,cj->ci", viewmats[:, :3, :3], centers)
    points = PointCloud(points=scene.points.points * factor + offset, colors=scene.points.colors)
    return replace(scene, cameras=replace(scene.cameras, viewmats=viewmats), points=points)


@pytest.mark.parametrize(("factor", "offset"), [(1.0, 0.0), (1e-4, 0.0), (300.0, 1e6)])
def test_extent_is_that_of_the_cameras(photos, factor: float, offset: float) -> None:
    """Oracle: 1.1 times the largest distance from the mean, in any units."""
    scene = moved(photos.scene, factor, offset)
    frame = TrainingFrame.of(scene, near=0.01)
    centers = scene.cameras.centers
    radius = np.linalg.norm(centers - centers.mean(axis=0), axis=1).max()
    assert frame.extent / frame.similarity.scale == pytest.approx(1.1 * radius, rel=1e-9)
    assert 0.5 <= frame.extent <= 1.11
    inside = frame.similarity.points_to_training(centers)
    assert np.linalg.norm(inside, axis=1).max() <= 1 + 1e-9
    near = frame.near / frame.similarity.scale
    assert near == pytest.approx(min(0.01, 0.011 * radius))


def test_cameras_in_one_place_take_the_distance_to_the_points(photos) -> None:
    """Oracle: the median distance of the points."""
    viewmats = photos.scene.cameras.viewmats.copy()
    viewmats[:, :3, 3] = 0
    scene = replace(
        photos.scene,
        cameras=replace(photos.scene.cameras, viewmats=viewmats),
        points=PointCloud(points=np.full((3, 3), 10.0), colors=np.zeros((3, 3), np.uint8)),
    )
    frame = TrainingFrame.of(scene, near=0.01)
    assert frame.extent / frame.similarity.scale == pytest.approx(1.1 * np.sqrt(300))


def test_a_frame_survives_json(photos) -> None:
    """Oracle: the same numbers, bit for bit."""
    frame = TrainingFrame.of(moved(photos.scene, 0.37, 12.3), near=0.01)
    back = TrainingFrame.from_dict(frame.to_dict())
    assert back.to_dict() == frame.to_dict()
    assert (back.extent, back.near) == (frame.extent, frame.near)


@pytest.mark.parametrize(
    ("place", "size"), [(1e300, 1.0), (np.inf, 1.0), (np.nan, 1.0), (0, 1e-310)]
)
def test_points_out_of_bounds_are_not_counted(photos, place: float, size: float) -> None:
    """Oracle: the frame of the same capture without them; no overflow."""
    viewmats = photos.scene.cameras.viewmats.copy()
    viewmats[:, :3, 3] *= size if size < 1 else 0
    cameras = replace(photos.scene.cameras, viewmats=viewmats)
    near = np.full((2, 3), 10.0) * size
    far = np.vstack([near, np.full((3, 3), place)])
    clouds = [PointCloud(points=p, colors=np.zeros((len(p), 3), np.uint8)) for p in (near, far)]
    frames = [TrainingFrame.of(Scene(cameras=cameras, points=cloud), near=0.01) for cloud in clouds]
    assert frames[0].to_dict() == frames[1].to_dict()
    assert 0.5 < frames[0].extent < 1.2
