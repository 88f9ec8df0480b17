"""Cameras resected from their points, and the decision to do so, by the studio example."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gscore.config import DataConfig, Switch, TrainConfig
from gscore.datasets import Dataset, load_dataset
from gscore.datasets.tracks import tracks_of
from gscore.errors import FormatError
from gscore.io.colmap.folder import read_model, write_model
from gscore.io.poses_json import read_moves
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.analysis.photo_visit import visit_photos
from gscore.trainer.analysis.pose_check import (
    PointObservations,
    check_poses,
    median_residual,
    resection_pose,
)
from gscore.trainer.run import train
from gscore.trainer.views.photo_poses import PoseCheck
from gscore.trainer.views.pose_math import moved_pose, pose_distances
from gscore.transforms import rotmat_to_quat

STUDIO = Path(__file__).parents[3] / "examples" / "studio"


def sights(pose: np.ndarray, count: int = 200, *, wrong: float = 0.0) -> PointObservations:
    """Points of a camera, a share of them at wrong places."""
    rng = np.random.default_rng(0)
    local = rng.uniform([-1, -1, 2], [1, 1, 6], (count, 3))
    rays = local[:, :2] / local[:, 2:]
    bad = rng.random(count) < wrong
    rays[bad] += rng.uniform(-0.3, 0.3, (int(bad.sum()), 2))
    points = (local - pose[:3, 3]) @ pose[:3, :3]
    return PointObservations(points=points, rays=rays)


@pytest.mark.parametrize("wrong", [0.0, 0.3])
def test_a_pose_is_found_by_its_points(wrong: float) -> None:
    """Oracle: the pose that projects them, from a start off by a tenth of a radian and of the
    depth."""
    truth = moved_pose(np.eye(4), np.array([0.3, -0.2, 0.5, 1.0, 2.0, 3.0]))
    seen = sights(truth, wrong=wrong)
    begun = moved_pose(truth, np.array([0.05, -0.08, 0.04, 0.2, -0.1, 0.3]))
    angle, distance = pose_distances(resection_pose(begun, seen)[None], truth[None])
    assert angle[0] < 1e-6 and distance[0] < 1e-6


@pytest.mark.parametrize("count", [0, 5, 11])
def test_few_points_move_no_camera(count: int) -> None:
    """Oracle: the initial pose, bit for bit."""
    seen = sights(np.eye(4), count)
    pose = moved_pose(np.eye(4), np.full(6, 0.1))
    assert (resection_pose(pose, seen) == pose).all()


def test_points_in_one_place_move_no_camera() -> None:
    """Oracle: a finite pose, at least as good as before."""
    seen = PointObservations(points=np.tile([0.0, 0.0, 2.0], (50, 1)), rays=np.zeros((50, 2)))
    pose = moved_pose(np.eye(4), np.array([0, 0, 0, 0.1, 0, 0]))
    found = resection_pose(pose, seen)
    assert np.isfinite(found).all()
    assert median_residual(found, seen) <= median_residual(pose, seen)


def _studio(root: Path) -> Dataset:
    return load_dataset(DataConfig(source=root, resolution=120, eval=True, mask_mode="none"))


def _disturbed(root: Path) -> Path:
    """The example with cameras turned by half a degree and shifted by a hundredth of the extent,
    except every eighth."""
    model, rng, images = read_model(STUDIO), np.random.default_rng(0), []
    for i, image in enumerate(sorted(model.images, key=lambda image: image.name)):
        axis, way = rng.normal(size=(2, 3))
        motion = np.concatenate(
            [axis * np.radians(0.5) / np.linalg.norm(axis), way * 0.032 / np.linalg.norm(way)]
        )
        pose = moved_pose(image.viewmat, motion * bool(i % 8))
        images.append(replace(image, qvec=rotmat_to_quat(pose[:3, :3]), tvec=pose[:3, 3].copy()))
    write_model(replace(model, images=images), root / "sparse/0")
    (root / "images").symlink_to(STUDIO / "images")
    return root


def _checked(config: TrainConfig, photos: Dataset) -> PoseCheck:
    facts = visit_photos(replace(config, exposure=Switch.OFF), photos)
    return check_poses(config, Analysis(photos=photos, facts=facts))


def test_good_cameras_stay() -> None:
    """Oracle: the example with its SfM cameras, which stay."""
    found = _checked(TrainConfig(), _studio(STUDIO))
    assert found.viewmats is None and not found.learns
    assert found.decision.text.startswith("Cameras agree with their points (0.")


def test_disturbed_cameras_come_back(tmp_path: Path) -> None:
    """Oracle: the cameras of the example before the disturbance; held-out ones stay."""
    true = _studio(STUDIO).scene.cameras.viewmats
    photos = _studio(_disturbed(tmp_path))
    found = _checked(TrainConfig(), photos)
    assert found.viewmats is not None and not found.learns
    assert "52 training cameras miss their points" in found.decision.text
    before, _ = pose_distances(photos.scene.cameras.viewmats[photos.train], true[photos.train])
    after, distance = pose_distances(found.viewmats[photos.train], true[photos.train])
    assert np.median(after) < 0.1 * np.median(before)
    assert np.median(distance) < 0.003
    assert (found.viewmats[photos.test] == photos.scene.cameras.viewmats[photos.test]).all()


def test_off_and_on(tmp_path: Path) -> None:
    """Oracle: no check with `off`; refinement of good cameras too with `on`."""
    photos = _studio(STUDIO)
    off = _checked(TrainConfig(refine_poses=Switch.OFF), photos)
    assert (off.viewmats, off.learns, off.decision) == (None, False, None)
    on = _checked(TrainConfig(refine_poses=Switch.ON), photos)
    assert on.learns and on.viewmats is not None
    assert (on.viewmats == photos.scene.cameras.viewmats).all()


def test_rays_are_those_of_the_points() -> None:
    """Oracle: the points of the example in its cameras: a median of half a pixel of 640, the value
    of its reconstruction."""
    photos = _studio(STUDIO)
    tracks = tracks_of(photos)
    assert tracks is not None
    cameras = photos.scene.cameras
    focal = cameras.Ks[0, 0, 0] * 480 / cameras.widths[0]
    off = [
        median_residual(
            cameras.viewmats[i], PointObservations(points=tracks.points[rows], rays=tracks.rays[i])
        )
        for i, rows in enumerate(tracks.observed)
    ]
    assert 0.1 < focal * np.median(off) < 0.6


def test_few_of_many_points_are_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: all points of the example, which bring its cameras back to the same places."""
    photos = _studio(_disturbed(tmp_path))
    found = _checked(TrainConfig(), photos)
    monkeypatch.setattr("gscore.datasets.tracks._ENOUGH", 60)
    tracks = tracks_of(photos)
    assert tracks is not None and max(map(len, tracks.observed)) == 60
    few = _checked(TrainConfig(), photos)
    assert found.viewmats is not None and few.viewmats is not None
    turned, moved = pose_distances(found.viewmats[photos.train], few.viewmats[photos.train])
    assert np.median(turned) < 0.002 and np.median(moved) < 0.005


