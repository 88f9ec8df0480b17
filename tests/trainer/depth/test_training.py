"""Training with depth; oracles: known splats, bit equality, the rasterizer's arguments."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gscore.config import Strategy, TrainConfig
from gscore.errors import ConfigError
from gscore.raster.api import render
from gscore.raster.autograd import rasterize
from gscore.raster.header import OUT_INVERSE_DEPTH
from gscore.raster.training_rasterizer import TrainingRasterizer
from gscore.scene import PointCloud
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.depth.targets import DepthTargets
from gscore.trainer.files import checkpoint
from gscore.trainer.trainer import Trainer
from tests.exact_depth_maps import exact_depth_maps
from tests.trainer.short_run import CONFIG
from tests.trainer.trainer_bits import tensor_bits

EVERYTHING = replace(CONFIG, drop_rate=0.3, alpha_weight=0.1, coarse_factor=2.0)


@pytest.fixture
def masked(make_photos: Callable[..., Any], known_splats: Any) -> Any:
    """The toy capture with its true opacity as masks."""
    photos = make_photos()
    cameras = photos.scene.cameras
    for i in range(len(cameras.names)):
        view = render(known_splats, cameras.Ks[i], cameras.viewmats[i], 48, 48)
        photos.masks[i] = (view.alpha * 255 + 0.5).astype(np.uint8)
    photos.mask_mode = "composite"
    return photos


@pytest.fixture
def targets(photos: Any, known_splats: Any) -> DepthTargets:
    """Exact depth of the toy capture, two views not aligned."""
    return DepthTargets(
        exact_depth_maps(photos, known_splats, unaligned=(1, 4)), train=photos.train, views=8
    )


def run(trainer: Trainer, steps: int) -> Trainer:
    for _ in range(steps):
        trainer.step()
    return trainer


def test_inverse_depth_is_that_of_the_world(photos: Any, known_splats: Any) -> None:
    """Oracle: the same splats rendered in COLMAP world by another entry point."""
    trainer = Trainer(CONFIG, Analysis(photos=photos, start=known_splats))
    assert trainer.frame.similarity.scale != 1
    cameras = photos.scene.cameras
    view = render(known_splats, cameras.Ks[3], cameras.viewmats[3], 48, 48)
    assert view.inverse_depth is not None and view.inverse_depth.max() > 0.3
    np.testing.assert_allclose(trainer.renderer.inverse_depth(3)[0], view.inverse_depth, atol=2e-4)


def test_true_splats_have_no_depth_loss(
    photos: Any, known_splats: Any, targets: DepthTargets
) -> None:
    """Oracle: zero at the true splats, in the training world and at a coarse size; not
    elsewhere."""
    trainer = Trainer(CONFIG, Analysis(photos=photos, start=known_splats, depth=targets))
    assert trainer.depth is not None
    for index in (0, 1):  # aligned and not
        for factor, limit in ((1.0, 4e-3), (2.0, 0.03)):
            view = trainer.renderer.pyramid.at(index, factor).view
            with torch.no_grad():
                out = rasterize(
                    *trainer.model.synced().values(),
                    torch.as_tensor(view.viewmat),
                    torch.as_tensor(view.K),
                    view.width,
                    view.height,
                    raw=True,
                    near=0.01,
                    inverse_depth=True,
                )
            assert out.inverse_depth is not None
            opaque = torch.ones_like(out.alpha)
            assert float(trainer.depth(index, out.inverse_depth, opaque)) < limit
            nothing = torch.zeros_like(out.inverse_depth)
            assert float(trainer.depth(index, nothing, opaque)) > 0.05


def test_depth_off_is_the_training_without_depth(
    photos: Any, targets: DepthTargets, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: bit equality, and no request for inverse depth to the rasterizer."""
    config, asked = replace(CONFIG, photo_blur=False, transient_masks=False), []
    plain = TrainingRasterizer.draw

    def watched(rasterizer: TrainingRasterizer, splats: Any, view: Any, settings: Any) -> Any:
        asked.append(bool(settings.outputs & OUT_INVERSE_DEPTH))
        return plain(rasterizer, splats, view, settings)

    monkeypatch.setattr(TrainingRasterizer, "draw", watched)
    without = run(Trainer(config, Analysis(photos=photos)), 30)
    weightless = replace(config, depth_weight=0.0, depth_weight_final=0.0)
    with_zero = run(Trainer(weightless, Analysis(photos=photos, depth=targets)), 30)
    assert tensor_bits(without) == tensor_bits(with_zero)
    assert asked == [False] * 60
    supervised = run(Trainer(config, Analysis(photos=photos, depth=targets)), 30)
    assert tensor_bits(supervised) != tensor_bits(without)
    assert asked[60:] == [True] * 30


