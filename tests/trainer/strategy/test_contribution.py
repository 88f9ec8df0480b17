"""Contribution of splats to the photos, and pruning by it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gscore.config import Strategy, TrainConfig
from gscore.engine.base import Contribution, StepPhoto
from gscore.engine.cpu.engine import CpuEngine
from gscore.errors import ConfigError
from gscore.raster.api import render
from gscore.scene import Cameras
from gscore.sh import rgb_to_sh0
from gscore.splats import PARAMETERS, Splats
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.estimate.cost import Cost
from gscore.trainer.files import checkpoint
from gscore.trainer.photos.view_sampler import training_camera
from gscore.trainer.schedule.plan import Plan
from gscore.trainer.strategy.pruning import lowest_rows, max_contribution, mostly_masked
from gscore.trainer.trainer import Trainer


def weights_of(
    splats: Splats, cameras: Cameras, masks: list[Any] | None = None, threads: int = 1
) -> np.ndarray:
    shown = []
    for i, name in enumerate(cameras.names):
        w, h = int(cameras.widths[i]), int(cameras.heights[i])
        assert name
        mask = None if masks is None else masks[i]
        blank = np.zeros((h, w, 3), np.uint8)
        view = training_camera(cameras.viewmats[i], cameras.Ks[i], w, h, 0.01)
        shown.append((view, StepPhoto(image=blank, mask=mask, mask_mode="ignore")))
    engine = CpuEngine(threads=threads)
    model = engine.model({name: getattr(splats, name).copy() for name in PARAMETERS})
    weights = engine.contributions(model, shown, antialias=False)
    return max_contribution(weights, len(splats)).numpy()


def slowly(splats: Splats, cameras: Cameras, masks: list[Any] | None = None) -> np.ndarray:
    """Weights by rendering each splat in white among black ones."""
    out = np.zeros((len(splats), len(cameras.names)))
    for row in range(len(splats)):
        colors = np.zeros((len(splats), 1, 3))
        colors[row] = 1
        lone = replace(splats, sh0=rgb_to_sh0(colors).astype(np.float32))
        for i in range(len(cameras.names)):
            size = int(cameras.widths[i]), int(cameras.heights[i])
            rgb = render(lone, cameras.Ks[i], cameras.viewmats[i], *size, sh_degree=0).rgb
            seen = 1 if masks is None else masks[i] / 255
            out[row, i] = (rgb[..., 0].astype(np.float64) * seen).sum()
    return out.max(axis=1)


def first_views(cameras: Cameras, count: int) -> Cameras:
    return replace(
        cameras,
        viewmats=cameras.viewmats[:count],
        Ks=cameras.Ks[:count],
        widths=cameras.widths[:count],
        heights=cameras.heights[:count],
        names=cameras.names[:count],
    )


def test_weights_are_what_is_seen_of_a_white_splat(photos: Any, known_splats: Splats) -> None:
    """Oracle: pictures of one white splat among black ones; colours below zero and hidden splats do
    not matter."""
    rng = np.random.default_rng(0)
    splats = replace(known_splats, sh0=rng.normal(size=(150, 1, 3)).astype(np.float32) * 3)
    cameras = first_views(photos.scene.cameras, 2)
    expected = slowly(splats, cameras)
    assert expected.min() < 1 < 20 < expected.max()
    np.testing.assert_allclose(weights_of(splats, cameras), expected, rtol=2e-4, atol=1e-3)


def test_masked_pixels_contribute_nothing(photos: Any, known_splats: Splats) -> None:
    """Oracle: as above, pixels weighted by the mask."""
    cameras = first_views(photos.scene.cameras, 2)
    masks = [np.zeros((48, 48), np.uint8) for _ in range(2)]
    masks[0][:, :20] = 255
    masks[1][30:] = 128
    expected = slowly(known_splats, cameras, masks)
    found = weights_of(known_splats, cameras, masks)
    np.testing.assert_allclose(found, expected, rtol=2e-4, atol=1e-3)
    assert (found < weights_of(known_splats, cameras) + 1e-3).all()


def test_weights_do_not_depend_on_threads(photos: Any, known_splats: Splats) -> None:
    """Oracle: bit equality."""
    cameras = photos.scene.cameras
    one, two = (weights_of(known_splats, cameras, threads=n) for n in (1, 2))
    assert one.tobytes() == two.tobytes()


def test_least_takes_the_first_of_equals() -> None:
    """Oracle: by hand."""
    weights = torch.tensor([3.0, 0.0, 1.0, 0.0, 1.0])
    taken = [lowest_rows(weights, n).nonzero().flatten().tolist() for n in range(6)]
    assert taken == [[], [1], [1, 3], [1, 2, 3], [1, 2, 3, 4], [0, 1, 2, 3, 4]]


CONFIG = TrainConfig(
    iterations=60,
    max_splats=300,
    sh_every=12,
    refine_start=10,
    refine_stop=30,
    refine_every=10,
    grow_grad=1e-5,
    prune_share=0.4,
)


@pytest.mark.parametrize("strategy", list(Strategy))
def test_the_least_useful_go_when_refinements_are_over(photos: Any, strategy: Strategy) -> None:
    """Oracle: the same training without pruning, rendered for the contributions; 0.6 of the maximum
    number stay, with all of their numbers."""
    config = replace(CONFIG, strategy=strategy)
    trainer, whole = (
        Trainer(config, Analysis(photos=photos)),
        Trainer(replace(config, prune_share=0.0), Analysis(photos=photos)),
    )
    for _ in range(29):
        whole.step()
        assert trainer.step().change.removed <= len(trainer.model)
    assert trainer.tensors().keys() == whole.tensors().keys()
    for key, tensor in whole.tensors().items():
        assert torch.equal(trainer.tensors()[key], tensor), f"{key} differs before pruning"
    most = max(len(whole.model), 300)
    result, unpruned = trainer.step(), whole.step()
    assert len(whole.model) == most
    assert result.change.removed - unpruned.change.removed == most - round(0.6 * most)
    weights = torch.from_numpy(weights_of(whole.splats(), photos.scene.cameras))
    dropped = most - round(0.6 * most)
    kept = (~lowest_rows(weights, dropped)).nonzero().flatten()
    # Weights in world units and at full size differ by rounding, so almost the same rows stay.
    ours = {row.numpy().tobytes() for row in trainer.model.params["means"]}
    theirs = {row.numpy().tobytes() for row in whole.model.params["means"][kept]}
    assert len(ours & theirs) >= 0.98 * len(kept)
    assert all(len(m) == len(kept) for name in PARAMETERS for m in trainer.model.moments(name))
    for _ in range(30):
        assert trainer.step().change.removed == 0
    assert len(trainer.model) == round(0.6 * most)


def test_pruning_is_the_same_for_any_threads_and_after_a_resume(
    photos: Any, tmp_path: Path
) -> None:
    """Oracle: bit equality of all tensors after the last step."""
    whole = Trainer(replace(CONFIG, threads=1), Analysis(photos=photos))
    for step in range(1, 61):
        whole.step()
        if step in (29, 30, 31):
            checkpoint.save(tmp_path / f"{step}.safetensors", whole, {})
    assert len(whole.model) == 180
    for stop in (29, 30, 31):
        found = checkpoint.load(tmp_path / f"{stop}.safetensors")
        resumed = Trainer(replace(CONFIG, threads=2), Analysis(photos=photos))
        resumed.restore(found.trainer, found.tensors)
        while resumed.steps < 60:
            resumed.step()
        assert resumed.state() == whole.state()
        for key, tensor in whole.tensors().items():
            assert torch.equal(resumed.tensors()[key], tensor), f"{key}, resumed at step {stop}"


def plan_of(share: float, iterations: int = 100) -> Plan:
    config = TrainConfig(
        iterations=iterations, prune_share=share, refine_stop=50, max_splats=1000, refine_every=10
    )
    return Plan.of(config, extent=1.0, points=1000, side=100, pixels=10_000)


def test_surplus() -> None:
    """Oracle: the definition; pruned splats are not pruned again."""
    plan = plan_of(0.4)
    assert [plan.surplus_at(step, 1000, 0) for step in (1, 49, 50, 70)] == [0, 0, 400, 400]
    assert [plan.surplus_at(60, n, 1000 - n) for n in (601, 600, 10)] == [1, 0, 0]
    assert plan_of(0.0).surplus_at(60, 1000, 0) == 0
    assert plan_of(0.999).surplus_at(60, 3, 0) == 2, "one is left"
    assert plan_of(0.4, iterations=40).surplus_at(39, 10, 0) == 4, "a run that ends before"


def test_the_forecast_knows_that_fewer_remain() -> None:
    """Oracle: half of the splats in half of the steps; the full number before."""
    full, half = plan_of(0.0), plan_of(0.5)
    assert Cost(half).seconds_after(0, 1000) < Cost(full).seconds_after(0, 1000)
    assert Cost(half).seconds_after(60, 500) == Cost(full).seconds_after(60, 500)
    later = [Cost(half).seconds_at(step, 1000 if step <= 50 else 500) for step in range(1, 101)]
    assert Cost(half).seconds_after(0, 1000) == pytest.approx(sum(later), rel=0.05)


def test_a_share_of_one_is_refused(make_photos: Callable[..., Any]) -> None:
    """Oracle: the refusal, because no splat would be left."""
    with pytest.raises(ConfigError, match="prune_share"):
        TrainConfig(prune_share=1.0)


def test_mostly_hidden_counts_all_views() -> None:
    """Oracle: by hand; splats outside all views are not hidden."""
    weights = [
        Contribution(np.float32([0.0, 1.0, 0.0, 0.5]), np.float32([8.0, 8.0, 0.0, 1.0])),
        Contribution(np.float32([0.3, 1.0, 0.0, 0.0]), np.float32([2.0, 2.0, 0.0, 9.0])),
    ]
    assert mostly_masked(weights, 4, share=0.05).tolist() == [True, False, False, False]
    assert mostly_masked(weights, 4, share=0.06).tolist() == [True, False, False, True]


def hidden_left_half(photos: Any, mode: str = "ignore") -> Any:
    """`photos` with masks that hide their left halves."""
    mask = np.zeros((48, 48), np.uint8)
    mask[:, 24:] = 255
    photos.mask_mode, photos.masks = mode, [mask for _ in photos.images]
    return photos


def kept_share(splats: Splats, photos: Any) -> np.ndarray:
    """[N]: share of a splat's weight in the training views that masks show; NaN: not visible."""
    kept, whole = np.zeros(len(splats)), np.zeros(len(splats))
    cameras = photos.scene.cameras
    for row in range(len(splats)):
        colors = np.zeros((len(splats), 1, 3))
        colors[row] = 1
        lone = replace(splats, sh0=rgb_to_sh0(colors).astype(np.float32), shN=splats.shN[:, :0])
        for i in photos.train:
            size = int(cameras.widths[i]), int(cameras.heights[i])
            rgb = render(lone, cameras.Ks[i], cameras.viewmats[i], *size, sh_degree=0).rgb
            seen = rgb[..., 0].astype(np.float64)
            kept[row] += (seen * (photos.masks[i] / 255)).sum()
            whole[row] += seen.sum()
    return np.divide(kept, whole, out=np.full(len(splats), np.nan), where=whole > 0)


