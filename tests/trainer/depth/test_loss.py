"""The depth loss; oracles: its formula in numpy, finite differences, and the float64 reference."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from gscore.config import TrainConfig
from gscore.errors import GsError
from gscore.raster.autograd import rasterize
from gscore.raster.reference import rasterize_reference
from gscore.trainer.depth.loss import DepthLoss, l1_loss, pearson_loss, weight_at, with_weights
from gscore.trainer.depth.targets import DepthTarget, DepthTargets

SIZE = (18, 14)
UNIT = 0.4


def scene(seed: int = 3, count: int = 9) -> dict[str, torch.Tensor]:
    """Raw splats at depths 1.5 to 4 of a camera at the origin; float64 values exact in float32."""
    rng = torch.Generator().manual_seed(seed)

    def rand(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=rng)

    z = 1.5 + 2.5 * rand(count, 1)
    means = torch.cat([(rand(count, 2) - 0.5) * 0.8 * z, z], 1)
    values = {
        "means": means,
        "quats": rand(count, 4) - 0.5,
        "scales": rand(count, 3) - 2.0,
        "opacities": rand(count) * 3 - 1,
        "sh0": rand(count, 1, 3),
        "shN": torch.zeros(count, 0, 3),
    }
    return {name: value.float().double() for name, value in values.items()}


def camera() -> dict[str, torch.Tensor]:
    K = torch.tensor([[16.0, 0, 9], [0, 16.0, 7], [0, 0, 1]])
    return {"viewmat": torch.eye(4), "K": K}


def drawn(values: dict[str, torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor]:
    """Inverse depth and opacity, as rendered by the reference."""
    view = {name: t.double() for name, t in camera().items()}
    out = rasterize_reference(
        **values, **view, width=SIZE[0], height=SIZE[1], raw=True, inverse_depth=True
    )
    assert out.inverse_depth is not None
    return out.inverse_depth, out.alpha


def target_for(picture: torch.Tensor, *, aligned: bool) -> DepthTarget:
    """A prior that differs from the picture by 0.1 to 0.5 everywhere, away from any kink."""
    rng = torch.Generator().manual_seed(8)
    sign = torch.where(torch.rand(picture.shape, generator=rng) < 0.5, -1.0, 1.0)
    offset = sign * (0.1 + 0.4 * torch.rand(picture.shape, generator=rng))
    prior = (picture.detach() / UNIT + offset).half()
    confidence = (torch.rand(picture.shape, generator=rng) * 255).to(torch.uint8)
    confidence[:3] = 0
    return DepthTarget(prior, confidence, aligned)


def test_l1_is_its_formula() -> None:
    """Oracle: mean of c (|D / unit - P| + (1 - A) P / 2) / max(P, 1) in numpy, float64."""
    rng = np.random.default_rng(0)
    image, prior = rng.uniform(0, 3, (7, 5)), rng.uniform(0, 3, (7, 5)).astype(np.float16)
    alpha = rng.uniform(0, 1, (7, 5))
    confidence = rng.integers(0, 256, (7, 5)).astype(np.uint8)
    target = DepthTarget(torch.from_numpy(prior), torch.from_numpy(confidence), True)
    found = l1_loss(torch.from_numpy(image), torch.from_numpy(alpha), target, unit=UNIT)
    p = prior.astype(np.float64)
    off = np.abs(image / UNIT - p) + (1 - alpha) * p / 2
    expected = confidence / 255 * off / np.maximum(p, 1)
    assert float(found) == pytest.approx(expected.mean(), rel=1e-12)


@pytest.mark.parametrize("opacity", [0.2, 0.4, 0.7])
def test_haze_is_no_surface(opacity: float) -> None:
    """Oracle: by hand. Haze of opacity a at a times the depth has the inverse depth of the surface;
    it costs half of its missing opacity, and a surface at the right depth costs zero."""
    prior = torch.full((3, 3), 0.8).half()
    sure = torch.full((3, 3), 255).to(torch.uint8)
    target = DepthTarget(prior, sure, True)
    right = prior.double() * UNIT
    haze = l1_loss(right, torch.full((3, 3), opacity).double(), target, unit=UNIT)
    surface = l1_loss(right, torch.ones(3, 3).double(), target, unit=UNIT)
    assert float(haze) == pytest.approx(0.8 * (1 - opacity) / 2, rel=1e-3)
    assert float(surface) == pytest.approx(0, abs=1e-12)


def test_near_surfaces_count_relatively() -> None:
    """Oracle: by hand. An error of 10 % at four times the median costs as much as at the median."""
    costs = []
    for inverse in (1.0, 4.0):
        target = DepthTarget(
            torch.full((2, 2), inverse).half(), torch.full((2, 2), 255).to(torch.uint8), True
        )
        near = torch.full((2, 2), 1.1 * inverse * UNIT)
        costs.append(float(l1_loss(near, torch.ones(2, 2), target, unit=UNIT)))
    assert costs == pytest.approx([0.1, 0.1], rel=1e-3)


def test_pearson_is_one_minus_the_weighted_correlation() -> None:
    """Oracle: numpy's weighted covariance."""
    rng = np.random.default_rng(1)
    image = rng.uniform(0, 3, (9, 8))
    prior = (0.5 * image + rng.uniform(0, 1, (9, 8))).astype(np.float16)
    weight = rng.integers(0, 256, (9, 8)).astype(np.uint8)
    target = DepthTarget(torch.from_numpy(prior), torch.from_numpy(weight), False)
    found = float(pearson_loss(torch.from_numpy(image), target))
    both = np.cov(np.stack([image.ravel(), prior.ravel()]), aweights=weight.ravel(), ddof=0)
    correlation = both[0, 1] / math.sqrt((both[0, 0] + 1e-4) * (both[1, 1] + 1e-4))
    assert found == pytest.approx(1 - correlation, rel=1e-9)


