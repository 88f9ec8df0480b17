"""Edits of rows; oracle: numpy indexing of parameters, moments and counters that encode rows."""

import math
from collections.abc import Callable

import numpy as np
import torch

from gscore.engine.base import RowEdit
from gscore.engine.cpu.model import CpuModel, morton_order
from gscore.splats import PARAMETERS

Make = Callable[..., CpuModel]


def rows_of(model: CpuModel, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The parameter and its moments as [N, -1] arrays."""
    tensors = (model.params[name], *model.moments(name))
    first, second, third = (t.reshape(len(model), -1).numpy() for t in tensors)
    return first, second, third


def test_edit_keeps_and_appends_in_every_tensor(marked_model: Make) -> None:
    """Oracle: numpy fancy indexing of the marks."""
    model, before = marked_model(6), marked_model(6)
    model.edit(RowEdit(keep=np.array([4, 0, 5]), parents=np.array([1, 3])))
    assert len(model) == 5
    for name in PARAMETERS:
        got, was = rows_of(model, name), rows_of(before, name)
        np.testing.assert_array_equal(got[0], was[0][[4, 0, 5, 1, 3]], err_msg=name)
        for i in (1, 2):
            np.testing.assert_array_equal(got[i][:3], was[i][[4, 0, 5]], err_msg=name)
            assert not got[i][3:].any(), name
        assert model.adam_steps[name] == 7
    np.testing.assert_array_equal(model.rows["views"].numpy(), [3004, 3000, 3005, 0, 0])


def test_edited_parameters_are_those_that_the_optimizer_steps(marked_model: Make) -> None:
    """Oracle: Adam's step against the gradient, which a lost parameter would not take."""
    model = marked_model(4)
    model.edit(RowEdit(keep=np.array([2, 3])))
    before = {name: p.clone() for name, p in model.params.items()}
    for name in PARAMETERS:
        model.moments(name)[0].zero_()
        model.moments(name)[1].zero_()
        model.grads[name].fill_(1)
    model.set_rates(dict.fromkeys(PARAMETERS, 0.5))
    model.step()
    for name, p in model.params.items():
        assert (p < before[name]).all(), name


def test_edit_to_zero_rows(marked_model: Make) -> None:
    """Oracle: an empty model, which is valid."""
    model = marked_model(3)
    model.edit(RowEdit(keep=np.zeros(0, np.int64)))
    assert len(model) == 0
    model.edit(RowEdit(keep=np.zeros(0, np.int64), morton=True))
    assert len(model) == 0 and model.column("means").shape == (0, 3)


def test_rows_follow_a_morton_curve() -> None:
    """Oracle: bits of the cells interleaved one by one; a stable order of equal places."""
    rng = np.random.default_rng(0)
    cells = rng.integers(0, 1024, (3000, 3))
    cells[:50] = cells[0]
    ends = np.repeat([[0, 0, 0], [1023, 1023, 1023]], 200, axis=0)  # 98 % are within that range
    cells = np.concatenate([cells, ends])
    codes = [
        sum((int(c[axis]) >> bit & 1) << (3 * bit + axis) for bit in range(10) for axis in range(3))
        for c in cells
    ]
    means = torch.from_numpy(cells * 0.25).float()
    means[:3000] += 0.1  # well inside cells of side 0.25
    expected = np.argsort(codes, kind="stable")
    np.testing.assert_array_equal(morton_order(means).numpy(), expected)
    means[7] = math.nan
    assert sorted(morton_order(means).tolist()) == list(range(len(means)))
    assert morton_order(torch.zeros(0, 3)).tolist() == []
    assert morton_order(torch.ones(3, 3)).tolist() == [0, 1, 2]


def test_widen_sh_adds_zeros_behind(marked_model: Make) -> None:
    """Oracle: the old coefficients first, then zeros, in parameter and moments."""
    model, before = marked_model(2), marked_model(2)
    model.widen_sh(2)
    assert model.sh_degree == 2
    for got, was in zip(rows_of(model, "shN"), rows_of(before, "shN"), strict=True):
        np.testing.assert_array_equal(got[:, :9], was)
        assert not got[:, 9:].any()
    model.widen_sh(1)
    assert model.sh_degree == 2


def test_values_replace_all_rows_and_forget_named_moments(marked_model: Make) -> None:
    """Oracle: the values, and zeros in the moments of these parameters only."""
    model = marked_model(3)
    values = np.array([-8.0, 0.0, 5.0], np.float32)
    model.edit(RowEdit(values={"opacities": values}, forget=("opacities",)))
    assert model.column("opacities").tolist() == [-8.0, 0.0, 5.0]
    assert not any(moment.any() for moment in model.moments("opacities"))
    assert all(moment.all() for moment in model.moments("means"))


def test_columns_are_copies(marked_model: Make) -> None:
    """Oracle: the model after a change of the array."""
    model = marked_model(3)
    for name in model.widths:
        model.column(name)[:] = 77
        assert not (model.column(name) == 77).any(), name
        assert model.column(name).shape == (3, *model.widths[name])
        rows = model.gather(name, np.array([2, 0]))
        np.testing.assert_array_equal(rows, model.column(name)[[2, 0]])


def test_fields_of_an_edit_apply_in_order(marked_model: Make) -> None:
    """Oracle: numpy: values first, then moves, then rows kept and copied by their old numbers."""
    model = marked_model(4)
    model.edit(
        RowEdit(
            rows=np.array([1]),
            values={"opacities": np.array([9.0], np.float32)},
            moved=np.array([0]),
            sources=np.array([1]),
            keep=np.array([3, 0]),
            parents=np.array([1, 2]),
            changes={"means": np.full((2, 3), 5.0, np.float32)},
        )
    )
    np.testing.assert_allclose(model.column("opacities"), [-0.7, 9.0, 9.0, -0.8])
    assert model.column("sh0")[:, 0, 0].tolist() == [3, 1, 1, 2]
    assert model.column("means")[:, 0].tolist() == [3, 1, 5, 5]
    assert model.column("views").tolist() == [3003, 0, 0, 0]
    assert model.moments("sh0")[0][:, 0, 0].tolist() == [1003, 0, 0, 0]