def test_weights_scale_the_gradients_and_terms_add_up(
    masked: Any, known_splats: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: gradients of the first picture linear in the weights, as the loss is."""
    given = []
    plain = TrainingRasterizer.gradients

    def watched(self: TrainingRasterizer, *args: Any, **options: Any) -> Any:
        given.append([None if v is None else v.clone() for v in args[2:4]])
        return plain(self, *args, **options)

    monkeypatch.setattr(TrainingRasterizer, "gradients", watched)
    targets = DepthTargets(exact_depth_maps(masked, known_splats), train=masked.train, views=8)
    for depth, alpha in ((1.0, 0.0), (0.25, 0.0), (0.0, 0.5), (0.25, 0.5)):
        config = replace(CONFIG, depth_weight=depth, depth_weight_final=depth, depth_warmup=0.0)
        run(Trainer(replace(config, alpha_weight=alpha), Analysis(photos=masked, depth=targets)), 1)
    (full_alpha, full), (quarter_alpha, quarter), (mask_alpha, nothing), (both_alpha, both) = given
    assert nothing is None and full.abs().max() > 0 and mask_alpha.abs().max() > 0
    torch.testing.assert_close(quarter, 0.25 * full)
    torch.testing.assert_close(quarter_alpha, 0.25 * full_alpha)
    torch.testing.assert_close(both, quarter)
    torch.testing.assert_close(both_alpha, quarter_alpha + mask_alpha)


def test_depth_makes_depth_better(make_photos: Callable[..., Any], known_splats: Any) -> None:
    """Oracle: the true inverse depth; four views, and points unrelated to the shape."""
    photos = make_photos(held_out=(1, 3, 5, 7))
    rng = np.random.default_rng(0)
    colors = photos.scene.points.colors
    points = PointCloud(points=rng.uniform(-1.5, 1.5, (len(colors), 3)), colors=colors)
    truth = exact_depth_maps(photos, known_splats)
    config = TrainConfig(iterations=400, max_splats=400, sh_degree=0, depth_weight_final=0.1)
    errors = []
    for depth in (None, DepthTargets(truth, train=photos.train, views=8)):
        trainer = run(
            Trainer(config, Analysis(photos=photos, points=points, depth=depth)), config.iterations
        )
        found = []
        for i in photos.train:
            sure = truth[i].confidence > 0
            difference = (
                trainer.renderer.inverse_depth(i)[0][sure] / truth[i].inverse_depth[sure] - 1
            )
            found.append(float(np.median(np.abs(difference))))
        errors.append(np.mean(found))
    assert errors[1] < 0.75 * errors[0], errors


@pytest.mark.parametrize("strategy", list(Strategy))
def test_resume_with_everything_on_is_bit_equal(
    masked: Any, targets: DepthTargets, tmp_path: Path, strategy: Strategy
) -> None:
    """Oracle: all tensors and other state after the last step, from checkpoints on disk."""
    config = replace(EVERYTHING, strategy=strategy)
    whole = Trainer(config, Analysis(photos=masked, depth=targets))
    stops = (1, 9, 20, 37)
    for step in range(1, 61):
        whole.step()
        if step in stops:
            checkpoint.save(tmp_path / f"{step}.safetensors", whole, {})
    for stop in stops:
        found = checkpoint.load(tmp_path / f"{stop}.safetensors")
        checkpoint.check_compatible(found, config, masked)
        resumed = Trainer(config, Analysis(photos=masked, depth=targets))
        checkpoint.check_same_inputs(found, resumed)
        resumed.restore(found.trainer, found.tensors)
        run(resumed, 60 - stop)
        assert tensor_bits(resumed) == tensor_bits(whole), f"resumed at step {stop}"
        assert resumed.state() == whole.state()


def test_other_depths_cannot_go_on(
    photos: Any, known_splats: Any, targets: DepthTargets, tmp_path: Path
) -> None:
    """Oracle: the message, for the same maps with the same loss, other maps and missing maps."""
    path = tmp_path / "c.safetensors"
    checkpoint.save(path, run(Trainer(CONFIG, Analysis(photos=photos, depth=targets)), 2), {})
    found = checkpoint.load(path)
    checkpoint.check_compatible(found, CONFIG, photos)
    other = DepthTargets(exact_depth_maps(photos, known_splats), train=photos.train, views=8)
    with pytest.raises(ConfigError, match="other depth maps"):
        checkpoint.check_same_inputs(found, Trainer(CONFIG, Analysis(photos=photos, depth=other)))
    with pytest.raises(ConfigError, match="with depth maps"):
        checkpoint.check_same_inputs(found, Trainer(CONFIG, Analysis(photos=photos)))
    checkpoint.save(path, run(Trainer(CONFIG, Analysis(photos=photos)), 2), {})
    with pytest.raises(ConfigError, match="without depth maps"):
        checkpoint.check_same_inputs(
            checkpoint.load(path), Trainer(CONFIG, Analysis(photos=photos, depth=targets))
        )


def test_same_bits_for_any_number_of_threads(masked: Any, targets: DepthTargets) -> None:
    """Oracle: bit equality of all state after 40 steps with every term on."""
    seen = []
    for threads in (1, 3):
        config = replace(EVERYTHING, threads=threads)
        seen.append(tensor_bits(run(Trainer(config, Analysis(photos=masked, depth=targets)), 40)))
    assert seen[0] == seen[1]