def test_pearson_knows_no_scale_and_no_offset() -> None:
    """Oracle: a perfect match for any a > 0 and b in prior = a picture + b, the worst for a < 0."""
    image = torch.from_numpy(np.random.default_rng(2).uniform(0.5, 1.5, (30, 30)))
    sure = torch.full((30, 30), 255, dtype=torch.uint8)
    for a, b, expected in ((0.6, 0.1, 0.0), (1.0, -0.4, 0.0), (-0.6, 1.0, 2.0)):
        target = DepthTarget((a * image + b).half(), sure, False)
        assert float(pearson_loss(image, target)) == pytest.approx(expected, abs=5e-3)


@pytest.mark.parametrize("aligned", [True, False])
def test_gradients_through_the_reference_are_finite_differences(aligned: bool) -> None:
    """Oracle: central differences in float64 of the loss of the reference's picture."""
    values = scene()
    target = target_for(drawn(values)[0], aligned=aligned)

    def loss_of(splats: dict[str, torch.Tensor]) -> torch.Tensor:
        picture, alpha = drawn(splats)
        if aligned:
            return l1_loss(picture, alpha, target, unit=UNIT)
        return pearson_loss(picture / UNIT, target)

    leaves = {name: value.clone().requires_grad_() for name, value in values.items()}
    loss_of(leaves).backward()
    step = 1e-6
    for name in ("means", "quats", "scales", "opacities"):
        gradient = leaves[name].grad
        assert gradient is not None and gradient.abs().max() > 1e-4, name
        for i in range(values[name].numel()):
            moved = []
            for sign in (1, -1):
                changed = values[name].clone()
                changed.view(-1)[i] += sign * step
                moved.append(float(loss_of({**values, name: changed})))
            numerical = (moved[0] - moved[1]) / (2 * step)
            assert float(gradient.view(-1)[i]) == pytest.approx(numerical, rel=1e-4, abs=1e-7)


@pytest.mark.parametrize("aligned", [True, False])
def test_native_gradients_are_the_references(aligned: bool) -> None:
    """Oracle: the float64 reference through the same loss, to the five digits of float32."""
    values = scene()
    target = target_for(drawn(values)[0], aligned=aligned)
    gradients = []
    for native in (True, False):
        dtype = torch.float32 if native else torch.float64
        leaves = {name: v.to(dtype).clone().requires_grad_() for name, v in values.items()}
        if native:
            view = camera()
            out = rasterize(
                **leaves, **view, width=SIZE[0], height=SIZE[1], raw=True, inverse_depth=True
            )
            picture, alpha = out.inverse_depth, out.alpha
        else:
            picture, alpha = drawn(leaves)
        assert picture is not None
        if aligned:
            loss = l1_loss(picture, alpha, target, unit=UNIT)
        else:
            loss = pearson_loss(picture / UNIT, target)
        loss.backward()
        gradients.append({name: leaf.grad for name, leaf in leaves.items()})
    for name in ("means", "quats", "scales", "opacities"):
        found, expected = gradients[0][name], gradients[1][name]
        assert found is not None and expected is not None
        scale = float(expected.abs().max())
        assert scale > 1e-4
        assert float((found.double() - expected).abs().max()) < 1e-4 * scale, name


