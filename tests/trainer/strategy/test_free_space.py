"""No splats in the free space around cameras."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gscore.config import DataConfig, Strategy, TrainConfig
from gscore.errors import ConfigError
from gscore.events import Event, Warn
from gscore.io.ply.splats import write_splats
from gscore.scene import PointCloud
from gscore.splats import PARAMETERS, Splats
from gscore.trainer import session
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.files import checkpoint
from gscore.trainer.model.nearest_points import NearestPoints
from gscore.trainer.run import train
from gscore.trainer.schedule.plan import Plan
from gscore.trainer.strategy import free_path as free_space
from gscore.trainer.strategy import pruning
from gscore.trainer.strategy.free_path import FreeSpace
from gscore.trainer.trainer import Trainer

CONFIG = TrainConfig(iterations=40, refine_start=10, refine_stop=20, refine_every=10, sh_every=100)


def slowly(means: np.ndarray, cameras: np.ndarray, points: np.ndarray, share: float) -> np.ndarray:
    """[N] bool, one distance after the other."""
    out = np.zeros(len(means), bool)
    for center in cameras:
        tenth = sorted(float(np.linalg.norm(point - center)) for point in points)[9]
        for row, mean in enumerate(means):
            out[row] |= bool(np.linalg.norm(mean - center) < share * tenth)
    return out


@pytest.mark.parametrize("offset", [0.0, 1e3])
def test_balls_are_those_of_the_definition(offset: float) -> None:
    """Oracle: all distances, one by one; also far from the origin, and for more rows than one
    part."""
    rng = np.random.default_rng(3)
    cameras = rng.normal(size=(7, 3)) * 0.4 + offset
    points = rng.normal(size=(600, 3)) * 3 + offset
    means = torch.from_numpy((rng.normal(size=(1000, 3)) + offset).astype(np.float32))
    means[5] = torch.nan
    means[6] = torch.inf
    expected = slowly(means.double().numpy(), cameras, points, 0.6)
    assert 20 < expected.sum() < 980
    space = FreeSpace(cameras, NearestPoints(points), share=0.6)
    assert space.contains(means).numpy().tolist() == expected.tolist()
    many = means.repeat(200, 1)
    assert space.contains(many).numpy().tolist() == expected.tolist() * 200


def test_points_that_are_not_finite_free_no_space() -> None:
    """Oracle: the definition, without points that are not finite."""
    rng = np.random.default_rng(0)
    points, camera, here = rng.normal(size=(600, 3)) + 5, np.zeros((1, 3)), torch.zeros(1, 3)
    assert FreeSpace(camera, NearestPoints(points), share=0.4).contains(here).all()
    assert not FreeSpace(camera, NearestPoints(points), share=0.0).contains(here).any()
    assert not FreeSpace(camera, NearestPoints(points[:499]), share=0.4).contains(here).any()
    points[:101] = np.nan
    assert not FreeSpace(camera, NearestPoints(points), share=0.4).contains(here).any()
    assert not FreeSpace(camera[:0], NearestPoints(points), share=0.4).contains(here).any()


@pytest.fixture
def known(photos: Any, known_splats: Splats) -> Any:
    """The toy capture with this number of points, four on each splat."""
    rng = np.random.default_rng(1)
    places = np.repeat(known_splats.means.astype(np.float64), 4, axis=0)
    places = places + rng.normal(size=places.shape) * 0.01
    cloud = PointCloud(points=places, colors=np.full((len(places), 3), 128, np.uint8))
    return replace(photos, scene=replace(photos.scene, points=cloud))


def with_walls(splats: Splats, photos: Any) -> Splats:
    """The capture with an opaque splat just in front of each camera."""
    cameras = photos.scene.cameras
    ahead = cameras.centers + 0.05 * cameras.viewmats[:, 2, :3]
    count = len(ahead)
    more = {
        "means": ahead.astype(np.float32),
        "scales": np.full((count, 3), np.log(0.01), np.float32),
        "opacities": np.full(count, 4, np.float32),
    }
    rows = {
        name: np.concatenate([getattr(splats, name), more.get(name, getattr(splats, name)[:count])])
        for name in PARAMETERS
    }
    return replace(splats, **rows)


@pytest.mark.parametrize("strategy", list(Strategy))
def test_walls_before_cameras_go(known: Any, known_splats: Splats, strategy: Strategy) -> None:
    """Oracle: their known places; the scene's splats stay. Without the option the walls stay."""
    walls = len(known.scene.cameras.centers)
    config = replace(CONFIG, strategy=strategy, max_splats=len(known_splats) + walls, grow_grad=1e9)
    start = with_walls(known_splats, known)
    trainer = Trainer(config, Analysis(photos=known, start=start))
    removed = [trainer.step().change.removed for _ in range(40)]
    assert trainer.pruner.around.count == walls == removed[9]
    centers, near = known.scene.cameras.centers, trainer.splats().means[:, None]
    assert np.linalg.norm(near - centers, axis=2).min() > 0.2
    assert len(trainer.model) >= len(known_splats) - 5

    left = Trainer(replace(config, free_space=0.0), Analysis(photos=known, start=start))
    for _ in range(40):
        left.step()
    near = np.linalg.norm(left.splats().means[:, None] - centers, axis=2).min(axis=0)
    assert left.pruner.around.count == 0 and (near < 0.2).all()


