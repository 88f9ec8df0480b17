"""Rows of parameters, moments and counters kept together; oracle: numpy indexing, closed forms."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gscore.splats import PARAMETERS
from gscore.trainer.model.model import Model
from gscore.trainer.strategy import row_ops

Make = Callable[..., Model]


def rows_of(model: Model, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The parameter and its moments as [N, -1] arrays."""
    tensors = (model.params[name], *model.moments(name))
    first, second, third = (t.reshape(len(model), -1).numpy() for t in tensors)
    return first, second, third


def test_edit_keeps_and_appends_in_every_tensor(marked_model: Make) -> None:
    """Oracle: numpy fancy indexing of the marks."""
    model, before = marked_model(6), marked_model(6)
    keep = torch.tensor([4, 0, 5])
    row_ops.edit(model, keep=keep, append=row_ops.duplicate(before, torch.tensor([1, 3])))
    assert len(model) == 5
    for name in PARAMETERS:
        got, was = rows_of(model, name), rows_of(before, name)
        np.testing.assert_array_equal(got[0], was[0][[4, 0, 5, 1, 3]], err_msg=name)
        for i in (1, 2):
            np.testing.assert_array_equal(got[i][:3], was[i][[4, 0, 5]], err_msg=name)
            assert not got[i][3:].any(), name
        assert model.steps(name) == 7
    np.testing.assert_array_equal(model.rows["seen"].numpy(), [3004, 3000, 3005, 0, 0])


def test_edited_parameters_are_those_that_the_optimizer_steps(marked_model: Make) -> None:
    """Oracle: Adam's step against the gradient, which a lost parameter would not take."""
    model = marked_model(4)
    row_ops.edit(model, keep=torch.tensor([2, 3]))
    before = {name: p.clone() for name, p in model.params.items()}
    for name in PARAMETERS:
        model.moments(name)[0].zero_()
        model.moments(name)[1].zero_()
        model.grads[name].fill_(1)
    model.set_rates(dict.fromkeys(PARAMETERS, 0.5))
    model.step()
    for name, p in model.params.items():
        assert (p < before[name]).all(), name


def test_edit_to_zero_rows_and_back(marked_model: Make) -> None:
    """Oracle: an empty model, which is valid."""
    model, other = marked_model(3), marked_model(3)
    row_ops.edit(model, keep=torch.zeros(0, dtype=torch.int64))
    assert len(model) == 0
    row_ops.edit(model, append=row_ops.duplicate(other, torch.tensor([1])))
    assert rows_of(model, "means")[0].tolist() == [[1, 1, 1]]


def test_rows_by_place_follow_a_morton_curve() -> None:
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
    np.testing.assert_array_equal(row_ops.by_place(means).numpy(), expected)
    means[7] = math.nan
    assert sorted(row_ops.by_place(means).tolist()) == list(range(len(means)))
    assert row_ops.by_place(torch.zeros(0, 3)).tolist() == []
    assert row_ops.by_place(torch.ones(3, 3)).tolist() == [0, 1, 2]


def test_split_draws_from_the_splat(marked_model: Make) -> None:
    """Oracle: the covariance R S^2 R^T, estimated from many children."""
    model = marked_model(1)
    quat = torch.tensor([[0.9, 0.3, -0.2, 0.4]])
    scale = torch.tensor([[0.5, 0.1, 0.02]])
    zeros = torch.zeros_like(quat)
    model.replace("quats", quat * 3, zeros, zeros)
    model.replace("scales", scale.log(), torch.zeros(1, 3), torch.zeros(1, 3))
    many = torch.zeros(20_000, dtype=torch.int64)
    children = row_ops.split(model, many, torch.Generator().manual_seed(0))
    assert len(children["means"]) == 40_000
    torch.testing.assert_close(children["scales"][7], (scale[0] / 1.6).log())
    w, x, y, z = (quat[0] / quat[0].norm()).tolist()
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    expected = R @ np.diag(scale[0].numpy() ** 2) @ R.T
    found = np.cov(children["means"].numpy().T.astype(np.float64))
    np.testing.assert_allclose(found, expected, atol=0.01 * expected.max())


