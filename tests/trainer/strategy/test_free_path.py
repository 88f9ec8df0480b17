"""No splats without support between neighbouring cameras."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch

from gscore.camera_neighbours import neighbours
from gscore.config import TrainConfig
from gscore.scene import Cameras, PointCloud
from gscore.splats import PARAMETERS, Splats
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.model.nearest_points import NearestPoints
from gscore.trainer.strategy.free_path import FreePath
from gscore.trainer.trainer import Trainer

SIZE = 100


def facing(centers: np.ndarray, turned: np.ndarray, names: list[str] | None = None) -> Cameras:
    """Cameras at `centers`, [C, 3], that look along +z, or -z where `turned`, [C] bool; field of
    view 90 degrees."""
    viewmats = np.tile(np.eye(4), (len(centers), 1, 1))
    viewmats[turned, 0, 0] = viewmats[turned, 2, 2] = -1.0
    viewmats[:, :3, 3] = -np.einsum("cij,cj->ci", viewmats[:, :3, :3], centers)
    K = np.array([[SIZE / 2, 0, SIZE / 2], [0, SIZE / 2, SIZE / 2], [0, 0, 1]])
    return Cameras(
        viewmats=viewmats,
        Ks=np.tile(K, (len(centers), 1, 1)),
        widths=np.full(len(centers), SIZE),
        heights=np.full(len(centers), SIZE),
        names=tuple(names or [f"{i:03}.png" for i in range(len(centers))]),
    )


def wall(z: float) -> np.ndarray:
    """[400, 3], points on a wall."""
    x, y = np.meshgrid(np.linspace(-6, 6, 20), np.linspace(-6, 6, 20))
    return np.stack([x.ravel(), y.ravel(), np.full(400, z)], axis=1)


def yard() -> tuple[Cameras, np.ndarray]:
    """Two rows of eight cameras 8 units apart, each looking at a wall 2 units behind the other
    row, and points on both walls."""
    x = np.linspace(-3, 3, 8)
    rows = [np.stack([x, 0 * x, np.full(8, z)], axis=1) for z in (-4.0, 4.0)]
    cameras = facing(np.concatenate(rows), np.repeat([False, True], 8))
    return cameras, np.concatenate([wall(-6.0), wall(6.0)])


def path(cameras: Cameras, points: np.ndarray, share: float = 0.4) -> FreePath:
    return FreePath(cameras, list(range(len(cameras))), NearestPoints(points), share=share)


def contains(space: FreePath, *means: tuple[float, float, float]) -> list[bool]:
    return space.contains(torch.tensor(means, dtype=torch.float32)).tolist()


def test_what_only_far_cameras_show_is_removed() -> None:
    """Oracle: the yard. A splat .1 in front of the path is in no picture of its row and in those of
    the far row; on a wall, in the middle, and 1.35 in front of the row it is shown from nearby."""
    cameras, points = yard()
    space = path(cameras, points)
    gap = 3 / 7  # half of the distance of two cameras
    veil = (gap * 2, 0.0, -3.95)
    assert (
        contains(space, veil, (gap * 2, 0.0, 6.0), (0, 0, 0), (0, 0, -2.65)) == [True] + [False] * 3
    )
    assert contains(path(cameras, points, share=0.0), veil) == [False]
    assert contains(path(cameras, points[:499]), veil) == [False]
    assert contains(FreePath(cameras, [0], NearestPoints(points), share=0.4), veil) == [False]
    assert contains(FreePath(cameras, list(range(16)), None, share=0.4), veil) == [False]
    five = FreePath(cameras, [0, 1, 3, 4, 5], NearestPoints(points), share=0.4)
    assert len(five.places) == 0, "too few cameras to support anything"


def test_no_path_leads_through_an_object() -> None:
    """Oracle: a post with 40 points between two cameras, of which the far row shows the back."""
    cameras, points = yard()
    post = (3 / 7 * 2, 0.0, -3.95)
    assert contains(path(cameras, points), post) == [True]
    around = post + np.random.default_rng(0).normal(size=(40, 3)) * 0.02
    assert contains(path(cameras, np.concatenate([points, around])), post) == [False]


def test_cameras_that_look_elsewhere_have_no_path_between_them() -> None:
    """Oracle: the yard's two rows, back to back, without neighbours in their rows."""
    cameras, points = yard()
    two = facing(np.array([[0, 0, -1.0], [0, 0, 1.0]]), np.array([True, False]))
    assert len(path(two, points).places) == 0
    assert len(path(cameras, points).places) > 0


