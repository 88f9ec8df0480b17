"""The optimizer; oracle: the formulas of Kingma and Ba 2015 in float64."""

from collections.abc import Callable

import numpy as np
import torch

from gscore.trainer.model import Model
from gscore.trainer.params import NAMES


def test_steps_are_those_of_adam(marked_model: Callable[..., Model]) -> None:
    """Oracle: the update rule written out, with bias correction, beta 0.9 and 0.999, eps 1e-15."""
    model = Model({name: p.detach() for name, p in marked_model(50).params.items()})
    rng = np.random.default_rng(0)
    rates = {name: 1e-3 * (i + 1) for i, name in enumerate(NAMES)}
    expected = {name: p.detach().double().numpy().copy() for name, p in model.params.items()}
    m = {name: np.zeros_like(x) for name, x in expected.items()}
    v = {name: np.zeros_like(x) for name, x in expected.items()}
    for step in range(1, 6):
        model.set_rates(rates)
        for name, p in model.params.items():
            g = rng.normal(size=p.shape)
            p.grad = torch.from_numpy(g).float()
            m[name] = 0.9 * m[name] + 0.1 * g
            v[name] = 0.999 * v[name] + 0.001 * g * g
            hat_m, hat_v = m[name] / (1 - 0.9**step), v[name] / (1 - 0.999**step)
            expected[name] -= rates[name] * hat_m / (np.sqrt(hat_v) + 1e-15)
        model.step()
    for name, p in model.params.items():
        np.testing.assert_allclose(
            p.detach().numpy(), expected[name], rtol=2e-6, atol=2e-6, err_msg=name
        )
        assert model.steps(name) == 5


def test_missing_sh_coefficients_take_no_step(marked_model: Callable[..., Model]) -> None:
    """Oracle: at degree 0 there is nothing to update, and the others move."""
    model = marked_model(4, sh_rest=0)
    before = model.params["sh0"].detach().clone()
    for p in model.params.values():
        p.grad = torch.ones_like(p)
    model.set_rates(dict.fromkeys(NAMES, 0.1))
    model.step()
    assert model.sh_degree == 0
    assert model.steps("shN") == 7
    assert model.steps("sh0") == 8
    assert (model.params["sh0"].detach() != before).all()
