"""Splats that diverge; oracle: the run without them, bit for bit, and closed bounds."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from gscore.config import TrainConfig
from gscore.engine.cpu import sanitize
from gscore.engine.cpu.model import CpuModel
from gscore.errors import GsError
from gscore.raster.autograd import RasterAux, rasterize
from gscore.raster.loss import image_loss
from gscore.splats import PARAMETERS
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.trainer import Trainer

CONFIG = TrainConfig(iterations=200, max_splats=300, sh_degree=1, refine_start=150)
POISON = (math.nan, math.inf, -math.inf)
ROWS = 1000


def gradients(params: dict[str, torch.Tensor], target: torch.Tensor) -> dict[str, torch.Tensor]:
    """Gradients of the image loss in the parameters."""
    leaves = {name: p.detach().clone().requires_grad_() for name, p in params.items()}
    aux = RasterAux()
    K = torch.tensor([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
    means, quats, scales, opacities, sh0, shN = (leaves[name] for name in PARAMETERS)
    out = rasterize(
        means, quats, scales, opacities, sh0, shN, torch.eye(4), K, 64, 48, raw=True, aux=aux
    )
    assert float(out.alpha.detach().mean()) > 0.1
    image_loss(out.rgb, target).loss.backward()
    found = {name: leaf.grad for name, leaf in leaves.items()}
    assert aux.v_means2d is not None
    return {name: g for name, g in found.items() if g is not None} | {"means2d": aux.v_means2d}


@pytest.fixture
def thousand() -> dict[str, torch.Tensor]:
    """A thousand splats in front of a camera at the origin, SH degree 1."""
    rng = np.random.default_rng(4)
    z = rng.uniform(1.5, 6, ROWS)
    arrays = {
        "means": np.stack([*(rng.uniform(-0.5, 0.5, (2, ROWS)) * z), z], axis=1),
        "quats": rng.normal(size=(ROWS, 4)),
        "scales": rng.normal(size=(ROWS, 3)) * 0.5 - 3,
        "opacities": rng.normal(size=ROWS),
        "sh0": rng.normal(size=(ROWS, 1, 3)),
        "shN": rng.normal(size=(ROWS, 3, 3)) * 0.1,
    }
    return {name: torch.from_numpy(a.astype(np.float32)) for name, a in arrays.items()}


@pytest.mark.parametrize("value", POISON)
def test_a_poisoned_row_of_a_thousand_leaves_all_others_alone(
    thousand: dict[str, torch.Tensor], value: float
) -> None:
    """Oracle: gradients of the other 999 rows without that row; its own are zero."""
    row = 437
    target = torch.full((48, 64, 3), 90, dtype=torch.uint8)
    others = torch.arange(ROWS) != row
    clean = gradients({name: p[others] for name, p in thousand.items()}, target)
    assert all(float(g.abs().sum()) > 0 for g in clean.values())
    for name, p in thousand.items():
        for field in range(p[0].numel()):
            poisoned = {key: q.clone() for key, q in thousand.items()}
            poisoned[name].reshape(ROWS, -1)[row, field] = value
            found = gradients(poisoned, target)
            for key, g in found.items():
                assert torch.equal(g[others], clean[key]), (name, field, key)
                assert not g[row].any(), (name, field, key)


@pytest.mark.parametrize("name", PARAMETERS)
@pytest.mark.parametrize("value", [*POISON, 1e30, -1e30])
def test_runaway_splats_are_neutralised(
    marked_model: Callable[..., CpuModel], name: str, value: float
) -> None:
    """Oracle: row 3, neutral and without moments; the others unchanged. A tiny scale is allowed."""
    model = marked_model(10)
    before = {key: p.detach().clone() for key, p in model.params.items()}
    model.params[name].data.reshape(10, -1)[3, 0] = value
    lost = sanitize.clamp_runaways(model, extent=1.0)
    if name == "scales" and value == -1e30:
        assert lost == 0
        return
    assert lost == 1
    others = torch.arange(10) != 3
    for key, p in model.params.items():
        assert torch.equal(p.detach()[others], before[key][others]), key
        assert torch.isfinite(p.detach()).all()
        for moment in model.moments(key):
            assert not moment[3].any()
            assert moment[others].all()
    assert float(model.params["opacities"].detach()[3]) == -sanitize.MAX_LOGIT
    assert sanitize.clamp_runaways(model, extent=1.0) == 0


def test_saturated_opacities_and_thin_axes_are_held(marked_model: Callable[..., CpuModel]) -> None:
    """Oracle: the bounds, within which the slope of the sigmoid times a pixel's share is not
    zero."""
    model = marked_model(4)
    model.params["opacities"].data[:] = torch.tensor([30.0, -30.0, 3.0, -3.0])
    model.params["scales"].data[1] = torch.tensor([0.0, -30.0, -1.0])
    assert sanitize.clamp_runaways(model, extent=1.0) == 0
    assert model.params["opacities"].tolist() == [20.0, -20.0, 3.0, -3.0]
    assert model.params["scales"][1].tolist() == pytest.approx([0.0, -math.log(1e5), -1.0])


def test_sizes_are_bounded_by_the_distance(marked_model: Callable[..., CpuModel]) -> None:
    """Oracle: 5 x (extent + distance): a large sky passes, splats that fill every picture do
    not."""
    model = marked_model(4)
    model.params["means"].data[:] = torch.tensor([[0.0, 0, 1], [0, 0, 40], [0, 0, 40], [0, 1, 0]])
    largest = torch.tensor([10.0, 200.0, 206.0, 10.1])
    model.params["scales"].data[:, 1] = largest.log() - 1e-3
    assert sanitize.clamp_runaways(model, extent=1.0) == 0
    found = model.params["scales"][:, 1].exp().tolist()
    assert found == pytest.approx([9.99, 199.8, 205.0, 10.0], rel=1e-4)


def test_screen_filling_splats_do_not_outlive_a_short_run(photos: Any) -> None:
    """Oracle: the allowed size, in a run too short for opacity resets."""
    trainer = Trainer(CONFIG, Analysis(photos=photos))
    assert not trainer.plan.reset_every
    trainer.model.params["scales"].data[:10] = math.log(50.0 * trainer.frame.extent)
    for _ in range(CONFIG.iterations):
        trainer.step()
    seen = trainer.model.params["opacities"] > -19
    sizes = trainer.model.params["scales"][seen].amax(dim=1).exp()
    assert seen.sum() > 50
    assert float(sizes.max()) < 10 * trainer.frame.extent


@pytest.mark.parametrize("value", [1e5, 1e8])
def test_an_exploded_colour_costs_one_step_not_the_run(photos: Any, value: float) -> None:
    """Oracle: no update by the first view that shows it, updates by all others; the row is
    counted."""
    trainer = Trainer(CONFIG, Analysis(photos=photos))
    for _ in range(3):
        trainer.step()
    trainer.model.params["sh0"].data[7] = value
    trainer.model.params["opacities"].data[7] = 4.0
    results = [trainer.step() for _ in range(16)]
    assert [r.skipped for r in results] == [True] + [False] * 15
    assert trainer.counts.lost_rows == results[0].lost_rows == 1
    assert float(trainer.model.params["opacities"].detach()[7]) < -19


def test_healthy_training_is_not_touched(photos: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the bits of the same run without bounds."""

    def trained() -> dict[str, torch.Tensor]:
        trainer = Trainer(CONFIG, Analysis(photos=photos))
        for _ in range(120):
            trainer.step()
        assert trainer.counts.lost_rows == 0
        return {key: t.clone() for key, t in trainer.tensors().items()}

    held = trained()
    monkeypatch.setattr(sanitize, "clamp_runaways", lambda model, extent: 0)
    free = trained()
    assert all(torch.equal(held[key], free[key]) for key in held)


def test_all_rows_may_be_lost_without_a_crash(photos: Any) -> None:
    """Oracle: an empty picture and finite numbers."""
    trainer = Trainer(replace(CONFIG, refine_start=2, refine_every=2), Analysis(photos=photos))
    trainer.model.params["sh0"].data[:] = 1e30
    try:
        for _ in range(8):
            trainer.step()
    except GsError as error:
        pytest.fail(str(error))
    assert all(torch.isfinite(p.detach()).all() for p in trainer.model.params.values())


def test_moments_that_overflowed_are_cleared(marked_model: Callable[..., CpuModel]) -> None:
    """Oracle: row 2 alone; Adam would never move it again with an infinite second moment."""
    model = marked_model(5)
    first, second = model.moments("means")
    second[2, 1] = math.inf
    assert sanitize.clamp_runaways(model, extent=1.0) == 0
    first, second = model.moments("means")
    assert not first[2].any()
    assert not second[2].any()
    others = torch.arange(5) != 2
    assert first[others].all()
    assert second[others].all()