def test_halves_lie_side_by_side_along_the_longest_axis(marked_model: Make) -> None:
    """Oracle: the eigenvector of the largest eigenvalue of R S^2 R^T as the axis."""
    model = marked_model(2)
    quats = torch.tensor([[0.9, 0.3, -0.2, 0.4], [-0.1, 0.7, 0.6, 0.2]])
    scales = torch.tensor([[0.5, 0.1, 0.02], [0.03, 0.04, 0.9]])
    model.replace("quats", quats * 3, torch.zeros(2, 4), torch.zeros(2, 4))
    model.replace("scales", scales.log(), torch.zeros(2, 3), torch.zeros(2, 3))
    before = {name: p.clone() for name, p in model.params.items()}
    halves = row_ops.halve(model, torch.tensor([0, 1]))
    assert all((p == before[name]).all() for name, p in model.params.items())
    for row in range(2):
        R = Rotation.from_quat(quats[row].numpy(), scalar_first=True).as_matrix()
        covariance = R @ np.diag(scales[row].numpy().astype(np.float64) ** 2) @ R.T
        values, vectors = np.linalg.eigh(covariance)
        offsets = (halves["means"][row::2] - before["means"][row]).numpy()
        np.testing.assert_allclose(offsets[0], -offsets[1], atol=1e-6)
        along = abs(offsets[0] @ vectors[:, 2])
        np.testing.assert_allclose(along, row_ops.HALF_OFFSET * np.sqrt(values[2]), rtol=1e-4)
        np.testing.assert_allclose(np.linalg.norm(offsets[0]), along, rtol=1e-5)
        factors = (halves["scales"][row::2] - before["scales"][row]).exp()
        expected = np.full((2, 3), row_ops.HALF_WIDTH)
        expected[:, scales[row].argmax()] = row_ops.HALF_LENGTH
        np.testing.assert_allclose(factors.numpy(), expected, rtol=1e-5)
        opacity = row_ops.HALF_OPACITY * torch.sigmoid(before["opacities"][row])
        torch.testing.assert_close(torch.sigmoid(halves["opacities"][row::2]), opacity.expand(2))
        for name in ("quats", "sh0", "shN"):
            torch.testing.assert_close(halves[name][row::2], before[name][[row, row]])


def test_halves_of_splats_without_bounds_are_numbers(marked_model: Make) -> None:
    """Oracle: finite logits for opacities of 0 and 1, and some longest axis of a ball."""
    model = marked_model(2)
    model.params["opacities"].copy_(torch.tensor([-200.0, 200.0]))
    model.params["scales"].zero_()
    halves = row_ops.halve(model, torch.tensor([0, 1]))
    assert all(rows.isfinite().all() for rows in halves.values())


def test_reset_opacities_lowers_only(marked_model: Make) -> None:
    """Oracle: the minimum of the opacity and the ceiling."""
    model = marked_model(3)
    model.params["opacities"].data = torch.tensor([-8.0, 0.0, 5.0])
    row_ops.reset_opacities(model, 0.01)
    expected = [1 / (1 + math.exp(8)), 0.01, 0.01]
    got = torch.sigmoid(model.params["opacities"])
    np.testing.assert_allclose(got.numpy(), expected, rtol=1e-6)
    assert not any(moment.any() for moment in model.moments("opacities"))
    assert all(moment.all() for moment in model.moments("means"))


def test_widen_sh_adds_zeros_behind(marked_model: Make) -> None:
    """Oracle: the old coefficients first, then zeros, in parameter and moments."""
    model, before = marked_model(2), marked_model(2)
    row_ops.widen_sh(model, 2)
    assert model.sh_degree == 2
    for got, was in zip(rows_of(model, "shN"), rows_of(before, "shN"), strict=True):
        np.testing.assert_array_equal(got[:, :9], was)
        assert not got[:, 9:].any()
    row_ops.widen_sh(model, 1)
    assert model.sh_degree == 2


