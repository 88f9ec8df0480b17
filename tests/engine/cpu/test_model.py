"""The optimizer; oracle: the formulas of Kingma and Ba 2015 in float64."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch

from gscore.engine.base import RowEdit, ShUpdate
from gscore.engine.cpu.model import CpuModel
from gscore.splats import PARAMETERS
from gscore.trainer.strategy import relocation


def test_steps_are_those_of_adam(marked_model: Callable[..., CpuModel]) -> None:
    """Oracle: the update rule written out, with bias correction, beta 0.9 and 0.999, eps 1e-15."""
    model = CpuModel(marked_model(50).params)
    rng = np.random.default_rng(0)
    rates = {name: 1e-3 * (i + 1) for i, name in enumerate(PARAMETERS)}
    expected = {name: p.double().numpy().copy() for name, p in model.params.items()}
    m = {name: np.zeros_like(x) for name, x in expected.items()}
    v = {name: np.zeros_like(x) for name, x in expected.items()}
    for step in range(1, 6):
        model.set_rates(rates)
        for name, p in model.params.items():
            g = rng.normal(size=p.shape)
            model.grads[name].copy_(torch.from_numpy(g))
            m[name] = 0.9 * m[name] + 0.1 * g
            v[name] = 0.999 * v[name] + 0.001 * g * g
            hat_m, hat_v = m[name] / (1 - 0.9**step), v[name] / (1 - 0.999**step)
            expected[name] -= rates[name] * hat_m / (np.sqrt(hat_v) + 1e-15)
        model.step()
    for name, p in model.params.items():
        np.testing.assert_allclose(p.numpy(), expected[name], rtol=2e-6, atol=2e-6, err_msg=name)
        assert model.adam_steps[name] == 5


def test_missing_sh_coefficients_take_no_step(marked_model: Callable[..., CpuModel]) -> None:
    """Oracle: no update at degree 0, while the other parameters move."""
    model = marked_model(4, sh_rest=0)
    before = model.params["sh0"].clone()
    for grad in model.grads.values():
        grad.fill_(1)
    model.set_rates(dict.fromkeys(PARAMETERS, 0.1))
    model.step()
    assert model.sh_degree == 0
    assert model.adam_steps["shN"] == 7
    assert model.adam_steps["sh0"] == 8
    assert (model.params["sh0"] != before).all()


class Twin:
    """The same splats under dense Adam in float64, with rows moved in the same way."""

    def __init__(self, model: CpuModel) -> None:
        self.params = {name: p.double().numpy().copy() for name, p in model.params.items()}
        self.m = {name: np.zeros_like(x) for name, x in self.params.items()}
        self.v = {name: np.zeros_like(x) for name, x in self.params.items()}
        self.t = 0

    def step(self, grads: dict[str, np.ndarray], rates: dict[str, float]) -> None:
        self.t += 1
        for name, g in grads.items():
            self.m[name] = 0.9 * self.m[name] + 0.1 * g
            self.v[name] = 0.999 * self.v[name] + 0.001 * g * g
            m, v = self.m[name] / (1 - 0.9**self.t), self.v[name] / (1 - 0.999**self.t)
            self.params[name] -= rates[name] * m / (np.sqrt(v) + 1e-15)

    def edit(self, keep: np.ndarray, parents: np.ndarray) -> None:
        """Keep some rows and append copies of others, without moments."""
        none = {name: np.zeros_like(x[parents]) for name, x in self.params.items()}
        for name, x in self.params.items():
            self.params[name] = np.concatenate([x[keep], x[parents]])
            self.m[name] = np.concatenate([self.m[name][keep], none[name]])
            self.v[name] = np.concatenate([self.v[name][keep], none[name]])

    def distances(self, model: CpuModel) -> dict[str, float]:
        """By parameter: the largest distance between two rows, relative to the row's length."""
        found = {}
        for name, p in model.synced().items():
            expected = self.params[name].reshape(len(model), -1)
            rows = p.double().numpy().reshape(len(model), -1) - expected
            lengths = np.linalg.norm(expected, axis=1)
            found[name] = float((np.linalg.norm(rows, axis=1) / lengths).max())
        return found