def test_clearing_goes_on_to_the_end_and_after_a_resume(
    known: Any, known_splats: Splats, tmp_path: Path
) -> None:
    """Oracle: bit equality; walls added after the refinements are removed by the next clearing."""
    walls = len(known.scene.cameras.centers)
    config = replace(CONFIG, max_splats=1000, threads=1)
    whole = Trainer(config, Analysis(photos=known, start=with_walls(known_splats, known)))
    for step in range(1, 41):
        whole.step()
        if step == 25:
            ahead = whole.frame.similarity.points_to_training(known.scene.cameras.centers)
            whole.model.params["means"][:walls] = torch.from_numpy(ahead + 1e-3).float()
            checkpoint.save(tmp_path / "25.safetensors", whole, {})
    assert whole.pruner.around.count == 2 * walls
    found = checkpoint.load(tmp_path / "25.safetensors")
    resumed = Trainer(replace(config, threads=2), Analysis(photos=known, start=known_splats))
    resumed.restore(found.trainer, found.tensors)
    while resumed.steps < 40:
        resumed.step()
    assert resumed.state() == whole.state()
    for key, tensor in whole.tensors().items():
        assert torch.equal(resumed.tensors()[key], tensor), key


def test_crowded_free_space_is_kept(known: Any, known_splats: Splats) -> None:
    """Oracle: the number of splats, all of them in free space; none is removed later, nor after a
    resume."""
    start = with_walls(known_splats, known)
    walls = len(known.scene.cameras.centers)
    start = replace(start, **{name: getattr(start, name)[-walls:] for name in PARAMETERS})
    config = replace(CONFIG, strategy=Strategy.MCMC, max_splats=walls)
    trainer = Trainer(config, Analysis(photos=known, start=start))
    for _ in range(12):
        trainer.step()
    assert (
        len(trainer.model) == walls
        and trainer.pruner.around.count == 0
        and trainer.pruner.around.crowded
    )
    resumed = Trainer(config, Analysis(photos=known, start=start))
    resumed.restore(trainer.state(), dict(trainer.tensors()))
    resumed.model.params["means"][1:] = 0.0
    while resumed.steps < 40:
        resumed.step()
    assert resumed.pruner.around.crowded and resumed.pruner.around.count == 0


def test_points_that_are_made_up_free_nothing(known: Any, known_splats: Splats) -> None:
    """Oracle: the walls, which stay; points of depth maps count, so that their surfaces stay."""
    start = with_walls(known_splats, known)
    config = replace(CONFIG, max_splats=len(start), grow_grad=1e9)
    cloud = known.scene.points
    nearer = np.repeat(start.means[-len(known.train) :].astype(np.float64), 10, axis=0)
    near = PointCloud(
        points=np.concatenate([cloud.points, nearer]),
        colors=np.concatenate([cloud.colors, np.zeros((len(nearer), 3), np.uint8)]),
    )
    for points, gone in ((cloud, 8), (replace(cloud, made_up=True), 0), (near, 0)):
        trainer = Trainer(config, Analysis(photos=known, start=start, points=points))
        for _ in range(10):
            trainer.step()
        assert trainer.pruner.around.count == gone


def test_held_out_cameras_free_nothing(known: Any, known_splats: Splats) -> None:
    """Oracle: the wall in front of the held-out view, which stays."""
    seven = replace(known, train=list(range(7)), test=[7])
    config = replace(CONFIG, max_splats=1000, grow_grad=1e9)
    trainer = Trainer(config, Analysis(photos=seven, start=with_walls(known_splats, known)))
    for _ in range(10):
        trainer.step()
    assert trainer.pruner.around.count == 7


def test_many_pruned_splats_warn(
    capture: Path, known: Any, known_splats: Splats, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: a warning with a remedy for 8 of 158 splats."""
    monkeypatch.setattr(free_space, "FEWEST_POINTS", 100)
    write_splats(tmp_path / "walls.ply", with_walls(known_splats, known))
    config = replace(CONFIG, start_splats=tmp_path / "walls.ply", max_splats=158)
    (reported,) = warnings_of(config, capture, tmp_path / "run")
    assert reported.startswith("8 splats")
    monkeypatch.setattr(session, "_MANY_CLEARED", 0.06)
    assert not warnings_of(config, capture, tmp_path / "few")
    monkeypatch.setattr(pruning, "_CROWD", 0.04)
    (reported,) = warnings_of(config, capture, tmp_path / "crowd")
    assert reported.startswith("Many splats are closer")
    assert not warnings_of(replace(config, free_space=0.0), capture, tmp_path / "anywhere")


def warnings_of(config: TrainConfig, capture: Path, output: Path) -> list[str]:
    """Warnings that name the option."""
    seen: list[Event] = []
    train(config, DataConfig(source=capture), output, seen.append)
    return [e.message for e in seen if isinstance(e, Warn) and "`--free-space 0`" in e.message]


def test_when_it_clears() -> None:
    """Oracle: by hand; refinements from step 15 to 20 only."""
    config = replace(CONFIG, iterations=35, refine_start=15)
    plan = Plan.of(config, extent=1.0, points=100, side=100, pixels=10_000)
    assert [step for step in range(1, 36) if plan.prunes_free_space_at(step)] == [10, 20, 30, 35]


@pytest.mark.parametrize("share", [-0.1, 1.0, np.nan])
def test_shares_out_of_range_are_refused(share: float) -> None:
    """Oracle: the documented range."""
    with pytest.raises(ConfigError, match="free_space must be 0 to less than 1"):
        TrainConfig(free_space=share)