def test_neighbours_are_those_of_the_definition() -> None:
    """Oracle: the Gabriel graph by all triples, as all are among the twelve nearest, and the order
    of names."""
    rng = np.random.default_rng(2)
    centers = rng.normal(size=(12, 3))
    names = [f"{i}" for i in rng.permutation(12)]
    expected = set()
    for a in range(12):
        for b in range(a):
            middle, radius = (centers[a] + centers[b]) / 2, np.linalg.norm(centers[a] - centers[b])
            others = [c for c in range(12) if c not in (a, b)]
            if all(np.linalg.norm(centers[c] - middle) > radius / 2 for c in others):
                expected.add((b, a))
    order = sorted(range(12), key=lambda i: int(names[i]))
    expected |= {(min(p), max(p)) for p in pairwise(order)}
    assert list(neighbours(centers, names)) == sorted(expected)


def test_names_are_in_natural_order_and_one_place_has_no_neighbours() -> None:
    """Oracle: twelve cameras in a line, named 1 to 12, each next to the following one; the same
    with three more cameras at each place, whose first has the neighbours."""
    line = np.arange(12.0)[:, None] * [1.0, 0, 0]
    names = [f"view_{i}.png" for i in range(1, 13)]
    assert list(neighbours(line, names)) == [(i, i + 1) for i in range(11)]
    four = np.repeat(line, 4, axis=0)
    pairs = list(neighbours(four, [f"{i}" for i in range(48)]))
    assert {(a // 4, b // 4) for a, b in pairs} == {(i, i + 1) for i in range(11)}
    assert list(neighbours(np.zeros((5, 3)), list("abcde"))) == []


def test_support_is_that_of_the_definition() -> None:
    """Oracle: each splat and camera by itself, with projections by hand."""
    cameras, points = yard()
    space = path(cameras, points)
    rng = np.random.default_rng(5)
    means = rng.uniform([-4, -0.5, -6], [4, 0.5, 6], size=(4000, 3)).astype(np.float32)
    expected = []
    for mean in means.astype(np.float64):
        away = np.linalg.norm(space.places - mean, axis=1)
        count = 0
        for center, turned in zip(cameras.centers, [False] * 8 + [True] * 8, strict=True):
            x, y, z = (mean - center) * ([-1, 1, -1] if turned else [1, 1, 1])
            near = np.linalg.norm(mean - center) < 2 * away.min()
            count += bool(z > 0 and abs(x) < z and abs(y) < z and near)
        expected.append(bool((away < space.radii).any()) and count < 3)
    assert 20 < sum(expected) < 3000
    assert space.contains(torch.from_numpy(means)).tolist() == expected


def test_cameras_at_one_place_or_far_apart_are_no_error() -> None:
    """Oracle: rotation only has no path; a gap of a thousand units has at most sixteen places; not
    finite means are outside."""
    _, points = yard()
    same = facing(np.zeros((5, 3)), np.zeros(5, bool))
    assert len(path(same, points).places) == 0
    x = np.array([0, 0.1, 0.2, 1000, 1000.1, 1000.2])
    apart = facing(np.stack([x, 0 * x, 0 * x], axis=1), np.zeros(6, bool))
    assert 0 < len(path(apart, points).places) <= 16 + 4
    cameras, points = yard()
    assert contains(path(cameras, points), (np.nan, 0, 0), (np.inf, 0, 0)) == [False, False]


def test_a_training_removes_a_veil_and_resumes_with_its_count(
    photos: Any, known_splats: Splats
) -> None:
    """Oracle: the place of the veil, which no camera nearby shows; the count in the state."""
    cameras = photos.scene.cameras
    rng = np.random.default_rng(1)
    points = np.repeat(known_splats.means.astype(np.float64), 4, axis=0)
    cloud = PointCloud(
        points=points + rng.normal(size=points.shape) * 0.01,
        colors=np.full((len(points), 3), 128, np.uint8),
    )
    known = replace(photos, scene=replace(photos.scene, points=cloud))
    config = TrainConfig(
        iterations=20, refine_start=10, refine_every=10, max_splats=1000, grow_grad=1e9
    )
    a, b = next(iter(neighbours(cameras.centers, list(cameras.names))))
    middle = (cameras.centers[a] + cameras.centers[b]) / 2
    veil = middle + 0.02 * (cameras.viewmats[a, 2, :3] + cameras.viewmats[b, 2, :3])
    rows = {name: getattr(known_splats, name) for name in PARAMETERS}
    rows = {name: np.concatenate([value, value[:1]]) for name, value in rows.items()}
    rows["means"][-1] = veil
    trainer = Trainer(config, Analysis(photos=known, start=replace(known_splats, **rows)))
    for _ in range(10):
        trainer.step()
    assert (trainer.pruner.path.count, trainer.pruner.around.count) == (1, 0)
    state = trainer.state()
    resumed = Trainer(config, Analysis(photos=known, start=known_splats))
    resumed.restore(state, dict(trainer.tensors()))
    assert resumed.pruner.path.count == 1