@pytest.mark.parametrize("every", [1, 8])
def test_late_rows_end_where_dense_adam_takes_them(every: int) -> None:
    """Oracle: the twin over 1,000 steps with few visible splats, while rows are pruned, copied,
    reordered and relocated, and opacities are reset."""
    rng = np.random.default_rng(every)
    n = 60
    shapes = {"means": (3,), "quats": (4,), "scales": (3,), "opacities": (), "sh0": (1, 3)}
    shapes["shN"] = (15, 3)
    first = {k: rng.normal(size=(n, *s)) + 3.0 for k, s in shapes.items()}
    model = CpuModel({k: torch.from_numpy(x).float() for k, x in first.items()})
    twin = Twin(model)
    generator = torch.Generator().manual_seed(0)
    gathered = np.zeros((n, 15, 3))
    rest_steps = 0
    for step in range(1, 1001):
        n = len(model)
        shown = rng.random(n) < rng.choice([0.02, 0.3, 0.9])
        grads = {}
        for name, p in model.params.items():
            g = rng.normal(size=p.shape) * 10.0 ** rng.uniform(-5, 0)
            g[~shown] = 0
            grads[name] = g.astype(np.float32).astype(np.float64)
            model.grads[name] += torch.from_numpy(g).float() if name == "shN" else 0
            if name != "shN":
                model.grads[name].copy_(torch.from_numpy(g))
        rates = dict.fromkeys(PARAMETERS, 0.002 * 0.998**step)
        model.set_rates(rates)
        radii = torch.from_numpy(shown.astype(np.int32))
        moves = step % every == 0
        assert model.step(radii, shN=ShUpdate.STEP if moves else ShUpdate.ACCUMULATE) == 0
        gathered += grads.pop("shN")
        twin.step(grads, rates)
        if moves:
            rest_steps += 1
            twin_of_rest = twin.t
            twin.t = rest_steps - 1
            twin.step({"shN": gathered}, rates)
            twin.t = twin_of_rest
            gathered[:] = 0
        if step % 90 == 0:  # prune and copy, in another order
            keep = rng.permutation(n)[: n - 5]
            parents = rng.choice(n, 8, replace=False)
            model.edit(RowEdit(keep=keep, parents=parents))
            twin.edit(keep, parents)
            gathered = np.concatenate([gathered[keep], np.zeros((8, 15, 3))])
        if step % 200 == 0:
            lowered = np.minimum(model.column("opacities"), np.float32(relocation.logit(0.9)))
            model.edit(RowEdit(values={"opacities": lowered}, forget=("opacities",)))
            twin.params["opacities"] = np.minimum(twin.params["opacities"], math.log(9))
            twin.m["opacities"][:], twin.v["opacities"][:] = 0, 0
        if step % 333 == 0:  # a relocated splat has its parent's numbers; both have zero moments
            n = len(model)
            dead, within = np.zeros(n, bool), np.ones(n, bool)
            dead[:4] = True
            before = model.synced()["sh0"].clone()
            for edit in relocation.relocate(
                model.column, dead, generator, within=within, min_opacity=0.005
            ):
                assert edit.moved is not None and len(edit.moved) == 4
                model.edit(edit)
            parents = (model.params["sh0"][:4, None] == before[None, 4:]).all(dim=(2, 3))
            chosen = parents.int().argmax(dim=1).numpy() + 4
            for name in PARAMETERS:
                for moments in (twin.m, twin.v):
                    moments[name][:4], moments[name][chosen] = 0, 0
                twin.params[name][:4] = twin.params[name][chosen]
            rows = [*range(4), *chosen]
            for name in ("opacities", "scales"):  # set by the rule that test_relocation checks
                twin.params[name][rows] = model.params[name][rows].double().numpy()
            gathered[:4] = 0
    assert model.rows["shN_pending"].any()
    distances = twin.distances(model)
    assert distances["shN"] < 2e-6
    assert max(distances.values()) < 5e-6  # a thousand float32 roundings of one number


def test_looking_at_a_model_changes_no_bit() -> None:
    """Oracle: the same steps without reading the model; the rows of a sync as the picture."""
    rng = np.random.default_rng(0)
    results = []
    for looks in (True, False):
        rng = np.random.default_rng(0)
        shapes = [(40, 3), (40, 4), (40, 3), (40,), (40, 1, 3), (40, 8, 3)]
        first = {k: rng.normal(size=s) for k, s in zip(PARAMETERS, shapes, strict=True)}
        model = CpuModel({k: torch.from_numpy(x).float() for k, x in first.items()})
        model.set_rates(dict.fromkeys(PARAMETERS, 1e-2))
        for _ in range(30):
            radii = torch.from_numpy((rng.random(40) < 0.3).astype(np.int32))
            for grad in model.grads.values():
                grad.copy_(torch.from_numpy(rng.normal(size=grad.shape)))
                grad[radii == 0] = 0
            model.step(radii)
            if looks:
                parts = [model.synced_rows(slice(at, at + 15))["shN"] for at in (0, 15, 30)]
                shown = model.synced()["shN"].clone()
                assert torch.equal(torch.cat(parts), shown)
                assert torch.equal(model.synced_rows(slice(7, 9))["shN"], shown[7:9])
        results.append({name: p.clone() for name, p in model.params.items()})
        if looks:
            assert not torch.equal(shown, model.params["shN"])
            model.sync()
            assert torch.equal(shown, model.params["shN"])
    assert all(torch.equal(results[0][name], results[1][name]) for name in PARAMETERS)


def test_a_step_of_several_photos_fades_as_so_many(marked_model: Callable[..., CpuModel]) -> None:
    """Oracle: the update rule written out with beta to the power of the photos, steps counted in
    photos; higher SH coefficients have their own count."""
    model = CpuModel(marked_model(50).params)
    rng = np.random.default_rng(0)
    expected, m, v = model.params["means"].double().numpy().copy(), 0.0, 0.0
    taken = 0
    for photos in (4, 4, 1, 3):
        taken += photos
        model.set_rates(dict.fromkeys(PARAMETERS, 1e-3))
        g = rng.normal(size=expected.shape)
        model.grads["means"].copy_(torch.from_numpy(g))
        beta1, beta2 = 0.9**photos, 0.999**photos
        m, v = beta1 * m + (1 - beta1) * g, beta2 * v + (1 - beta2) * g * g
        hat_m, hat_v = m / (1 - 0.9**taken), v / (1 - 0.999**taken)
        expected -= 1e-3 * hat_m / (np.sqrt(hat_v) + 1e-15)
        model.step(photos=photos)
    np.testing.assert_allclose(model.params["means"].numpy(), expected, rtol=2e-6, atol=2e-6)
    assert model.adam_steps["means"] == 12
    assert model.adam_steps["shN"] == 4
