"""Poses of photos: motions, the chain of their derivative, steps, and their optimisation."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.linalg import expm

from gscore.config import Background
from gscore.raster.loss import image_loss_gradient
from gscore.raster.reference import image_loss_reference, rasterize_reference
from gscore.raster.request import Frustum
from gscore.raster.training_rasterizer import TrainingRasterizer
from gscore.scene import camera_centers
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.files import checkpoint
from gscore.trainer.trainer import Trainer
from gscore.trainer.views import photo_parameters
from gscore.trainer.views.photo_poses import PhotoPoses, PoseCheck
from gscore.trainer.views.pose_math import cross_matrix, moved_pose, pose_distances, pose_gradient
from tests.trainer.short_run import CONFIG

NAMES = ("means", "quats", "scales", "opacities", "sh0", "shN")


def disturbed(photos: Any, *, degrees: float, shift: float, seed: int = 0) -> np.ndarray:
    """[V, 4, 4]: training cameras turned and shifted at random by this amount."""
    rng = np.random.default_rng(seed)
    out = photos.scene.cameras.viewmats.copy()
    for i in photos.train:
        axis, way = rng.normal(size=(2, 3))
        axis *= np.radians(degrees) / np.linalg.norm(axis)
        out[i] = moved_pose(out[i], np.concatenate([axis, way * shift / np.linalg.norm(way)]))
    return out


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-3, 1.0, 3.0])
def test_a_motion_is_an_exponential(size: float) -> None:
    """Oracle: scipy's matrix exponential of the cross matrix; the shift is added after the turn."""
    vector = size * np.array([0.6, -0.48, 0.64])
    pose = np.eye(4)
    pose[:3, 3] = [1.0, 2.0, 3.0]
    found = moved_pose(pose, np.concatenate([vector, [0.1, 0.2, 0.3]]))
    turn = expm(cross_matrix(vector))
    np.testing.assert_allclose(found[:3, :3], turn, atol=1e-14)
    np.testing.assert_allclose(found[:3, 3], turn @ [1, 2, 3] + [0.1, 0.2, 0.3], atol=1e-14)
    angle, distance = pose_distances(found[None], pose[None])
    assert angle[0] == pytest.approx(size, abs=1e-12)
    where = camera_centers(np.stack([found, pose]))
    assert distance[0] == pytest.approx(np.linalg.norm(where[0] - where[1]))


def test_the_chain_from_the_loss_to_a_motion(known_splats: Any, photos: Any) -> None:
    """Oracle: central differences of the float64 twins of rasterizer and loss, of a camera turned
    and shifted by `moved`, in all six directions."""
    cameras, size = photos.scene.cameras, 24
    K, viewmat = cameras.Ks[0] * [[0.5], [0.5], [1.0]], cameras.viewmats[0]
    generator = torch.Generator().manual_seed(0)
    target = torch.randint(0, 256, (size, size, 3), generator=generator, dtype=torch.uint8)
    raw = [torch.from_numpy(getattr(known_splats, name)) for name in NAMES]
    rasterizer, v_viewmat = TrainingRasterizer(), torch.empty(4, 4)
    view = Frustum(torch.from_numpy(viewmat).float(), torch.from_numpy(K).float(), size, size)
    picture = rasterizer.draw(raw, view)
    v_rgb = torch.empty_like(picture.rgb)
    image_loss_gradient(picture.rgb, target, v_rgb)
    grads = {name: torch.zeros_like(t) for name, t in zip(NAMES, raw, strict=True)}
    rasterizer.gradients(grads, v_rgb, viewmat=v_viewmat)
    found = pose_gradient(viewmat, v_viewmat.numpy().astype(np.float64))
    exact = [t.double() for t in raw]

    def loss_of(motion: np.ndarray) -> float:
        pose = torch.from_numpy(moved_pose(viewmat, motion))
        out = rasterize_reference(*exact, pose, torch.from_numpy(K), size, size, raw=True)
        return image_loss_reference(out.rgb, target)[0].item()

    step, slopes = 1e-6, []
    for axis in np.eye(6):
        slopes.append((loss_of(step * axis) - loss_of(-step * axis)) / (2 * step))
    assert np.abs(slopes).max() > 1e-2
    np.testing.assert_allclose(found, slopes, rtol=2e-3, atol=2e-3 * np.abs(slopes).max())


def test_all_cameras_together_stay(photos: Any) -> None:
    """Oracle: the mean over the training cameras of their motions in the world, to first order;
    equal bits of held-out cameras."""
    first = photos.scene.cameras.viewmats
    poses = PhotoPoses([0, 1, 2, 4, 5], first, unit=2.0)
    rng = np.random.default_rng(0)
    for index in (0, 4, 2, 5, 1, 0):
        poses.learn(index, rng.normal(size=(4, 4)).astype(np.float32), 1e-5)
    motions = np.linalg.inv(first) @ poses.viewmats - np.eye(4)
    largest = np.abs(motions).max()
    assert largest > 1e-5
    assert np.abs(motions[[0, 1, 2, 4, 5]].mean(axis=0)).max() < 1e-3 * largest
    assert (poses.viewmats[[3, 6, 7]] == first[[3, 6, 7]]).all()


def test_no_camera_leaves_its_limit(photos: Any) -> None:
    """Oracle: the limit, for a gradient of constant direction; rigid poses."""
    poses = PhotoPoses(photos.train, photos.scene.cameras.viewmats, unit=1.0, limit=0.02)
    pull = np.zeros((4, 4), np.float32)
    pull[0, 3] = -1.0
    for _ in range(100):
        poses.learn(2, pull, 1e-3)
    turned, shifted = pose_distances(poses.viewmats, photos.scene.cameras.viewmats)
    assert 0.015 < shifted[2] <= 0.02 + 0.005
    assert turned.max() < 0.02
    turns = poses.viewmats[:, :3, :3]
    assert np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max() < 1e-12