@pytest.mark.parametrize("copies", [1, 2, 3, 10, 51])
def test_shared_opacity_scale_is_equation_9(copies: int) -> None:
    """Oracle: the double sum of the paper, term by term, and equal opacity at the centre."""
    opacity = np.array([0.005, 0.3, 0.9, 0.9999999])
    scale = np.array([[1.0, 2.0, 3.0]]).repeat(4, axis=0)
    new, shrunk = row_ops.shared_opacity_scale(opacity, scale, np.full(4, copies))
    np.testing.assert_allclose(1 - (1 - new) ** copies, opacity, rtol=1e-9)
    for row in range(4):
        total = 0.0
        for i in range(1, copies + 1):
            for k in range(i):
                term = math.comb(i - 1, k) * (-1) ** k / math.sqrt(k + 1)
                total += term * new[row] ** (k + 1)
        np.testing.assert_allclose(shrunk[row], scale[row] * opacity[row] / total, rtol=1e-3)


def test_relocate_moves_the_dead_onto_the_living(marked_model: Make) -> None:
    """Oracle: one live splat, to which all dead ones become equal, with shared opacity."""
    model = marked_model(4)
    opacity = torch.tensor([0.001, 0.8, 0.002, 0.001])
    model.params["opacities"].data = torch.logit(opacity)
    dead = opacity < 0.005
    moved = row_ops.relocate(model, dead, torch.Generator().manual_seed(0), min_opacity=0.005)
    assert moved == 3
    for name in PARAMETERS:
        value, first, second = rows_of(model, name)
        assert (value == value[1]).all(), name
        assert not first.any(), name
        assert not second.any(), name
    got = torch.sigmoid(model.params["opacities"]).double()
    np.testing.assert_allclose(1 - np.prod(1 - got.numpy()), 0.8, rtol=1e-5)
    assert model.rows["seen"].tolist() == [0, 3001, 0, 0]


@pytest.mark.parametrize("dead", [[False, False], [True, True]])
def test_relocate_without_work_changes_nothing(marked_model: Make, dead: list[bool]) -> None:
    """Oracle: equal bits without dead or without live splats."""
    model, before = marked_model(2), marked_model(2)
    generator = torch.Generator().manual_seed(0)
    assert row_ops.relocate(model, torch.tensor(dead), generator, min_opacity=0.005) == 0
    for name in PARAMETERS:
        for got, was in zip(rows_of(model, name), rows_of(before, name), strict=True):
            np.testing.assert_array_equal(got, was)


def test_grow_draws_by_opacity(marked_model: Make) -> None:
    """Oracle: expected counts of a multinomial draw, within five standard deviations."""
    model = marked_model(3)
    opacity = np.array([0.1, 0.3, 0.6])
    model.params["opacities"].data = torch.logit(torch.tensor(opacity, dtype=torch.float32))
    added = row_ops.grow(model, 10_000, torch.Generator().manual_seed(0), min_opacity=1e-6)
    assert added == 10_000
    assert len(model) == 10_003
    marks = model.params["means"][3:, 0].long().numpy()
    counts = np.bincount(marks, minlength=3)
    expected = 10_000 * opacity
    assert (np.abs(counts - expected) < 5 * np.sqrt(expected)).all(), counts
    assert not model.moments("means")[0].any()


def test_grow_survives_rows_that_are_not_finite(marked_model: Make) -> None:
    """Oracle: no draw of NaN opacities; any row if there is no other."""
    model = marked_model(2)
    model.params["opacities"].data = torch.tensor([math.nan, 0.0])
    row_ops.grow(model, 20, torch.Generator().manual_seed(0), min_opacity=0.005)
    assert (model.params["means"][2:] == 1).all()
    model = marked_model(2)
    model.params["opacities"].data = torch.tensor([math.nan, math.nan])
    assert row_ops.grow(model, 3, torch.Generator().manual_seed(0), min_opacity=0.005) == 3
