"""Several splats merged into one. Oracle: integrals on a grid, and moments written out in
float64."""

import numpy as np
import pytest

from gscore.lod.groups import groups_of
from gscore.lod.merge_moments import merged_by, projected_area
from gscore.splats import Splats, sigmoid
from gscore.transforms import quat_to_rotmat

from .conftest import wall


def covariance(splats: Splats, row: int) -> np.ndarray:
    """[3, 3] of one splat, as docs/conventions.md says."""
    R = quat_to_rotmat(splats.quats[row].astype(np.float64))
    return R @ np.diag(np.exp(2 * splats.scales[row].astype(np.float64))) @ R.T


def some(count: int, seed: int = 0, **changed: np.ndarray) -> Splats:
    """Splats of any shape, close together."""
    rng = np.random.default_rng(seed)
    made = {
        "means": rng.normal(size=(count, 3)),
        "quats": rng.normal(size=(count, 4)),
        "scales": rng.normal(-0.5, 0.5, (count, 3)),
        "opacities": rng.normal(size=count),
        "sh0": rng.normal(size=(count, 1, 3)),
        "shN": rng.normal(size=(count, 8, 3)),
    }
    return Splats(**{k: np.asarray(v, np.float32) for k, v in (made | changed).items()})


def test_a_pair_keeps_its_moments() -> None:
    """Oracle: weighted mean, covariance and SH of two splats, written out one by one."""
    pair = some(2, seed=3)
    one = merged_by(pair, np.zeros(2), np.zeros(2, np.int64), 1).splats
    a, b = projected_area(pair) / projected_area(pair).sum()
    mean = a * pair.means[0].astype(float) + b * pair.means[1].astype(float)
    np.testing.assert_allclose(one.means[0], mean, rtol=1e-6)
    apart = pair.means[0].astype(float) - pair.means[1].astype(float)
    wanted = a * covariance(pair, 0) + b * covariance(pair, 1) + a * b * np.outer(apart, apart)
    np.testing.assert_allclose(covariance(one, 0), wanted, rtol=2e-5, atol=1e-6)
    np.testing.assert_allclose(one.shN[0], a * pair.shN[0] + b * pair.shN[1], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(one.sh0[0], a * pair.sh0[0] + b * pair.sh0[1], rtol=1e-5, atol=1e-6)


def test_merging_in_two_steps_is_merging_in_one() -> None:
    """Oracle: moments, which do not depend on the order unless opacity is clamped."""
    four = some(4, seed=4, opacities=np.full(4, -4.0))
    at_once = merged_by(four, np.zeros(4), np.zeros(4, np.int64), 1).splats
    halves = merged_by(four, np.zeros(4), np.array([0, 0, 1, 1]), 2)
    again = merged_by(halves.splats, halves.errors, np.zeros(2, np.int64), 1).splats
    np.testing.assert_allclose(again.means, at_once.means, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(covariance(again, 0), covariance(at_once, 0), rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(sigmoid(again.opacities), sigmoid(at_once.opacities), rtol=1e-4)


def test_coverage_is_the_mean_shadow() -> None:
    """Oracle: the shadow of an ellipsoid, pi sqrt(d' C^-1 d det C), averaged over directions."""
    splats = some(5, seed=6, opacities=np.full(5, 100.0))
    rng = np.random.default_rng(0)
    d = rng.normal(size=(40_000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    for row, found in enumerate(projected_area(splats)):
        C = covariance(splats, row)
        shadow = np.sqrt(np.einsum("ni,ij,nj->n", d, np.linalg.inv(C), d) * np.linalg.det(C))
        assert found == pytest.approx(shadow.mean(), rel=0.02)


def test_opacity_keeps_the_coverage() -> None:
    """Oracle: the sum of coverages for splats far apart; the opacity of all behind each other for
    equal ones in one place."""
    far = some(2, means=np.array([[0, 0, 0], [9.0, 0, 0]]), opacities=np.array([0.3, -1]))
    one = merged_by(far, np.zeros(2), np.zeros(2, np.int64), 1).splats
    assert projected_area(one)[0] == pytest.approx(projected_area(far).sum(), rel=1e-5)
    row = some(1, seed=2)
    stack = row.subset(np.zeros(3, np.int64))
    one = merged_by(stack, np.zeros(3), np.zeros(3, np.int64), 1).splats
    clear = 1 - sigmoid(row.opacities)[0]
    assert sigmoid(one.opacities)[0] == pytest.approx(1 - clear**3, rel=1e-5)
    np.testing.assert_allclose(covariance(one, 0), covariance(row, 0), rtol=1e-4, atol=1e-7)


def test_the_error_is_how_far_splats_were_moved() -> None:
    """Oracle: two equal points 2 apart, moved by 1 each; an earlier error adds."""
    points = some(
        2,
        means=np.array([[-1.0, 0, 0], [1, 0, 0]]),
        scales=np.full((2, 3), -12.0),
        opacities=np.zeros(2),
    )
    group = np.zeros(2, np.int64)
    assert merged_by(points, np.zeros(2), group, 1).errors[0] == pytest.approx(1, rel=1e-6)
    assert merged_by(points, np.full(2, 0.75), group, 1).errors[0] == pytest.approx(1.25, rel=1e-6)


def test_groups_are_neighbours() -> None:
    """Oracle: pairs of points far from all other pairs."""
    rng = np.random.default_rng(8)
    middles = rng.uniform(0, 100, (50, 3)).repeat(2, axis=0)
    means = middles + rng.normal(0, 1e-3, (100, 3))
    group = groups_of(means, np.ones(100), np.full(100, 1e-3), np.zeros((100, 3)), 50)
    np.testing.assert_array_equal(group[0::2], group[1::2])
    assert sorted(set(group)) == list(range(50))


@pytest.mark.parametrize("wanted", [1, 2, 7, 59, 60])
def test_as_many_groups_as_wanted(wanted: int) -> None:
    """Oracle: the number, also where all splats are in one place and cost the same."""
    rng = np.random.default_rng(1)
    for means in (rng.normal(size=(60, 3)), np.zeros((60, 3))):
        group = groups_of(means, np.ones(60), np.ones(60), np.zeros((60, 3)), wanted)
        assert sorted(set(group)) == list(range(wanted))


def test_extremes_stay_finite() -> None:
    """Oracle: finite results, for sizes and opacities at the ends of float32."""
    rng = np.random.default_rng(2)
    splats = some(
        40,
        means=rng.normal(size=(40, 3)) * 10.0 ** rng.integers(-10, 10, (40, 1)),
        scales=rng.uniform(-60, 30, (40, 3)),
        opacities=rng.uniform(-90, 90, 40),
    )
    group = np.arange(40) // 4
    made = merged_by(splats, np.zeros(40), group, 10)
    for name, values in vars(made.splats).items():
        assert np.isfinite(values).all(), name
    assert np.isfinite(made.errors).all()


def test_a_wall_keeps_its_coverage() -> None:
    """Oracle: the previous coverage, a little of which overlaps."""
    splats = wall(2000)
    colors = splats.sh0[:, 0].astype(float)
    sizes = np.exp(splats.scales[:, 0].astype(float))
    group = groups_of(splats.means.astype(float), projected_area(splats), sizes, colors, 500)
    made = merged_by(splats, np.zeros(2000), group, 500)
    assert projected_area(made.splats).sum() == pytest.approx(
        projected_area(splats).sum(), rel=0.15
    )