def test_a_derivative_that_is_not_finite_moves_nothing(photos: Any) -> None:
    """Oracle: the previous poses."""
    poses = PhotoPoses(photos.train, photos.scene.cameras.viewmats, unit=1.0)
    poses.learn(1, np.full((4, 4), np.nan), 1e-3)
    assert (poses.viewmats == photos.scene.cameras.viewmats).all()


def test_disturbed_poses_come_back(make_photos: Callable[..., Any]) -> None:
    """Oracle: the points in the cameras of the rendered photos; at most half of the disturbance is
    left, apart from a common motion, and the training error falls."""
    photos = make_photos()
    wrong = disturbed(photos, degrees=1.5, shift=0.02)
    config = replace(
        CONFIG,
        iterations=600,
        background=Background.BLACK,
        sh_degree=0,
        pose_lr=3e-3,
    )

    def trained(checked_poses: PoseCheck) -> Trainer:
        trainer = Trainer(config, Analysis(photos=photos, pose_check=checked_poses))
        for _ in range(config.iterations):
            trainer.step()
        return trainer

    refined = trained(PoseCheck(viewmats=wrong, learns=True))
    kept = trained(PoseCheck(viewmats=wrong))
    similarity = refined.frame.similarity
    truth = similarity.cameras_to_training(photos.scene.cameras).viewmats
    points = similarity.points_to_training(photos.scene.points.points)

    def missed(trainer: Trainer) -> float:
        assert trainer.photo_parameters.poses is not None
        seen = [
            p[:, :2] / p[:, 2:] for p in _local(trainer.photo_parameters.poses.viewmats, points)
        ]
        true = [p[:, :2] / p[:, 2:] for p in _local(truth, points)]
        off = np.array(seen) - np.array(true)
        slopes = _slopes(truth, points)
        common = np.linalg.lstsq(slopes.reshape(-1, 6), off.ravel(), rcond=None)[0]
        return float(np.sqrt(((off.ravel() - slopes.reshape(-1, 6) @ common) ** 2).mean()))

    assert missed(refined) < missed(kept) / 2
    assert refined.error() < 0.9 * kept.error()


def _local(viewmats: np.ndarray, points: np.ndarray) -> np.ndarray:
    """[V, P, 3]: points [P, 3] in the axes of each camera."""
    return points @ viewmats[:, :3, :3].transpose(0, 2, 1) + viewmats[:, None, :3, 3]


def _slopes(viewmats: np.ndarray, points: np.ndarray) -> np.ndarray:
    """[V, P, 2, 6]: how x / z and y / z change as the world turns and shifts, by differences."""
    found, step = [], 1e-6
    for axis in np.eye(6):
        ways = []
        for sign in (step, -step):
            world = moved_pose(np.eye(4), sign * axis)
            local = _local(viewmats @ world, points)
            ways.append(local[..., :2] / local[..., 2:])
        found.append((ways[0] - ways[1]) / (2 * step))
    return np.stack(found, axis=-1)


def test_poses_stay_before_and_after_their_time(
    photos: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the bits of the poses up to the start of the refinement and from its end on."""
    monkeypatch.setattr(photo_parameters, "_START", 0.25)
    monkeypatch.setattr(photo_parameters, "_STOP", 0.5)
    checked_poses = PoseCheck(viewmats=photos.scene.cameras.viewmats, learns=True)
    trainer, seen = Trainer(CONFIG, Analysis(photos=photos, pose_check=checked_poses)), []
    assert trainer.photo_parameters.poses is not None
    for _ in range(60):
        trainer.step()
        seen.append(trainer.photo_parameters.poses.viewmats.copy())
    assert all((now == seen[0]).all() for now in seen[:14])
    assert not (seen[20] == seen[0]).all()
    assert all((now == seen[-1]).all() for now in seen[30:])


def test_resume_is_bit_equal(photos: Any, tmp_path: Path) -> None:
    """Oracle: all tensors and other state of an uninterrupted run, with other threads."""
    checked_poses = PoseCheck(viewmats=disturbed(photos, degrees=0.5, shift=0.01), learns=True)
    whole = Trainer(replace(CONFIG, threads=1), Analysis(photos=photos, pose_check=checked_poses))
    for step in range(1, 61):
        whole.step()
        if step in (3, 21, 50):
            checkpoint.save(tmp_path / f"{step}.safetensors", whole, {})
    for stop in (3, 21, 50):
        found = checkpoint.load(tmp_path / f"{stop}.safetensors")
        resumed = Trainer(replace(CONFIG, threads=2), Analysis(photos=photos))
        resumed.restore(found.trainer, found.tensors)
        while resumed.steps < 60:
            resumed.step()
        mine, theirs = resumed.tensors(), whole.tensors()
        assert mine.keys() == theirs.keys()
        assert all(torch.equal(tensor, theirs[name]) for name, tensor in mine.items())
        assert resumed.state() == whole.state()


@pytest.mark.parametrize(
    "damage",
    [
        {"pose/viewmats": np.zeros((3, 4, 4))},
        {"pose/first": np.full((8, 4, 4), np.nan)},
        {"pose/facts": np.zeros(2)},
        {"pose/steps": np.full(8, -1)},
    ],
)
def test_a_damaged_checkpoint_is_refused(photos: Any, damage: dict[str, np.ndarray]) -> None:
    """Oracle: the exception that becomes a FormatError."""
    poses = PhotoPoses(photos.train, photos.scene.cameras.viewmats, unit=1.0)
    with pytest.raises(ValueError, match="pose/"):
        PhotoPoses.restored(photos.train, 8, poses.arrays() | damage)