@pytest.mark.parametrize("strategy", list(Strategy))
def test_splats_that_masks_hide_go(make_photos: Any, strategy: Strategy) -> None:
    """Oracle: shares of weight from pictures of single splats, with their median as the limit; all
    splats stay with a limit of 0, and where masks are opacity."""

    def after_ten_steps(limit: float, mode: str) -> tuple[Trainer, int]:
        config = TrainConfig(
            iterations=30,
            refine_start=90,
            refine_every=10,
            sh_every=100,
            strategy=strategy,
            hidden_share=limit,
        )
        trainer = Trainer(config, Analysis(photos=hidden_left_half(make_photos(), mode)))
        return trainer, [trainer.step().change.removed for _ in range(10)][-1]

    whole, removed = after_ten_steps(0.0, "ignore")
    assert removed == 0
    share = kept_share(whole.splats(), whole.photos)
    limit = float(np.nanmedian(share))
    assert 0 < limit < 1
    assert after_ten_steps(limit, "composite")[1] == 0
    left, removed = after_ten_steps(limit, "ignore")
    assert removed == len(whole.model) - len(left.model) > 10
    found = {row.tobytes() for row in left.splats().means}
    gone = np.array([row.tobytes() not in found for row in whole.splats().means])
    sure = ~(np.abs(share - limit) < 0.01)
    assert sure.sum() > len(sure) / 2
    np.testing.assert_array_equal(gone[sure], (share < limit)[sure])


def test_when_hidden_splats_go() -> None:
    """Oracle: by hand."""
    config = TrainConfig(iterations=1500, refine_every=100)
    plan = Plan.of(config, extent=1.0, points=100, side=300, pixels=90000)
    assert [step for step in range(1, 1501) if plan.prunes_masked_at(step)] == [500, 1000]
    plan = Plan.of(replace(config, iterations=2000), extent=1.0, points=100, side=300, pixels=90000)
    assert [step for step in range(1, 2001) if plan.prunes_masked_at(step)] == [700, 1400]