def test_a_run_says_how_far_cameras_moved(tmp_path: Path) -> None:
    """Oracle: the disturbance, which each camera moves back by; equal values in metrics.json and
    poses.json; an aligned held-out view that is no worse."""
    photos = _studio(_disturbed(tmp_path / "capture"))
    config = TrainConfig(iterations=60, max_splats=7000, sh_degree=0)
    data = DataConfig(source=tmp_path / "capture", resolution=120, eval=True, mask_mode="none")
    result = train(config, data, tmp_path / "out")
    stated = json.loads((tmp_path / "out/poses.json").read_text())
    assert sorted(stated) == [photos.names[i] for i in photos.train]
    degrees = [one["degrees"] for one in stated.values()]
    assert np.median(degrees) == pytest.approx(0.5, abs=0.05)
    cameras = result.metrics["poses"]["cameras"]
    assert [cameras[name]["degrees"] for name in stated] == degrees
    assert read_moves(tmp_path / "out/poses.json")[photos.names[1]] == (
        stated[photos.names[1]]["degrees"],
        stated[photos.names[1]]["distance"],
    )
    assert "Refined camera poses" in (tmp_path / "out/report.html").read_text()
    assert result.metrics["psnr_aligned"] > result.metrics["psnr"] - 0.1


def test_good_cameras_train_as_without(tmp_path: Path) -> None:
    """Oracle: the bytes of the splats with `refine_poses` off; no poses.json."""
    written = []
    for mode in (Switch.AUTO, Switch.OFF):
        config = TrainConfig(iterations=10, max_splats=7000, refine_poses=mode)
        data = DataConfig(source=STUDIO, resolution=60, mask_mode="none")
        train(config, data, tmp_path / mode)
        written.append((tmp_path / mode / "point_cloud.ply").read_bytes())
        assert not (tmp_path / mode / "poses.json").exists()
    assert written[0] == written[1]


def test_damaged_poses_are_a_sentence(tmp_path: Path) -> None:
    """Oracle: the error; no poses for a missing file."""
    path = tmp_path / "poses.json"
    assert read_moves(path) == {}
    for text in ("[", "[1]", '{"a": {"degrees": 1}}', '{"a": 3}'):
        path.write_text(text)
        with pytest.raises(FormatError, match=r"poses\.json is damaged"):
            read_moves(path)
