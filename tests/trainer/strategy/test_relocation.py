"""Relocation and growth; oracle: closed forms, the paper's double sum, counts of draws."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch

from gscore.engine.cpu.model import CpuModel
from gscore.splats import PARAMETERS
from gscore.trainer.strategy import relocation
from tests.engine.cpu.test_row_edit import rows_of

Make = Callable[..., CpuModel]


def relocate(model: CpuModel, dead: np.ndarray) -> int:
    """Relocate and return the number of moved splats."""
    generator, within, moved = torch.Generator().manual_seed(0), np.ones(len(model), bool), 0
    for edit in relocation.relocate(
        model.column, dead, generator, within=within, min_opacity=0.005
    ):
        assert edit.moved is not None
        moved += len(edit.moved)
        model.edit(edit)
    return moved


def grow(model: CpuModel, count: int, min_opacity: float) -> int:
    """Grow and return the number of added splats."""
    generator, within, added = torch.Generator().manual_seed(0), np.ones(len(model), bool), 0
    for edit in relocation.grow(
        model.column, count, generator, within=within, min_opacity=min_opacity
    ):
        assert edit.parents is not None
        added += len(edit.parents)
        model.edit(edit)
    return added


@pytest.mark.parametrize("copies", [1, 2, 3, 10, 51])
def test_shared_opacity_scale_is_equation_9(copies: int) -> None:
    """Oracle: the double sum of the paper, term by term, and equal opacity at the centre."""
    opacity = np.array([0.005, 0.3, 0.9, 0.9999999])
    scale = np.array([[1.0, 2.0, 3.0]]).repeat(4, axis=0)
    new, shrunk = relocation.shared_opacity_scale(opacity, scale, np.full(4, copies))
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
    assert relocate(model, dead.numpy()) == 3
    for name in PARAMETERS:
        value, first, second = rows_of(model, name)
        assert (value == value[1]).all(), name
        assert not first.any(), name
        assert not second.any(), name
    got = torch.sigmoid(model.params["opacities"]).double()
    np.testing.assert_allclose(1 - np.prod(1 - got.numpy()), 0.8, rtol=1e-5)
    assert model.rows["views"].tolist() == [0, 3001, 0, 0]


@pytest.mark.parametrize("dead", [[False, False], [True, True]])
def test_relocate_without_work_changes_nothing(marked_model: Make, dead: list[bool]) -> None:
    """Oracle: equal bits without dead or without live splats."""
    model, before = marked_model(2), marked_model(2)
    assert relocate(model, np.array(dead)) == 0
    for name in PARAMETERS:
        for got, was in zip(rows_of(model, name), rows_of(before, name), strict=True):
            np.testing.assert_array_equal(got, was)


def test_grow_draws_by_opacity(marked_model: Make) -> None:
    """Oracle: expected counts of a multinomial draw, within five standard deviations."""
    model = marked_model(3)
    opacity = np.array([0.1, 0.3, 0.6])
    model.params["opacities"].data = torch.logit(torch.tensor(opacity, dtype=torch.float32))
    added = grow(model, 10_000, 1e-6)
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
    grow(model, 20, 0.005)
    assert (model.params["means"][2:] == 1).all()
    model = marked_model(2)
    model.params["opacities"].data = torch.tensor([math.nan, math.nan])
    assert grow(model, 3, 0.005) == 3
