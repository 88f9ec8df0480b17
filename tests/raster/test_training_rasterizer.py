"""Rendering without autograd; oracle: bits of the differentiable functions."""

from collections.abc import Callable
from typing import Any

import pytest
import torch

from gscore.errors import GsError, ShapeError
from gscore.raster.autograd import RasterAux, rasterize
from gscore.raster.header import OUT_INVERSE_DEPTH
from gscore.raster.loss import image_loss, image_loss_gradient
from gscore.raster.request import Frustum, Settings
from gscore.raster.training_rasterizer import TrainingRasterizer
from gscore.splats import PARAMETERS

Make = Callable[..., Any]


@pytest.mark.parametrize("frozen", [False, True])
@pytest.mark.parametrize(("antialias", "inverse"), [(False, False), (True, True)])
def test_bits_are_those_of_autograd(
    random_scene: Make, antialias: bool, inverse: bool, frozen: bool
) -> None:
    """Oracle: picture, radii and all gradients; views of several sizes share one rasterizer. An
    empty set of frozen splats changes nothing."""
    none = {
        name: t[:0].detach()
        for name, t in random_scene(1).inputs(torch.float32).items()
        if name in PARAMETERS
    }
    rasterizer = TrainingRasterizer(none if frozen else None)
    for seed in (1, 2, 3):
        inputs = random_scene(seed).inputs(torch.float32)
        leaves = [inputs[name] for name in PARAMETERS]
        camera = (inputs["viewmat"].detach(), inputs["K"], inputs["width"] + seed, 30)
        options: dict[str, Any] = {"background": (0.1, 0.2, 0.3), "antialias": antialias}
        aux = RasterAux()
        out = rasterize(*leaves, *camera, raw=True, inverse_depth=inverse, aux=aux, **options)
        target = torch.randint(0, 256, out.rgb.shape, dtype=torch.uint8)
        loss = image_loss(out.rgb, target, threads=1)
        depth = out.inverse_depth
        weights = torch.rand(out.alpha.shape)
        extra = (out.alpha * weights).sum() if depth is None else (depth * weights).sum()
        (loss.loss + extra).backward()

        outputs = OUT_INVERSE_DEPTH if inverse else 0
        picture = rasterizer.draw(
            [p.detach() for p in leaves], Frustum(*camera), Settings(outputs=outputs, **options)
        )
        assert torch.equal(picture.rgb, out.rgb)
        assert torch.equal(picture.alpha, out.alpha)
        assert aux.radii is not None and torch.equal(rasterizer.radii, aux.radii)
        v_rgb = torch.empty_like(picture.rgb)
        found = image_loss_gradient(picture.rgb, target, v_rgb)
        assert found.loss == pytest.approx(loss.loss.item(), rel=1e-6)
        into = {name: torch.full_like(p, 7.0) for name, p in zip(PARAMETERS, leaves, strict=True)}
        into["shN"].zero_()
        means2d = rasterizer.gradients(
            into, v_rgb, None if inverse else weights, weights if inverse else None
        )
        assert aux.v_means2d is not None and torch.equal(means2d, aux.v_means2d)
        assert any(leaf.grad.abs().max() > 0 for leaf in leaves)
        for name, leaf in zip(PARAMETERS, leaves, strict=True):
            assert torch.equal(into[name], leaf.grad), name


def test_gradients_of_higher_coefficients_are_added(random_scene: Make) -> None:
    """Oracle: twice the gradient after two calls, zero in bands above the evaluated degree."""
    inputs = random_scene(4).inputs(torch.float32)
    splats = [inputs[name].detach() for name in PARAMETERS]
    rasterizer = TrainingRasterizer()
    view = Frustum(inputs["viewmat"].detach(), inputs["K"], 40, 30)
    picture = rasterizer.draw(splats, view, Settings(sh_degree=2))
    v_rgb = torch.rand(picture.rgb.shape)
    once = {name: torch.zeros_like(p) for name, p in zip(PARAMETERS, splats, strict=True)}
    twice = {name: torch.zeros_like(p) for name, p in once.items()}
    rasterizer.gradients(once, v_rgb)
    for _ in range(2):
        rasterizer.gradients(twice, v_rgb)
    assert once["shN"][:, :8].any() and not once["shN"][:, 8:].any()
    torch.testing.assert_close(twice["shN"], 2 * once["shN"], rtol=1e-6, atol=0)
    assert torch.equal(twice["sh0"], once["sh0"])


def test_errors_name_what_is_wrong(random_scene: Make) -> None:
    """Oracle: the messages."""
    inputs = random_scene(4).inputs(torch.float32)
    splats = [inputs[name].detach() for name in PARAMETERS]
    rasterizer = TrainingRasterizer()
    view = Frustum(inputs["viewmat"].detach(), inputs["K"], 40, 30)
    grads = {name: torch.zeros_like(p) for name, p in zip(PARAMETERS, splats, strict=True)}
    with pytest.raises(GsError, match="call draw first"):
        rasterizer.gradients(grads, torch.zeros(30, 40, 3))
    with pytest.raises(ShapeError, match=r"tiles must be \[2, 3\] uint8"):
        rasterizer.draw(splats, view, Settings(tiles=torch.ones(3, 2, dtype=torch.uint8)))
    picture = rasterizer.draw(splats, view)
    target = torch.zeros(30, 40, 3, dtype=torch.uint8)
    with pytest.raises(ShapeError, match=r"v_image must be \[30, 40, 3\] float32"):
        image_loss_gradient(picture.rgb, target, torch.zeros(30, 40))
