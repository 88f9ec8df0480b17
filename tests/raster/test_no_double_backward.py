"""Second derivatives, which are not implemented: an error wherever a graph would lack them."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from gscore.errors import GsError
from gscore.raster.autograd import rasterize
from gscore.raster.loss import image_loss

Make = Callable[..., Any]


@pytest.fixture
def inputs(random_scene: Make) -> dict[str, Any]:
    """A scene as leaves and a camera."""
    return random_scene(3).inputs(torch.float32) | {"raw": True, "inverse_depth": True}


def _rendered(inputs: dict[str, Any]) -> tuple[Tensor, Tensor]:
    """A picture's sum, whose gradient in the picture is a constant, and the means."""
    return rasterize(**inputs).rgb.sum(), inputs["means"]


def _rendered_squares(inputs: dict[str, Any]) -> tuple[Tensor, Tensor]:
    """The same with a gradient that depends on the picture."""
    return rasterize(**inputs).rgb.square().sum(), inputs["means"]


def _depths(inputs: dict[str, Any]) -> tuple[Tensor, Tensor]:
    out = rasterize(**inputs).inverse_depth
    assert out is not None
    return out.sum(), inputs["viewmat"]


def _loss(inputs: dict[str, Any]) -> tuple[Tensor, Tensor]:
    image = torch.rand(20, 30, 3, requires_grad=True)
    return image_loss(image, torch.full((20, 30, 3), 99, dtype=torch.uint8)).loss, image


CASES = (_rendered, _rendered_squares, _depths, _loss)


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.__name__.strip("_"))
def test_a_second_derivative_is_refused(case: Make, inputs: dict[str, Any]) -> None:
    """Oracle: the error, where torch alone would sum the terms it has: here the second derivative
    of another term."""
    value, x = case(inputs)
    (first,) = torch.autograd.grad(value + x.square().sum(), x, create_graph=True)
    with pytest.raises(GsError, match=r"first derivatives only.*create_graph"):
        first.sum().backward()


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.__name__.strip("_"))
def test_first_derivatives_are_the_same_with_a_graph(case: Make, inputs: dict[str, Any]) -> None:
    """Oracle: bits of the gradient without create_graph; further ones once it is detached."""
    value, x = case(inputs)
    (plain,) = torch.autograd.grad(value, x, retain_graph=True)
    (graphed,) = torch.autograd.grad(value, x, create_graph=True)
    assert plain.abs().max() > 0 and torch.equal(graphed, plain)
    (further,) = torch.autograd.grad((graphed.detach() * x).sum(), x)
    assert torch.equal(further, plain)