def test_weights_fall_log_linearly_after_a_warmup() -> None:
    """Oracle: the first and last weight, their geometric mean halfway, and half in a warm-up."""
    config = TrainConfig(
        iterations=1000, depth_weight=1.0, depth_weight_final=0.01, depth_warmup=0.1
    )
    assert weight_at(config, 500) == pytest.approx(0.1)
    assert weight_at(config, 1000) == pytest.approx(0.01)
    assert weight_at(config, 50) == pytest.approx(0.5 * 0.01**0.05)
    plain = replace(config, depth_warmup=0.0)
    assert weight_at(plain, 0) == pytest.approx(1.0)
    to_nothing = replace(plain, depth_weight_final=0.0)
    assert weight_at(to_nothing, 1000) == 0
    assert weight_at(to_nothing, 500) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("given", "views", "expected"),
    [
        ((-1, -1), 0, (1, 1)),
        ((-1, -1), 6, (1, 1)),
        ((-1, -1), 48, (0.125, 0.125)),
        ((0.6, -1), 48, (0.6, 0.6)),
        ((-1, 0.01), 12, (0.5, 0.01)),
        ((0, 0), 6, (0, 0)),
    ],
)
def test_weights_fall_with_the_number_of_views(
    given: tuple[float, float], views: float, expected: tuple[float, float]
) -> None:
    """Oracle: 6 / views, at most 1, where the options set no weight."""
    first, last = given
    found = with_weights(TrainConfig(depth_weight=first, depth_weight_final=last), views)
    assert (found.depth_weight, found.depth_weight_final) == pytest.approx(expected)


class Prior:
    def __init__(self, value: float, *, aligned: bool) -> None:
        self.inverse_depth = np.full((4, 6), value, np.float32)
        self.inverse_depth[0] *= 1.5
        self.confidence = np.ones((4, 6), np.float32)
        self.aligned = aligned


def test_views_without_a_usable_prior_need_no_inverse_depth() -> None:
    """Oracle: a weight of zero, which the trainer checks first."""
    targets = DepthTargets(
        [Prior(0.5, aligned=True), None, Prior(9.0, aligned=False)], train=[0, 1, 2], views=6
    )
    config = TrainConfig(iterations=10, depth_warmup=0.0, depth_pearson=0.5)
    loss = DepthLoss(config, targets, scale=0.25)
    assert loss.weight(1, 5) == 0
    assert loss.weight(2, 5) == pytest.approx(0.5 * loss.weight(0, 5))
    unaligned_off = DepthLoss(replace(config, depth_pearson=0.0), targets, scale=0.25)
    assert unaligned_off.weight(2, 5) == 0
    assert unaligned_off.weight(0, 5) > 0


def test_lengths_of_the_training_world_are_undone() -> None:
    """Oracle: inverse depths four times as large where lengths shrink to a quarter."""
    prior = Prior(0.5, aligned=True)
    targets = DepthTargets([prior], train=[0], views=6)
    loss = DepthLoss(TrainConfig(), targets, scale=0.25)
    right = torch.from_numpy(prior.inverse_depth / 0.25)
    opaque = torch.ones(right.shape)
    assert float(loss(0, right, opaque)) < 1e-3
    assert float(loss(0, right * 0.25, opaque)) > 0.1


def test_gradients_that_there_are_not_are_refused() -> None:
    """Oracle: the errors for a second derivative next to another term's, and for a second pass."""
    rng = np.random.default_rng(1)
    prior = torch.from_numpy(rng.random((4, 5)).astype(np.float16))
    target = DepthTarget(prior, torch.full((4, 5), 255, dtype=torch.uint8), True)
    picture = torch.rand(4, 5, requires_grad=True)
    loss = l1_loss(picture, torch.rand(4, 5), target, unit=UNIT)
    total = loss + picture.square().sum()
    (first,) = torch.autograd.grad(total, picture, create_graph=True)
    with pytest.raises(GsError, match="first derivatives only"):
        first.sum().backward()
    with pytest.raises(GsError, match="only once"):
        torch.autograd.grad(loss, picture)
